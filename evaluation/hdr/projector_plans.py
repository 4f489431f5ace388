"""Strategies that use what a projector can do: less light, light masked pixel by pixel, another place to shine from."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import decode
from evaluation.hdr.capture_strategies import PlannedCapture, Strategy, take
from evaluation.hdr.light_budget import LightBudget, Reference, Shoot, Shot
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError

# Grey levels of a mask, and the brightest sample allowed, as a share of saturation.
LEVELS = 16
HEADROOM = 0.9


def intensity_ladder(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """One exposure time, and as many projector intensities as the budget has room for, in the range of the reference's
    times, evenly spaced in their logarithm.
    """
    longest, count = max(reference.times_ms), len(reference.times_ms)
    shot = reference.filled(budget, Shot(reference.patterns, (longest,) * count))
    levels = np.geomspace(min(reference.times_ms) / longest, 1.0, len(shot.times_ms))
    return take(shoot, reference, replace(shot, levels=tuple(levels.tolist())))


def one_projector(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The first projector alone, with the pictures that the others would take."""
    return _with_projectors(shoot, reference, budget, 1)


def every_projector(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """All projectors, the reference's own pictures: each pixel has as many chances as there are projectors."""
    return _with_projectors(shoot, reference, budget, reference.projectors)


def _with_projectors(
    shoot: Shoot, reference: Reference, budget: LightBudget, count: int
) -> PlannedCapture:
    if reference.projectors == 1:
        raise ScoreError("the scene has one projector: this strategy needs two or more")
    shot = Shot(reference.patterns, reference.times_ms, projectors=count)
    return take(shoot, reference, reference.filled(budget, shot))


def adaptive_projection(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The longest exposure, under a mask of projector pixels (levels of 1/16) that keeps camera pixels below saturation.

    First pictures of all patterns at the shortest and the middle exposure are decoded; they are counted. Each camera pixel's
    point is projected into the projector, whose pixels around it are dimmed to the level that the pixel needs, to the darkest
    where several meet. Projector pixels that no camera pixel sees stay white.
    """
    probe = Shot(reference.patterns, (min(reference.times_ms), reference.middle_ms))
    long = Shot(reference.patterns, (max(reference.times_ms),))
    shot = reference.filled(budget, long, probe)
    seen = shoot(probe)
    masks = tuple(_mask(seen, p, max(shot.times_ms)) for p in range(reference.projectors))
    return take(shoot, reference, replace(shot, masks=masks), probe)


def _mask(seen: Stack, projector: int, exposure_ms: float) -> NDArray[np.float64]:
    """Levels (row, col) of a projector's pixels for an exposure, from two others, of which the shorter may clip."""
    if seen.calibration is None:
        raise ScoreError("a mask needs a calibration: it says which projector pixel lights a point")
    device = seen.calibration.projectors[projector]
    black, top = seen.sensor.black_level_dn, seen.saturation_dn
    short = decode.reconstruct(
        seen, projector=projector, fusion="single", exposure=0, saturation="ignore"
    )
    middle = decode.reconstruct(seen, projector=projector, fusion="single", exposure=1)
    mine = [frame.projector == projector for frame in seen.patterns]
    # Of all patterns: the coarse ones, less blurred, are brighter.
    peaks = [
        (frames[mine].max(axis=0) - black) * (exposure_ms / time_ms)
        for frames, time_ms in zip(seen.frames, seen.exposure_ms, strict=True)
    ]
    points = np.where(middle.valid[..., None], middle.xyz_mm, short.xyz_mm)
    peak = np.where(middle.valid, peaks[1], peaks[0])
    wanted = HEADROOM * (top - black) / np.maximum(peak, 1.0)
    level = np.clip(np.floor(wanted * LEVELS), 1, LEVELS) / LEVELS
    at = device.projection().project(points)[0]
    columns, rows = device.resolution
    inside = (short.valid | middle.valid) & ((at >= 0.0) & (at < (columns, rows))).all(axis=-1)
    mask = np.ones((rows, columns))
    column, row = at[inside].astype(np.intp).T
    np.minimum.at(mask, (row, column), level[inside])
    # A camera pixel sees this many projector pixels, and what the projector's blur brings from around them.
    width = max(float(np.nanmedian(np.abs(np.diff(at[..., i], axis=1 - i)))) for i in (0, 1))
    reach = int(np.ceil(width / 2.0 + 2.0 * device.psf_sigma_px))
    return np.asarray(ndimage.minimum_filter(mask, 2 * reach + 1, mode="nearest"))


PROJECTOR = (
    Strategy("intensity-ladder", intensity_ladder, "max-modulation", "Waddington & Kofman 2010"),
    Strategy("adaptive-projection", adaptive_projection, "censored-ml", "Li & Kofman 2014"),
    Strategy("one-projector", one_projector, "censored-ml", "the first projector alone"),
    Strategy("every-projector", every_projector, "censored-ml", "one height of all projectors"),
)
