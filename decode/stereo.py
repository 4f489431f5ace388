"""Stereo by phase: two cameras that see the same fringes need no calibrated projector.

A surface point shows both cameras the same projector coordinate. Along a left pixel's ray, the right camera's map of that
coordinate is read where the point would be seen; the height at which it shows the left pixel's value is the surface's.
Lens distortion is in both projections, so nothing is rectified (Zhang & Yau 2008 search along rectified rows instead).
Where both axes were decoded, the other one must agree too.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.phase import fringe_sets, solution
from decode.pipeline import reconstruct
from decode.reconstruction import Reconstruction
from decode.validity import Reason
from scenes.calibration import Calibration
from scenes.emission import PinholeProjector
from scenes.errors import DecodeError
from scenes.patterns import Axis
from scenes.rig import Pinhole, Projection
from scenes.stack import Stack

Floats = NDArray[np.float64]

# Right pixels between two looks along the ray.
STEP_PX = 2.0
CHUNK = 1 << 16
SECANT_STEPS = 3
# A map that jumps by this many typical steps has an edge of the surface there, and no crossing.
EDGE = 6.0
# Standard deviations by which the other axis may disagree, and what it may disagree by in any case, projector px.
OTHER_SIGMAS, OTHER_PX = 6.0, 1.0


def stereo(
    left: Stack,
    right: Stack,
    cameras: tuple[Pinhole, Pinhole],
    heights_mm: tuple[float, float],
    **choices: Any,
) -> Reconstruction:
    """Heights (row, col) of the left camera's pixels; the keywords are those of `decode.reconstruct`.

    `cameras` share a world; heights are searched from the first to the second of `heights_mm`. The reconstruction's
    calibration holds the right camera in the projector's place, as the inverse camera it is.

    Raises `DecodeError` when the stacks do not show the same patterns, do not fit their cameras, or nothing matches.
    """
    if left.patterns != right.patterns:
        raise DecodeError("the two stacks show different patterns: stereo needs the same sequence")
    for name, stack, camera in (("left", left, cameras[0]), ("right", right, cameras[1])):
        if camera.resolution != stack.resolution:
            raise DecodeError(
                f"the {name} camera is {camera.resolution[0]} x {camera.resolution[1]} pixels, its frames are "
                f"{stack.resolution[0]} x {stack.resolution[1]}: give the calibration of these cameras"
            )
    if not heights_mm[0] < heights_mm[1]:
        raise DecodeError(f"heights_mm is {heights_mm}: the first must be below the second")
    if heights_mm[1] >= cameras[0].projection().origin_mm[2]:
        raise DecodeError(
            f"heights_mm {list(heights_mm)} reach the left camera, which stands at "
            f"{cameras[0].projection().origin_mm[2]:g} mm: search below it"
        )
    maps = [_maps(replace(stack, calibration=None), choices) for stack in (left, right)]
    axis = _axis(maps[0].rec, cameras, heights_mm)
    search = _Search(maps[0], maps[1], cameras[0].projection(), cameras[1].projection(), axis)
    height, sigma = search.heights(heights_mm)
    rec = maps[0].rec
    found = np.isfinite(height)
    reason = np.where(rec.valid & ~found, Reason.NO_HEIGHT, rec.reason).astype(np.uint8)
    if not (reason == Reason.OK).any():
        raise DecodeError(
            f"no left pixel finds its match within {list(heights_mm)} mm: check the calibration and the heights"
        )
    second = cameras[1].model_dump(exclude={"model"})
    return replace(
        rec,
        height_mm=height.astype(np.float32),
        sigma_mm=sigma.astype(np.float32),
        reason=reason,
        axis=axis,
        calibration=Calibration(
            camera=cameras[0],
            projectors=(PinholeProjector(**second, reference_mm=1.0),),
            height_range_mm=heights_mm,
        ),
        settings=dict(rec.settings) | {"height": "stereo"},
    )


@dataclass(frozen=True)
class _Maps:
    """One camera's projector coordinates, NaN where invalid, and their predicted standard deviations, px."""

    rec: Reconstruction
    at_px: dict[Axis, Floats]
    sigma_px: dict[Axis, Floats]


