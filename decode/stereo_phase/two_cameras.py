"""Stereo by phase: two cameras that see the same fringes need no calibrated projector.

A surface point shows both cameras the same projector coordinate (Zhang & Yau 2008). Candidates come from a grid of epipolar
lines (`decode.stereo_phase.epipolar_grid`); each is then refined on the left pixel's exact ray, lens distortion of both
cameras included, until the right camera's map shows the left pixel's coordinate. Where both axes were decoded, the other one
must agree too.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decode.fusion.interface import FusionRule
from decode.one_camera import decode_fringes
from decode.options import Anchor, Backend, Gamma, Options, Roi, Saturation, Unwrap, known_options
from decode.phase.n_step import TURN, fringe_sets, solution
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from decode.stereo_phase.epipolar_grid import CameraBaseline, EpipolarGrid, interpolated
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import Pinhole
from scenes.rig.projection import Projection
from scenes.rig.projectors import PinholeProjector
from scenes.support.errors import DecodeError
from scenes.support.memory import room_for

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Progress = Callable[[float], None]

# Pixels refined at once: few enough for their arrays to stay in the cache.
CHUNK = 1 << 15
SECANT_STEPS = 3
# Right pixels to either side of a candidate between which its crossing is sought, one after the other: half a row of the
# grid, and wider or narrower where the map ends.
BRACKETS_PX = (1.2, 3.0, 0.5)
# Standard deviations by which the other axis may disagree, and what it may disagree by in any case, projector px.
OTHER_SIGMAS, OTHER_PX = 6.0, 1.0
# Memory per pixel of either camera, as measured.
PIXEL_BYTES = 400


@known_options
def stereo(
    left: Stack,
    right: Stack,
    cameras: tuple[Pinhole, Pinhole],
    heights_mm: tuple[float, float],
    *,
    fusion: str | FusionRule = "max-modulation",
    exposure: int | None = None,
    saturation: Saturation = "reject",
    unwrap: Unwrap | None = None,
    anchor: Anchor | None = None,
    gamma: Gamma | None = None,
    roi: Roi | None = None,
    min_modulation_dn: float | None = None,
    min_relative_modulation: float = STRAY_FRACTION,
    max_order_residual: float = 0.25,
    backend: Backend | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Heights of the left camera's pixels from two cameras and an uncalibrated projector.

    Parameters
    ----------
    left, right
        Frames (exposure, frame, row, col) in DN of the two cameras, under the same patterns.
    cameras
        Left and right camera, in one world, mm.
    heights_mm
        Lowest and highest world z that is searched, mm.
    fusion, exposure, saturation, unwrap, anchor, gamma, min_modulation_dn, min_relative_modulation, max_order_residual, backend
        As in `decode.reconstruct`.
    roi
        (row0, row1, col0, col1) of the left image in px, ends exclusive, or a boolean mask (row, col).
    progress
        Called with the share that is done, from 0 to 1.

    Returns
    -------
    Reconstruction
        Images (row, col) of the left camera. Its calibration holds the right camera in the projector's place, as the inverse
        camera it is.

    Raises
    ------
    DecodeError
        The stacks do not show the same patterns, do not fit their cameras, or nothing matches.
    TooLargeError
        More pixels than memory holds.

    Examples
    --------
    >>> rec = stereo(left, right, cameras, (-900.0, -400.0))  # doctest: +SKIP
    """
    _check(left, right, cameras, heights_mm)
    done = progress or (lambda share: None)
    options = Options(
        fusion=fusion,
        exposure=exposure,
        saturation=saturation,
        unwrap=unwrap,
        anchor=anchor,
        gamma=gamma,
        height="phase",
        min_modulation_dn=min_modulation_dn,
        min_relative_modulation=min_relative_modulation,
        max_order_residual=max_order_residual,
        backend=backend,
    )
    pixels = sum(stack.resolution[0] * stack.resolution[1] for stack in (left, right))
    with room_for(PIXEL_BYTES * pixels, f"stereo of {pixels} pixels", "choose smaller images"):
        views = []
        for stack, choices in ((left, replace(options, roi=roi)), (right, options)):
            views.append(_maps(replace(stack, calibration=None), choices))
            done(0.1 * len(views))
        axis = _axis(views[0].rec, cameras, heights_mm)
        lenses = cameras[0].projection(), cameras[1].projection()
        search = _Search(views[0], views[1], *lenses, axis, heights_mm)
        height, sigma = search.heights(done)
    rec = views[0].rec
    reason = np.where(rec.valid & ~np.isfinite(height), Reason.NO_HEIGHT, rec.reason)
    if not (reason == Reason.OK).any():
        raise DecodeError(
            f"no left pixel finds its match within {list(heights_mm)} mm: check the calibration and the heights"
        )
    second = cameras[1].model_dump(exclude={"model"})
    return replace(
        rec,
        height_mm=height.astype(np.float32),
        sigma_mm=sigma.astype(np.float32),
        reason=reason.astype(np.uint8),
        axis=axis,
        calibration=Calibration(
            camera=cameras[0],
            projectors=(PinholeProjector(**second, reference_mm=1.0),),
            height_range_mm=heights_mm,
        ),
        settings=dict(rec.settings) | {"height": "stereo"},
    )


def _check(
    left: Stack, right: Stack, cameras: tuple[Pinhole, Pinhole], heights_mm: tuple[float, float]
) -> None:
    if left.patterns != right.patterns:
        raise DecodeError("the two stacks show different patterns: stereo needs the same sequence")
    for name, stack, camera in (("left", left, cameras[0]), ("right", right, cameras[1])):
        camera.projection().require_shape(
            stack.frames.shape[2:], f"the {name} stack's frames", DecodeError
        )
    if not heights_mm[0] < heights_mm[1]:
        raise DecodeError(f"heights_mm is {heights_mm}: the first must be below the second")
    origins = [camera.projection().origin_mm for camera in cameras]
    if heights_mm[1] >= origins[0][2]:
        raise DecodeError(
            f"heights_mm {list(heights_mm)} reach the left camera, which is at {origins[0][2]:g} mm: search below it"
        )
    if np.allclose(origins[0], origins[1]):
        raise DecodeError(
            "both cameras are at one place: stereo needs a distance between them; check the calibration's translation"
        )


@dataclass(frozen=True)
class _Maps:
    """One camera's projector coordinates, NaN where invalid, and their predicted standard deviations, px."""

    rec: Reconstruction
    at_px: dict[Axis, Floats]
    sigma_px: dict[Axis, Floats]
    coded: frozenset[Axis]
    """Axes of Gray code alone."""


def _maps(stack: Stack, options: Options) -> _Maps:
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
    return _Maps(rec, at, sigma, frozenset(rec.phases.keys() - sets.keys()))


def _axis(
    rec: Reconstruction, cameras: tuple[Pinhole, Pinhole], heights_mm: tuple[float, float]
) -> Axis:
    """The projector axis that changes most along the right image's way of a point that rises."""
    if len(rec.phases) == 1:
        return next(iter(rec.phases))
    left, right = (camera.projection() for camera in cameras)
    low, high = right.project(left.points_at(heights_mm, [left.width / 2.0, left.height / 2.0]))[0]
    way = high - low
    gradients = {}
    for axis, phase in rec.phases.items():
        at = np.where(rec.valid, phase.coordinate_px, np.nan)
        # The left map's slope is used for the right one's: the cameras look at the same fringes.
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
