"""Two pinhole cameras turned parallel, so that matching pixels lie in one row.

Both images are resampled onto planes parallel to the baseline (Fusiello, Trucco & Verri, Machine Vision and Applications 12,
16 (2000)), with the calibration, lens distortion included: a point at depth Z has the disparity ``d = f b / Z``.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from scenes.rig.projection import Projection
from scenes.support.errors import DecodeError

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

# Disparities added at both ends of the range, so that a match on its border has neighbours.
MARGIN_PX = 2
# OpenCV's matchers search a multiple of this many disparities.
STEP_PX = 16


@dataclass(frozen=True)
class Rectified:
    """The common frame of both cameras: x along the baseline, z between their axes."""

    cameras: tuple[Projection, Projection]
    R: Floats
    """(3, 3) from the world."""
    f_px: float
    baseline_mm: float
    at_px: Floats
    """(row, col, 2) column and row, before the canvas begins, of the left camera's pixels."""
    corner_px: tuple[float, float]
    """Column and row of the canvas's first pixel, of the left camera."""
    size: tuple[int, int]
    """Columns and rows of the canvas."""
    least_px: int
    """Smallest disparity searched."""
    count_px: int
    """Number of disparities searched."""

    @classmethod
    def of(
        cls, left: Projection, right: Projection, heights_mm: tuple[float, float]
    ) -> "Rectified":
        """The rectification for points between two heights; `DecodeError` where the cameras cannot see them."""
        way = right.origin_mm - left.origin_mm
        x = way / np.linalg.norm(way)
        z = left.axis + right.axis
        z = z - (z @ x) * x
        z = z / np.linalg.norm(z)
        turn = np.stack([x, np.cross(z, x), z])
        f = max(left.fx, left.fy, right.fx, right.fy)
        origin, direction = left.rays(left.pixel_centres())
        local = direction @ turn.T
        depths = []
        for height in heights_mm:
            depths.append((height - origin[..., 2]) / direction[..., 2] * local[..., 2])
        baseline = float(np.linalg.norm(way))
        if not (local[..., 2].min() > 0.1 and np.min(depths) > 0.0):
            raise DecodeError(
                f"heights {list(heights_mm)} mm are not in front of both cameras, or the baseline is nearly along the view: check "
                "the calibration and height_range_mm"
            )
        disparity = f * baseline / np.array(depths)
        least = int(np.floor(disparity.min())) - MARGIN_PX
        count = int(np.ceil(disparity.max())) + MARGIN_PX - least
        count = -(-count // STEP_PX) * STEP_PX
        at = f * local[..., :2] / local[..., 2:]
        low, high = at.reshape(-1, 2).min(axis=0), at.reshape(-1, 2).max(axis=0)
        # OpenCV leaves out the first columns, whose matches could lie left of the canvas.
        first = float(np.floor(low[0])) - count, float(np.floor(low[1]))
        size = tuple(int(np.ceil(n)) + 1 for n in high - np.array(first))
        return cls((left, right), turn, f, baseline, at, first, (size[0], size[1]), least, count)

    def resampled(self, image: Image, camera: int) -> Image:
        """An image of one camera on the canvas; 0 outside its field."""
        view = self.cameras[camera]
        columns, rows = np.arange(self.size[0]), np.arange(self.size[1])
        # The right canvas begins later by the smallest disparity, so that the search begins at 0.
        x = (columns + self.corner_px[0] - camera * self.least_px) / self.f_px
        y = (rows + self.corner_px[1]) / self.f_px
        direction = np.stack(np.broadcast_arrays(x, y[:, None], 1.0), axis=-1) @ self.R
        pixels, _ = view.project(view.origin_mm + direction)
        maps = np.nan_to_num(pixels - 0.5, nan=-10.0).astype(np.float32)
        return np.asarray(cv2.remap(image, maps, None, cv2.INTER_CUBIC))

    def read(self, canvas: Image) -> Floats:
        """Values (row, col) of an image on the canvas in the left camera's own pixels; NaN where a value is missing.

        Linear between pixels of one surface, the nearest one where they differ.
        """
        maps = (self.at_px - np.array(self.corner_px)).astype(np.float32)
        linear, nearest = (
            cv2.remap(canvas, maps, None, how, borderValue=float("nan"))
            for how in (cv2.INTER_LINEAR, cv2.INTER_NEAREST)
        )
        return np.asarray(np.where(np.abs(linear - nearest) <= 0.5, linear, nearest), np.float64)

    def height_mm(self, disparity_px: Floats) -> Floats:
        """World z (row, col) of the left camera's pixels with these disparities."""
        depth = self.f_px * self.baseline_mm / disparity_px
        ahead = np.concatenate([self.at_px / self.f_px, np.ones_like(depth)[..., None]], axis=-1)
        left = self.cameras[0].origin_mm
        return np.asarray(left[2] + depth * (ahead @ self.R[:, 2]))