def _maps(stack: Stack, choices: dict[str, Any]) -> _Maps:
    rec = reconstruct(stack, **choices, height="phase")
    at, sigma = {}, {}
    sets = fringe_sets(stack.patterns, 0)
    constant, slope = stack.sensor.noise_model(max(stack.exposure_ms))
    variance = constant + slope * np.maximum(rec.offset_dn - stack.sensor.black_level_dn, 0.0)
    for axis, phase in rec.phases.items():
        at[axis] = np.where(rec.valid, phase.coordinate_px, np.nan)
        if axis in sets:
            _, cosine, sine = solution(sets[axis][-1])
            gain = float((cosine**2).sum() + (sine**2).sum()) / 2.0
            noise = np.sqrt(gain * variance) / rec.modulation_dn
            sigma[axis] = noise * phase.period_px / (2.0 * np.pi)
        else:
            sigma[axis] = np.full(rec.valid.shape, phase.period_px / np.sqrt(12.0))
    return _Maps(rec, at, sigma)


def _axis(
    rec: Reconstruction, cameras: tuple[Pinhole, Pinhole], heights_mm: tuple[float, float]
) -> Axis:
    """The projector axis that changes most along the right image's way of a point that rises."""
    if len(rec.phases) == 1:
        return next(iter(rec.phases))
    left, right = (camera.projection() for camera in cameras)
    origin, direction = left.rays([left.width / 2.0, left.height / 2.0])
    ends = [origin + (h - origin[2]) / direction[2] * direction for h in heights_mm]
    way = right.project(ends[1])[0] - right.project(ends[0])[0]
    gradients = {}
    for axis, phase in rec.phases.items():
        at = np.where(rec.valid, phase.coordinate_px, np.nan)
        # the left map's slope stands for the right one's: the cameras look at the same fringes
        slope = np.array([np.nanmedian(np.diff(at, axis=1)), np.nanmedian(np.diff(at, axis=0))])
        gradients[axis] = abs(float(slope @ way))
    return max(gradients, key=lambda axis: gradients[axis])


