"""The search for matching pixels of two cameras, and the heights that their rays give."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decode.one_camera import decode_fringes
from decode.options import Options
from decode.phase.n_step import TURN, fringe_sets, solution
from decode.reconstruction import Reconstruction
from decode.stereo_phase.epipolar_grid import (
    CameraBaseline,
    EpipolarGrid,
    Floats,
    Indices,
    interpolated,
)
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.projection import Projection

Progress = Callable[[float], None]

# Pixels refined at once: few enough for their arrays to stay in the cache.
CHUNK = 1 << 15
SECANT_STEPS = 3
# Right pixels to either side of a candidate between which its crossing is sought, one after the other: half a row of the
# grid, and wider or narrower where the map ends.
BRACKETS_PX = (1.2, 3.0, 0.5)
# Standard deviations by which the other axis may disagree, and what it may disagree by in any case, projector px.
OTHER_SIGMAS, OTHER_PX = 6.0, 1.0


@dataclass(frozen=True)
class CoordinateMaps:
    """One camera's projector coordinates, NaN where invalid, and their predicted standard deviations, px."""

    rec: Reconstruction
    at_px: dict[Axis, Floats]
    sigma_px: dict[Axis, Floats]
    coded: frozenset[Axis]
    """Axes of Gray code alone."""

    @classmethod
    def of(cls, stack: Stack, options: Options) -> "CoordinateMaps":
        """Decode one camera's frames."""
        rec = decode_fringes(stack, options)
        at, sigma = {}, {}
        sets = fringe_sets(stack.patterns, 0)
        variance = stack.sensor.variance_dn2(rec.offset_dn, max(stack.exposure_ms))
        for axis, phase in rec.phases.items():
            at[axis] = np.where(rec.valid, phase.coordinate_px, np.nan)
            if axis in sets:
                _, cosine, sine = solution(sets[axis][-1])
                gain = float((cosine**2).sum() + (sine**2).sum()) / 2.0
                with np.errstate(divide="ignore", invalid="ignore"):
                    noise = np.sqrt(gain * variance) / rec.modulation_dn
                sigma[axis] = np.asarray(noise * phase.period_px / TURN, np.float64)
            else:
                sigma[axis] = np.full(rec.valid.shape, phase.period_px / np.sqrt(12.0))
        return cls(rec, at, sigma, frozenset(rec.phases.keys() - sets.keys()))


