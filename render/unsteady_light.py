"""What changes from one picture to the next: the projector's light, ambient light, the scene's height."""

from dataclasses import dataclass

import numpy as np

from render.sensor_stages import Stream, random_stream
from scenes.scene import Scene


@dataclass(frozen=True)
class Moment:
    """One exposure of one frame."""

    source: float = 1.0
    """Light of the projector over its mean."""
    ambient: float = 1.0
    """Ambient light over its mean."""
    z_mm: float = 0.0
    """How far the scene is above its place."""


STEADY = Moment()


def is_steady(scene: Scene) -> bool:
    """Whether every moment is the same, and no light depends on a seed."""
    flickers = scene.ambient.radiance_w_m2_sr > 0.0 and scene.ambient.flicker_depth > 0.0
    sources = any(p.fluctuation or p.speckle_contrast for p in scene.projectors)
    return not (flickers or scene.vibration_um or sources)


def moment(
    scene: Scene, seed: int, exposure: int, frame: int, projector: int, exposure_ms: float
) -> Moment:
    """What one exposure of one frame finds; independent of all others.

    Flicker ``1 + d cos(2 pi f t)`` has a phase of its own in each exposure (the camera does not wait for it); averaged over
    an exposure of length T its depth is ``d |sinc(f T)|``.
    """
    rng = random_stream(seed, Stream.MOMENT, exposure, frame)
    source, z = rng.standard_normal(2)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    ambient = scene.ambient
    swing = ambient.flicker_depth * np.sinc(ambient.flicker_hz * exposure_ms * 1e-3)
    return Moment(
        max(0.0, 1.0 + scene.projectors[projector].fluctuation * float(source)),
        float(1.0 + swing * np.cos(phase)),
        scene.vibration_um * 1e-3 * float(z),
    )
