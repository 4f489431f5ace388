"""Light: a scene becomes linear transport, digital numbers and truth."""

from render.expose import expose
from render.mitsuba_scene import mitsuba_scene
from render.refine import trace
from render.surfaces import Surfaces, surfaces
from render.transport import PhaseError, Transport
from render.truth import truth

__all__ = [
    "PhaseError",
    "Surfaces",
    "Transport",
    "expose",
    "mitsuba_scene",
    "surfaces",
    "trace",
    "truth",
]