@dataclass(frozen=True)
class PairSearch:
    """Matches of the left camera's pixels, and their heights."""

    left: CoordinateMaps
    right: CoordinateMaps
    left_camera: Projection
    right_camera: Projection
    axis: Axis
    heights_mm: tuple[float, float]

    def heights(self, done: Progress) -> tuple[Floats, Floats]:
        """Height and its standard deviation, (row, col), NaN where there is no match."""
        shape = self.left.rec.valid.shape
        height, sigma = np.full(shape, np.nan), np.full(shape, np.nan)
        rows, columns = np.nonzero(self.left.rec.valid)
        direction = self.left_camera.rays(np.stack([columns + 0.5, rows + 0.5], axis=-1))[1]
        pixel, start = self._matches(direction, rows, columns)
        done(0.6)

        def refine(first: int) -> None:
            some = pixel[first : first + CHUNK]
            at = rows[some], columns[some]
            height[at], sigma[at] = self._refined(
                direction[some], *at, start[first : first + CHUNK]
            )

        # NumPy and SciPy let other threads run meanwhile; each writes pixels of its own.
        chunks = range(0, pixel.size, CHUNK)
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            for count, _ in enumerate(pool.map(refine, chunks), start=1):
                done(0.6 + 0.4 * count / len(chunks))
        return height, sigma

    def _matches(
        self, direction: Floats, rows: Indices, columns: Indices
    ) -> tuple[Indices, Floats]:
        """Left pixels (n,) that have a candidate, and the best one's height, mm."""
        if not rows.size:
            return np.empty(0, np.intp), np.empty(0)
        baseline = CameraBaseline.of(self.left_camera, self.right_camera)
        plane, along = baseline.angles(direction)
        grid = EpipolarGrid.of(baseline, self.right_camera, self.right.at_px, plane)
        cell_px = self.left.rec.phases[self.axis].period_px if self.axis in self.left.coded else 0.0
        wanted = self.left.at_px[self.axis][rows, columns]
        pixel, right_rad, others = grid.candidates(self.axis, plane, wanted, cell_px)
        distance = baseline.distance_mm(along[pixel], right_rad)
        height = self.left_camera.origin_mm[2] + distance * direction[pixel, 2]
        low, high = self.heights_mm
        keep = (height >= low) & (height <= high)
        miss = np.zeros(pixel.size)
        for name, value in others.items():
            miss = np.abs(value - self.left.at_px[name][rows[pixel], columns[pixel]])
            # A row of the grid away the other axis may differ a little more than on the exact ray.
            keep &= np.isfinite(miss)
        pixel, height, miss = pixel[keep], height[keep], miss[keep]
        order = np.lexsort((height, miss, pixel))
        pixel, height = pixel[order], height[order]
        best = np.concatenate([[True], pixel[1:] != pixel[:-1]]) if pixel.size else pixel > 0
        return pixel[best], height[best]

    def _refined(
        self, direction: Floats, rows: Indices, columns: Indices, start_mm: Floats
    ) -> tuple[Floats, Floats]:
        """Height on the exact ray near a candidate, by false position, and its standard deviation, mm."""
        wanted = self.left.at_px[self.axis][rows, columns]
        one_mm = self._seen(direction, start_mm + 0.5) - self._seen(direction, start_mm - 0.5)
        px_per_mm = np.hypot(one_mm[:, 0], one_mm[:, 1])
        a, b = np.full(wanted.size, np.nan), np.full(wanted.size, np.nan)
        fa, fb = a.copy(), b.copy()
        left = np.arange(wanted.size)
        with np.errstate(invalid="ignore", divide="ignore"):
            for width_px in BRACKETS_PX:
                reach = width_px / px_per_mm[left]
                low, high = start_mm[left] - reach, start_mm[left] + reach
                f_low = self._off(direction[left], wanted[left], low)
                f_high = self._off(direction[left], wanted[left], high)
                found = f_low * f_high <= 0.0
                at = left[found]
                a[at], b[at], fa[at], fb[at] = low[found], high[found], f_low[found], f_high[found]
                left = left[~found]
            gradient = (fb - fa) / (b - a)
            height = a.copy()
            for _ in range(SECANT_STEPS):
                height = np.where(fb == fa, 0.5 * (a + b), a - fa * (b - a) / (fb - fa))
                f = self._off(direction, wanted, height)
                same = fa * f > 0.0
                a, fa = np.where(same, height, a), np.where(same, f, fa)
                b, fb = np.where(same, b, height), np.where(same, fb, f)
            seen = self._seen(direction, height)
            right = self._sampled(self.right.sigma_px[self.axis], seen)
            sigma = np.hypot(self.left.sigma_px[self.axis][rows, columns], right) / np.abs(gradient)
            lowest, highest = self.heights_mm
            good = np.isfinite(sigma) & (height >= lowest) & (height <= highest)
            good &= self._agrees(seen, rows, columns)
        return np.where(good, height, np.nan), np.where(good, sigma, np.nan)

    def _agrees(self, seen: Floats, rows: Indices, columns: Indices) -> NDArray[np.bool_]:
        """Where the other axis shows the same coordinate too."""
        agrees = np.ones(rows.size, np.bool_)
        for other in self.left.at_px:
            if other == self.axis:
                continue
            miss = np.abs(
                self._sampled(self.right.at_px[other], seen) - self.left.at_px[other][rows, columns]
            )
            noise = np.hypot(
                self.left.sigma_px[other][rows, columns],
                self._sampled(self.right.sigma_px[other], seen),
            )
            agrees &= miss <= np.maximum(OTHER_SIGMAS * noise, OTHER_PX)
        return agrees

    def _seen(self, direction: Floats, height_mm: Floats) -> Floats:
        """Where the right camera sees the left rays' points of these heights, px (..., 2)."""
        points = self.left_camera.ray_points(self.left_camera.origin_mm, direction, height_mm)
        return self.right_camera.project(points)[0]

    def _off(self, direction: Floats, wanted: Floats, height_mm: Floats) -> Floats:
        seen = self._seen(direction, height_mm)
        return self._sampled(self.right.at_px[self.axis], seen) - wanted

    @staticmethod
    def _sampled(image: Floats, seen: Floats) -> Floats:
        return interpolated(image, seen[..., 0], seen[..., 1])
