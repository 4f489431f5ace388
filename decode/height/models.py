"""From projector coordinate to height: three models of one interface.

- `Triangulation`: the camera ray meets the projector's fringe; any pinhole or telecentric mixture, lens distortion on
  both sides.
- `ReferencePlane`: ``h = d / (c + k d)`` with d the coordinate's shift against the plane z = 0 (Takeda & Mutoh 1983 in
  its rational form); the plane comes from the calibration or from a measured stack.
- `Linear`: ``h = (u - x) / c`` with x the camera's own coordinate; exact for a telecentric camera and projector.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes, packets
from decode.height.calibrated_view import CalibratedView
from decode.height.rig_geometry import Arithmetic, Ray, Rig
from scenes.acquisition.patterns import Axis
from scenes.support.errors import DecodeError


@dataclass(frozen=True)
class Pixels:
    """The camera's pixels, one lane each."""

    device: Device
    image: tuple[int, int]
    """Rows and columns."""
    real: Any
    """Type of geometry's lanes: float64 to measure, float32 to choose."""

    def coarse(self) -> "Pixels":
        """The same pixels in float32: enough to choose a fringe order, and cheaper."""
        return replace(self, real=self.device.types.Float)

    @property
    def arithmetic(self) -> Arithmetic:
        """Geometry's arithmetic in this kernel."""
        return Arithmetic(self.number, self._invert, self.device.dr.fma)

    def number(self, value: float) -> Lanes:
        """A number the kernel takes as an argument: another rig does not compile another kernel."""
        return self.device.dr.opaque(self.real, float(value))

    def _invert(self, value: Lanes) -> Lanes:
        """Reciprocal: a float32 one and a Newton step, which squares its error, cost a third of a float64 division."""
        real, single = self.real, self.device.types.Float
        if real is single:
            return 1.0 / value
        rough = real(1.0 / single(value))
        return rough * (2.0 - value * rough)

    def centres(self) -> tuple[Lanes, Lanes]:
        """Continuous column and row coordinates of the pixel centres."""
        rows, columns = self.image
        types = self.device.types
        lane = self.device.dr.arange(types.UInt32, rows * columns)
        row = lane // columns
        return self.real(lane - row * columns) + 0.5, self.real(row) + 0.5

    def image_lanes(self, values: NDArray[np.float64]) -> Lanes:
        """A float64 image (row, col) as lanes."""
        whole = np.ascontiguousarray(values, dtype=np.float64)
        return self.real(self.device.types.Float64(packets(whole.reshape(-1))))


class Solver(ABC):
    """A height model bound to pixels: all lanes, float64."""

    @abstractmethod
    def height(self, coordinate_px: Lanes) -> tuple[Lanes, Lanes]:
        """Height in mm from each pixel's projector coordinate in px (float64 lanes), and its slope d height / d
        coordinate.
        """

    @abstractmethod
    def coordinate(self, height_mm: float) -> Lanes:
        """Projector coordinate in px at which each pixel sees a surface at this height."""


class HeightModel(ABC):
    """A way from projector coordinate to height."""

    @abstractmethod
    def bind(self, pixels: Pixels) -> Solver:
        """The model at these pixels."""

    @abstractmethod
    def band_px(self, heights_mm: tuple[float, float]) -> float:
        """Range of projector coordinates one pixel can show between two heights, px (see `CalibratedView.band_px`)."""


@dataclass(frozen=True)
class Triangulation(HeightModel):
    """The camera's ray meets the projector's fringe: exact for any calibrated rig."""

    view: CalibratedView
    axis: Axis
    measures: bool = True
    """Without: only coordinates are asked for, and fringes that no height moves will do."""

    def bind(self, pixels: Pixels) -> Solver:
        if self.measures:
            rig = self.view.kernel_rig(self.axis, pixels.arithmetic)
        else:
            rig = self.view.locating_rig(pixels.arithmetic)
        if rig.parallel:
            return _Affine(self.view.rig, self.axis, pixels)
        return _Triangulated(rig, self.axis, *pixels.centres())

    def band_px(self, heights_mm: tuple[float, float]) -> float:
        return self.view.band_px(self.axis, heights_mm)


class _Triangulated(Solver):
    def __init__(self, rig: Rig, axis: Axis, column_px: Lanes, row_px: Lanes) -> None:
        self.rig, self.axis, self.centres = rig, axis, (column_px, row_px)

    @cached_property
    def ray(self) -> Ray:
        return self.rig.ray(*self.centres)

    def height(self, coordinate_px: Lanes) -> tuple[Lanes, Lanes]:
        t, slope = self.rig.meet(self.ray, coordinate_px, self.axis)
        direction = self.ray.world_direction[2]
        return (self.rig.arithmetic.fma(t, direction, self.ray.world_origin[2]), direction * slope)

    def coordinate(self, height_mm: float) -> Lanes:
        if not self.rig.distorts:
            return self.rig.coordinate_on_plane(*self.centres, height_mm, self.axis)
        number, invert = self.rig.arithmetic.number, self.rig.arithmetic.invert
        way = number(height_mm) - self.ray.world_origin[2]
        at = way * invert(self.ray.world_direction[2])
        return self.rig.coordinate(self.ray, at, self.axis)[0]

    def rational(self) -> tuple[Lanes, Lanes]:
        """(c, k) of ``h = d / (c + k d)`` about z = 0: exact while the projector does not distort."""
        t = self.ray.t_at(0.0)
        c = self.rig.coordinate(self.ray, t, self.axis)[1] / self.ray.world_direction[2]
        if self.rig.projector.telecentric:
            return c, 0.0
        depth = self.ray.local_origin[2] + t * self.ray.local_direction[2]
        # u(h) - u(0) = c h / (1 + m h) with m the relative growth of depth per mm of height.
        return c, -self.ray.local_direction[2] / (self.ray.world_direction[2] * depth)


