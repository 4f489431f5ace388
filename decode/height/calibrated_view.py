"""A calibrated camera and projector, seen from the host to plan a kernel: ranges, sensitivities, Newton steps."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.height.rig_geometry import MOST_STEPS, NUMPY, Arithmetic, Rig
from scenes.acquisition.patterns import Axis
from scenes.rig.calibration import Calibration
from scenes.rig.projection import UNDISTORT_STEPS, Projection
from scenes.support.errors import DecodeError

# What iterations may leave, in mm of height on the largest rigs: far below any phase noise.
CONVERGED_MM = 1e-9


def _inside(projector: Projection, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
    pixels = projector.project(points_mm)[0]
    size = (projector.width, projector.height)
    return np.asarray(((pixels >= 0.0) & (pixels <= size)).all(axis=-1))


@lru_cache(maxsize=16)
def view_of(calibration: Calibration, projector: int) -> "CalibratedView":
    """The one `CalibratedView` of a projector: what it computes takes a millisecond, and is kept while its calibration is."""
    return CalibratedView(calibration, projector)


@dataclass(frozen=True, eq=False)
class CalibratedView:
    """A calibrated camera and projector, seen from the host to plan a kernel: float64 NumPy on a coarse grid."""

    calibration: Calibration
    projector: int

    def __post_init__(self) -> None:
        if self.calibration.screens:
            raise DecodeError(
                "the rig has a screen, which a surface mirrors: it has no projector to triangulate with; decode.reconstruct "
                "measures slopes with it"
            )
        known = len(self.calibration.projectors)
        if not 0 <= self.projector < known:
            raise DecodeError(
                f"frames name projector {self.projector}, but the calibration has {known}: "
                "give a calibration of every projector"
            )

    @cached_property
    def rig(self) -> Rig:
        """The rig in plain floats."""
        return Rig(
            self.calibration.camera.projection(),
            self.calibration.projectors[self.projector].projection(),
        )

    def grid(self, size: int = 9) -> tuple[Any, Any]:
        """Column and row coordinates of a coarse grid over the whole image, each (size, size)."""
        camera = self.rig.camera
        columns, rows = np.meshgrid(
            np.linspace(0.0, camera.width, size), np.linspace(0.0, camera.height, size)
        )
        return columns, rows

    def band_px(self, axis: Axis, heights_mm: tuple[float, float]) -> float:
        """Range of projector coordinates that one pixel can show within the heights, the widest of all pixels.

        Twice the larger side about the coordinate of the middle height.
        """
        if (axis, heights_mm) not in self._bands:
            self._bands[axis, heights_mm] = self._band_px(axis, heights_mm)
        return self._bands[axis, heights_mm]

    @cached_property
    def _bands(self) -> dict[tuple[Axis, tuple[float, float]], float]:
        return {}

    def _band_px(self, axis: Axis, heights_mm: tuple[float, float]) -> float:
        rig = self.rig
        ray = rig.ray(*self.grid())
        low, high = heights_mm
        below, middle, above = (
            rig.coordinate(ray, ray.t_at(h), axis)[0] for h in (low, (low + high) / 2.0, high)
        )
        return 2.0 * float(np.max(np.maximum(np.abs(below - middle), np.abs(above - middle))))

    def sensitivity(self, axis: Axis) -> float:
        """Median |d coordinate / d height| over the image at mid volume, px per mm."""
        if axis not in self._sensitivities:
            self._sensitivities[axis] = self._sensitivity(axis)
        return self._sensitivities[axis]

    @cached_property
    def _sensitivities(self) -> dict[Axis, float]:
        return {}

    def _sensitivity(self, axis: Axis) -> float:
        rig = self.rig
        ray = rig.ray(*self.grid())
        middle = sum(self.calibration.height_range_mm) / 2.0
        slope = rig.coordinate(ray, ray.t_at(middle), axis)[1] / ray.world_direction[2]
        return float(np.median(np.abs(slope)))

    def locating_rig(self, arithmetic: Arithmetic = NUMPY) -> Rig:
        """The rig for a kernel that only asks where heights are seen: fringes along the baseline can be used for that too."""
        return replace(self.rig, arithmetic=arithmetic)

    def kernel_rig(self, axis: Axis, arithmetic: Arithmetic = NUMPY) -> Rig:
        """The rig for a kernel's arithmetic, with as many Newton steps as this lens needs and no more.

        Raises `DecodeError` if they do not converge inside the working volume.
        """
        if axis not in self._steps:
            self._steps[axis] = self._converging(axis)
        camera_steps, projector_steps = self._steps[axis]
        rig = self.rig
        return Rig(rig.camera, rig.projector, arithmetic, camera_steps, projector_steps)

    @cached_property
    def _steps(self) -> dict[Axis, tuple[int, int]]:
        return {}

    def _converging(self, axis: Axis) -> tuple[int, int]:
        """Fewest Newton steps that undo the camera's lens and meet the projector's fringe."""
        rig = self.rig
        columns, rows = self.grid(17)
        exact = rig.ray(columns, rows)
        low, high = self.calibration.height_range_mm
        points = [np.stack(exact.point(exact.t_at(height)), axis=-1) for height in (low, high)]
        lit = [_inside(rig.projector, point) for point in points]
        if not any(inside.any() for inside in lit):
            raise DecodeError(
                f"the fields of view of camera and projector do not overlap within height_range_mm {[low, high]}: "
                "check the calibration's poses (x_device = R X + t, mm)"
            )

        def off(camera_steps: int, projector_steps: int) -> float:
            tried = replace(rig, camera_steps=camera_steps, projector_steps=projector_steps)
            ray = tried.ray(columns, rows)
            worst = 0.0
            for point, inside in zip(points, lit, strict=True):
                at = rig.projector.project(point)[0][..., 0 if axis == "column" else 1]
                found = tried.meet(ray, at, axis)[0]
                gap = np.abs(ray.point(found)[2] - point[..., 2])[inside]
                # A NaN is no convergence, so it must not be lost in a maximum.
                worst = max(worst, np.inf if np.isnan(gap).any() else float(gap.max(initial=0.0)))
            return worst

        with np.errstate(all="ignore"):
            for steps in range(1, MOST_STEPS + 1):
                camera_steps = min(steps, UNDISTORT_STEPS) if any(rig.camera.distortion) else 0
                projector_steps = steps if any(rig.projector.distortion) else 0
                if off(camera_steps, projector_steps) < CONVERGED_MM:
                    return camera_steps, projector_steps
        raise DecodeError(
            f"camera rays and projector {axis}s do not meet within height_range_mm {[low, high]}: the fringes run "
            f"along the baseline, or lens distortion {rig.projector.distortion} folds over there; use the other fringe "
            "direction or check the calibration"
        )
