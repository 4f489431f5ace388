"""What changes from one picture to the next: the projector's light, ambient light, the scene's height, bit planes."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from render.sensor_stages import Floats, Stream, random_stream
from scenes.rig.projectors import Projector
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
    shares: tuple[float, ...] = ()
    """Share of the exposure in which each bit plane is shown; empty: those of whole frames."""


STEADY = Moment()


class ExposurePart(NamedTuple):
    """A part of an exposure, in ms after the exposure of the first row begins."""

    begin_ms: float
    length_ms: float
    shown_ms: float = 0.0
    """When its pattern appeared."""


def is_steady(scene: Scene) -> bool:
    """Whether every moment is the same, and no light depends on a seed."""
    flickers = scene.ambient.radiance_w_m2_sr > 0.0 and scene.ambient.flicker_depth > 0.0
    sources = any(p.fluctuation or p.speckle_contrast for p in scene.projectors)
    planes = any(p.frame_ms is not None for p in scene.projectors)
    return not (flickers or scene.vibration_um or any(scene.conveyor_um) or sources or planes)


def moment(
    scene: Scene,
    seed: int,
    exposure: int,
    frame: int,
    projector: int,
    exposure_ms: float,
    random: bool = True,
    part: ExposurePart | None = None,
) -> Moment:
    """What one exposure of one frame finds; independent of all others. Not `random`: what is the same for every seed.

    Flicker ``1 + d cos(2 pi f t)`` has a phase of its own in each exposure (the camera does not wait for it); averaged over
    an exposure of length T its depth is ``d |sinc(f T)|``. Of a `part`, what a row of a rolling shutter finds.
    """
    part = part or ExposurePart(0.0, exposure_ms)
    rng = random_stream(seed, Stream.MOMENT, exposure, frame)
    source, z = rng.standard_normal(2)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    device = scene.projectors[projector]
    start = 0.0 if device.triggered else rng.uniform()
    shares: tuple[float, ...] = ()
    if device.frame_ms is not None and (random or device.triggered):
        start += (part.begin_ms - part.shown_ms * device.triggered) / device.frame_ms
        shares = tuple(bit_plane_shares(device, part.length_ms / device.frame_ms, start))
    if not random:
        return Moment(shares=shares)
    ambient = scene.ambient
    swing = ambient.flicker_depth * np.sinc(ambient.flicker_hz * part.length_ms * 1e-3)
    later_ms = part.begin_ms + (part.length_ms - exposure_ms) / 2.0
    phase += 2.0 * np.pi * ambient.flicker_hz * later_ms * 1e-3
    return Moment(
        max(0.0, 1.0 + device.fluctuation * float(source)),
        float(1.0 + swing * np.cos(phase)),
        scene.vibration_um * 1e-3 * float(z),
        shares,
    )


def bit_plane_shares(projector: Projector, periods: float, start: float) -> Floats:
    """Share of an exposure (plane,) in which each bit plane is shown; it lasts `periods` frames and starts `start` frames after one began.

    Over whole frames it is a plane's share of the frame, wherever they start.
    """
    share = projector.plane_shares
    begins = np.cumsum(share) - share
    # Beyond these, rounding leaves nothing of a part of a frame.
    periods = float(np.clip(periods, 1e-9, 1e9))

    def shown(until: float) -> Floats:
        frames = np.floor(until)
        return np.asarray(frames * share + np.clip(until - frames - begins, 0.0, share))

    return (shown(start + periods) - shown(start)) / periods