class _Affine(Solver):
    """Parallel rays on both sides: ``h = g (u - u0)`` with g one number and u0, the plane z = 0, affine in the pixel."""

    def __init__(self, rig: Rig, axis: Axis, pixels: Pixels) -> None:
        wide, high = float(rig.camera.width), float(rig.camera.height)
        ray = rig.ray(np.array([0.0, wide, 0.0]), np.array([0.0, 0.0, high]))
        plane, slope = rig.coordinate(ray, ray.t_at(0.0), axis)
        self.shift = float(slope) / float(ray.world_direction[2])
        self.start = float(plane[0])
        self.across = (float(plane[1]) - self.start) / wide, (float(plane[2]) - self.start) / high
        self.pixels = pixels

    def height(self, coordinate_px: Lanes) -> tuple[Lanes, Lanes]:
        gain = 1.0 / self.shift
        plane = self._over_pixels(-gain * self.start, [-gain * step for step in self.across])
        per_px = self.pixels.number(gain)
        return self.pixels.device.dr.fma(coordinate_px, per_px, plane), per_px

    def coordinate(self, height_mm: float) -> Lanes:
        return self._over_pixels(self.start + self.shift * height_mm, self.across)

    def _over_pixels(self, start: float, step: Sequence[float]) -> Lanes:
        """``start + step (column, row)``."""
        number, fma = self.pixels.number, self.pixels.device.dr.fma
        column, row = self.pixels.centres()
        return fma(column, number(step[0]), fma(row, number(step[1]), number(start)))


@dataclass(frozen=True)
class Linear(HeightModel):
    """``h = (u - x) / c``, x the camera's continuous column (or row), c in projector px per mm."""

    c_px_per_mm: float
    axis: Axis

    def __post_init__(self) -> None:
        if not (np.isfinite(self.c_px_per_mm) and self.c_px_per_mm != 0.0):
            raise DecodeError(
                f"c_px_per_mm is {self.c_px_per_mm}: give the fringe shift per mm of height, not 0"
            )

    def bind(self, pixels: Pixels) -> Solver:
        column, row = pixels.centres()
        c = pixels.number(self.c_px_per_mm)
        return _Rational(column if self.axis == "column" else row, c, 0.0)

    def band_px(self, heights_mm: tuple[float, float]) -> float:
        return abs(self.c_px_per_mm) * (heights_mm[1] - heights_mm[0])


@dataclass(frozen=True)
class LinearisedRig(HeightModel):
    """The linear model a calibration gives: x is the coordinate of the plane z = 0, c that of the image's centre."""

    view: CalibratedView
    axis: Axis

    @property
    def c_px_per_mm(self) -> float:
        """Fringe shift per mm of height at the image's centre and z = 0."""
        rig = self.view.rig
        ray = rig.ray(rig.camera.width / 2.0, rig.camera.height / 2.0)
        slope = rig.coordinate(ray, ray.t_at(0.0), self.axis)[1] / ray.world_direction[2]
        return float(slope)

    def bind(self, pixels: Pixels) -> Solver:
        exact = _Triangulated(
            self.view.kernel_rig(self.axis, pixels.arithmetic), self.axis, *pixels.centres()
        )
        return _Rational(exact.coordinate(0.0), pixels.number(self.c_px_per_mm), 0.0)

    def band_px(self, heights_mm: tuple[float, float]) -> float:
        return abs(self.c_px_per_mm) * (heights_mm[1] - heights_mm[0])


@dataclass(frozen=True)
class ReferencePlane(HeightModel):
    """``h = d / (c + k d)``, d the shift against the plane z = 0.

    With a `view`, c and k vary over the image as the calibration says; else c is `c_px_per_mm` everywhere and k is 0.
    `reference_px` (row, col) is the plane's measured coordinate, NaN where unknown; None: the calibration's.
    """

    axis: Axis
    view: CalibratedView | None
    reference_px: NDArray[np.float64] | None
    """(row, col) measured coordinate of the plane, px, NaN where unknown; None: the calibration's."""
    c_px_per_mm: float | None = None

    def bind(self, pixels: Pixels) -> Solver:
        plane = None if self.reference_px is None else pixels.image_lanes(self.reference_px)
        if self.view is not None:
            exact = _Triangulated(
                self.view.kernel_rig(self.axis, pixels.arithmetic), self.axis, *pixels.centres()
            )
            return _Rational(exact.coordinate(0.0) if plane is None else plane, *exact.rational())
        return _Rational(plane, pixels.number(self._c()), 0.0)

    def band_px(self, heights_mm: tuple[float, float]) -> float:
        if self.view is not None:
            return self.view.band_px(self.axis, heights_mm)
        return abs(self._c()) * (heights_mm[1] - heights_mm[0])

    def _c(self) -> float:
        if self.reference_px is None or not self.c_px_per_mm:
            raise DecodeError(
                "reference-plane heights need a calibration, or a reference stack together with c_px_per_mm "
                "(fringe shift per mm of height, not 0)"
            )
        return self.c_px_per_mm


class _Rational(Solver):
    """``h = d / (c + k d)`` with ``d = u - plane``."""

    def __init__(self, plane_px: Lanes, c: Lanes, k: Lanes) -> None:
        self.plane_px, self.c, self.k = plane_px, c, k

    def height(self, coordinate_px: Lanes) -> tuple[Lanes, Lanes]:
        shift = coordinate_px - self.plane_px
        scale = 1.0 / (self.c + self.k * shift)
        return shift * scale, self.c * scale * scale

    def coordinate(self, height_mm: float) -> Lanes:
        return self.plane_px + self.c * height_mm / (1.0 - self.k * height_mm)
