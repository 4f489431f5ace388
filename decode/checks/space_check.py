"""Whether the decoded coordinates fit the calibration: points in the working volume, which both axes agree about."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decode.pipeline import reconstruct
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding, graded

Floats = NDArray[np.float64]
# Points of a good calibration meet the other axis to a pixel; a wrong one misses by tens.
EPIPOLAR_PX = (2.0, 8.0)
# A calibration that is a little off misses by less; a shift must explain three quarters of what is missed.
CLEARLY_PX, EXPLAINED = 1.5, 0.25
# Distance from a whole number of periods or cells within which a shift is one.
NEAR = 0.15
# Share of points outside the working volume that no stray light makes.
AWAY = 0.5
FEWEST, MOST_PIXELS = 100, 100_000
# Of the way from one end of the volume to the other, to see how the other axis changes along a ray.
STEP = 1e-3


@dataclass(frozen=True)
class Miss:
    """How the point that one axis gives misses the coordinate of the other axis."""

    axis: Axis
    other: Axis
    miss_px: Floats
    """Coordinate of the other axis that the point should show, minus the decoded one, one a point."""
    slope: Floats
    """Change of the other axis' coordinate along the camera's ray, for a pixel of the axis."""

    @property
    def middle_px(self) -> float:
        """Median size."""
        return float(np.median(np.abs(self.miss_px)))

    def shows_px(self, axis: Axis) -> float:
        """Shift of an axis' coordinate that could not go unseen."""
        seen = max(EPIPOLAR_PX[0], self.middle_px / EXPLAINED)
        change = 1.0 if axis == self.other else float(np.median(np.abs(self.slope)))
        return seen / max(change, 1e-9)


def missed(rec: Reconstruction, calibration: Calibration, projector: int) -> Miss | None:
    """The miss of a decoded stack; None with one axis, or too few points."""
    other: Axis = "row" if rec.axis == "column" else "column"
    every = max(1, int(np.sqrt(rec.valid.size / MOST_PIXELS)))
    at = (slice(None, None, every), slice(None, None, every))
    valid = rec.valid[at]
    if other not in rec.phases or valid.sum() < FEWEST:
        return None
    camera = calibration.camera.projection()
    light = calibration.projectors[projector].projection()
    height, pixels = rec.height_mm[at][valid].astype(float), camera.pixel_centres()[at][valid]
    step = STEP * float(np.ptp(calibration.height_range_mm))
    seen, moved = (light.project(camera.points_at(h, pixels))[0] for h in (height, height + step))
    index = 0 if rec.axis == "column" else 1
    along = moved - seen
    slope = along[:, 1 - index] / np.where(np.abs(along[:, index]) > 1e-12, along[:, index], np.nan)
    miss = seen[:, 1 - index] - rec.phases[other].coordinate_px[at][valid]
    good = np.isfinite(miss) & np.isfinite(slope)
    return Miss(rec.axis, other, miss[good], slope[good]) if good.sum() >= FEWEST else None


def in_space(stack: Stack, projector: int) -> tuple[Finding, Miss | None]:
    """Points must be in the volume; the point that one axis gives must show the other axis' coordinate, whatever the surface."""
    assert stack.calibration is not None
    name = "calibration"
    try:
        rec = reconstruct(stack, projector=projector)
    except DecodeError as error:
        return Finding(name, "wrong", f"no height comes out of it: {error}"), None
    away = float((rec.reason == Reason.OUT_OF_VOLUME).sum())
    away /= max(float(rec.valid.sum()) + away, 1.0)
    if away > AWAY:
        said = (
            f"{away:.0%} of the points lie outside the working volume: the calibration is not this rig's, an axis is "
            "mirrored, or the volume is wrong"
        )
        return Finding(name, "wrong", said, away), None
    if len(rec.phases) < 2:
        said = f"{away:.0%} of the points lie outside the working volume"
        return Finding(name, "ok", said, away), None
    miss = missed(rec, stack.calibration, projector)
    if miss is None:
        return Finding(name, "unknown", "too few points to compare rows and columns"), None
    verdict = graded(miss.middle_px, *EPIPOLAR_PX)
    said = f"points from the {miss.axis}s miss their {miss.other} by {miss.middle_px:.2f} projector px (median)"
    shift = _whole_shift(miss, stack)
    verdict = "wrong" if shift else verdict
    if verdict != "ok":
        said += f": the calibration is not this rig's, or {shift or 'an axis is mirrored'}"
    return Finding(name, verdict, said, miss.middle_px), miss


def _whole_shift(miss: Miss, stack: Stack) -> str:
    """The shift by whole periods, or cells of a code alone, that removes what is missed; empty if there is none."""
    if miss.middle_px < CLEARLY_PX:
        return ""
    found = []
    for axis, change in ((miss.axis, -miss.slope), (miss.other, np.ones_like(miss.slope))):
        power = float(np.median(change**2))
        shift = float(np.median(change * miss.miss_px)) / max(power, 1e-12)
        left = float(np.median(np.abs(miss.miss_px - shift * change)))
        shown = [f for f in stack.patterns if f.axis == axis and f.period_px]
        unit = min(f.period_px for f in shown)
        whole = round(shift / unit)
        # A code's cells are so narrow that a calibration which is a little off often is a whole number of them.
        alone = all(f.kind == "gray" for f in shown)
        if alone and miss.middle_px < EPIPOLAR_PX[0]:
            continue
        if whole and left < EXPLAINED * miss.middle_px and abs(shift / unit - whole) < NEAR:
            found.append(f"{axis}s that are {whole * unit:+g} px")
    return (
        f"{' or '.join(found)} more would fit; correct an origin_px or a first phase"
        if found
        else ""
    )