@dataclass(frozen=True)
class _Search:
    left: _Maps
    right: _Maps
    left_camera: Projection
    right_camera: Projection
    axis: Axis

    def heights(self, heights_mm: tuple[float, float]) -> tuple[Floats, Floats]:
        """Height and its standard deviation, (row, col), NaN where there is no match."""
        shape = self.left.rec.valid.shape
        height, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        rows, columns = np.nonzero(self.left.rec.valid)
        for start in range(0, rows.size, CHUNK):
            at = rows[start : start + CHUNK], columns[start : start + CHUNK]
            height[at], sigma[at] = self._chunk(*at, heights_mm)
        return height, sigma

    def _chunk(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], heights_mm: tuple[float, float]
    ) -> tuple[Floats, Floats]:
        pixels = np.stack([columns + 0.5, rows + 0.5], axis=-1)
        ray = self.left_camera.rays(pixels)
        wanted = self.left.at_px[self.axis][rows, columns]
        best = np.full(rows.size, np.nan)
        miss = np.full(rows.size, np.inf)
        slope = np.full(rows.size, np.nan)
        for low, high, crossing in self._crossings(ray, wanted, heights_mm):
            found, gradient = self._refine(ray, wanted, low, high, crossing)
            other = self._other_miss(ray, rows, columns, found)
            better = crossing & (other < miss)
            best, miss = np.where(better, found, best), np.where(better, other, miss)
            slope = np.where(better, gradient, slope)
        right = self._sample(self.right.sigma_px[self.axis], self._seen(ray, best))
        sigma = np.hypot(self.left.sigma_px[self.axis][rows, columns], right) / np.abs(slope)
        return np.where(np.isfinite(sigma), best, np.nan), sigma

    def _crossings(
        self, ray: tuple[Floats, Floats], wanted: Floats, heights_mm: tuple[float, float]
    ) -> Iterator[tuple[float, float, NDArray[np.bool_]]]:
        """Height intervals at whose ends the right map lies on either side of the wanted value, and for which pixels."""
        ends = [self._seen(ray, np.full(wanted.shape, h)) for h in heights_mm]
        way = np.nanmax(np.hypot(*np.moveaxis(ends[1] - ends[0], -1, 0)), initial=0.0)
        count = max(2, int(np.ceil(way / STEP_PX)) + 1)
        # equal steps in the right image are nearly equal steps in inverse depth
        top = float(self.left_camera.origin_mm[2])
        heights = top - 1.0 / np.linspace(
            1.0 / (top - heights_mm[0]), 1.0 / (top - heights_mm[1]), count
        )
        before = self._off(ray, wanted, heights[0])
        typical = np.nan
        for low, high in pairwise(heights):
            after = self._off(ray, wanted, high)
            jump = np.abs(after - before)
            if np.isfinite(jump).any():
                here = float(np.nanmedian(jump))
                typical = here if np.isnan(typical) else max(typical, here)
            crossing = (before * after <= 0.0) & (jump <= EDGE * typical)
            if crossing.any():
                yield low, high, crossing
            before = after

    def _refine(
        self,
        ray: tuple[Floats, Floats],
        wanted: Floats,
        low: float,
        high: float,
        crossing: NDArray[np.bool_],
    ) -> tuple[Floats, Floats]:
        """False position inside the interval; also d coordinate / d height there, px per mm."""
        part = ray[0][crossing], ray[1][crossing]
        target = wanted[crossing]
        a, b = np.full(target.shape, low), np.full(target.shape, high)
        fa, fb = self._off(part, target, a), self._off(part, target, b)
        with np.errstate(invalid="ignore", divide="ignore"):
            gradient = (fb - fa) / (b - a)
            middle = a
            for _ in range(SECANT_STEPS):
                middle = np.where(fb == fa, a, a - fa * (b - a) / (fb - fa))
                f = self._off(part, target, middle)
                left = fa * f > 0.0
                a, fa = np.where(left, middle, a), np.where(left, f, fa)
                b, fb = np.where(left, b, middle), np.where(left, fb, f)
        found, slope = np.full(wanted.shape, np.nan), np.full(wanted.shape, np.nan)
        found[crossing], slope[crossing] = middle, gradient
        return found, slope

    def _other_miss(
        self,
        ray: tuple[Floats, Floats],
        rows: NDArray[np.intp],
        columns: NDArray[np.intp],
        heights: Floats,
    ) -> Floats:
        """Disagreement of the other axis in px; 0 without one, infinite where it forbids the match."""
        others = [axis for axis in self.left.at_px if axis != self.axis]
        if not others:
            return np.where(np.isfinite(heights), 0.0, np.inf)
        seen = self._seen(ray, heights)
        off = self._sample(self.right.at_px[others[0]], seen)
        miss = np.abs(off - self.left.at_px[others[0]][rows, columns])
        noise = np.hypot(
            self.left.sigma_px[others[0]][rows, columns],
            self._sample(self.right.sigma_px[others[0]], seen),
        )
        return np.where(miss <= np.maximum(OTHER_SIGMAS * noise, OTHER_PX), miss, np.inf)

    def _seen(self, ray: tuple[Floats, Floats], heights: Floats | float) -> Floats:
        """Where the right camera sees the ray's points of these heights, px (..., 2)."""
        origin, direction = ray
        t = (heights - origin[..., 2]) / direction[..., 2]
        return self.right_camera.project(origin + t[..., None] * direction)[0]

    def _off(self, ray: tuple[Floats, Floats], wanted: Floats, heights: Floats | float) -> Floats:
        return self._sample(self.right.at_px[self.axis], self._seen(ray, heights)) - wanted

    def _sample(self, image: Floats, pixels: Floats) -> Floats:
        """Bilinear value at continuous pixels (..., 2); NaN outside the image or beside a NaN."""
        rows, columns = image.shape
        u, v = pixels[..., 0] - 0.5, pixels[..., 1] - 0.5
        inside = (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        x = np.minimum(u.astype(np.intp), max(columns - 2, 0))
        y = np.minimum(v.astype(np.intp), max(rows - 2, 0))
        x1, y1 = np.minimum(x + 1, columns - 1), np.minimum(y + 1, rows - 1)
        fx, fy = u - x, v - y
        top = image[y, x] * (1 - fx) + image[y, x1] * fx
        bottom = image[y1, x] * (1 - fx) + image[y1, x1] * fx
        return np.where(inside, top * (1 - fy) + bottom * fy, np.nan)
