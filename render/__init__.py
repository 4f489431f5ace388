"""Light: turns a scene into linear transport, digital numbers and truth."""

from render.chip_image import through_lens
from render.exposure import expose
from render.ground_truth import truth
from render.motion import conveyed, height_slope
from render.pathtracer.until_converged import trace
from render.plugins.scene_translation import mitsuba_scene
from render.plugins.shared_surfaces import Surfaces, surfaces
from render.ring_lights import ring_light_picture
from render.transport import PhaseError, RenderNoise, Transport

__all__ = [
    "PhaseError", "RenderNoise", "Surfaces", "Transport", "conveyed", "expose", "height_slope", "mitsuba_scene",
    "ring_light_picture", "surfaces", "through_lens", "trace", "truth",
]  # fmt: skip
