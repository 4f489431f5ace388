"""A device's geometry as plain numbers: rays of pixels, pixels of points, and Brown's lens distortion.

A device's frame is OpenCV's (x right, y down, z forward) and ``x_device = R @ X_world + t``. Continuous pixel
coordinates put a pixel's centre at integer + 0.5; OpenCV puts it at the integer, so a principal point taken from
OpenCV is half a pixel larger here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from scenes.support.errors import FringebenchError

# Beyond those of any lens; at much larger values arithmetic overflows.
Coefficient = Annotated[float, Field(ge=-1e12, le=1e12)]


Coefficients = tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient]


# Newton's method on the Brown polynomial converges quadratically; inside the monotone radius eight
# steps reach float64 rounding from the distorted point as the start.
UNDISTORT_STEPS = 8


@dataclass(frozen=True)
class Projection:
    """A device's geometry as plain numbers, the same form for every model.

    Lens coordinates are ``(x, y) = (X_d, Y_d)`` mm (telecentric) or ``(X_d/Z_d, Y_d/Z_d)`` (pinhole);
    pixels are ``u = fx distort(x) + cx``. `distortion` is OpenCV's (k1, k2, p1, p2, k3); `max_radius` bounds the
    undistorted radius inside which the radial polynomial is monotone: a point beyond it is not imaged.
    """

    telecentric: bool
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Coefficients
    R: NDArray[np.float64]
    """(3, 3) rotation from the world to the device."""
    t: NDArray[np.float64]
    """(3,) translation, mm."""
    max_radius: float

    @property
    def origin_mm(self) -> NDArray[np.float64]:
        """Centre of projection (pinhole) or a point of the axis (telecentric), world mm, (3,)."""
        origin: NDArray[np.float64] = -self.R.T @ self.t
        return origin

    @property
    def axis(self) -> NDArray[np.float64]:
        """Unit viewing direction in the world, (3,)."""
        axis: NDArray[np.float64] = self.R[2]
        return axis

    def project(self, points_mm: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels and depths of world points.

        Parameters
        ----------
        points_mm
            (..., 3) world points in mm.

        Returns
        -------
        pixels
            (..., 2) as (column, row), continuous, centres at +0.5. NaN for a point that is not imaged (behind a pinhole,
            beyond `max_radius`); a point outside the frame has pixels outside it.
        depth_mm
            (...,) distance along the axis in mm.
        """
        local = np.asarray(points_mm, dtype=np.float64) @ self.R.T + self.t
        depth = local[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.ones_like(depth) if self.telecentric else 1.0 / depth
            x, y = local[..., 0] * scale, local[..., 1] * scale
            imaged = x * x + y * y <= self.max_radius**2
            if not self.telecentric:
                imaged &= depth > 0
            x, y = distort(x, y, self.distortion)
            pixels = np.stack([self.fx * x + self.cx, self.fy * y + self.cy], axis=-1)
        return np.where(imaged[..., None], pixels, np.nan), depth

    def rays(self, pixels: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """World rays through pixels.

        Parameters
        ----------
        pixels
            (..., 2) continuous pixels as (column, row), centres at +0.5.

        Returns
        -------
        origin_mm
            (..., 3) a point of each ray, world mm.
        direction
            (..., 3) unit direction of each ray in the world.
        """
        pixels = np.asarray(pixels, dtype=np.float64)
        x = (pixels[..., 0] - self.cx) / self.fx
        y = (pixels[..., 1] - self.cy) / self.fy
        x, y = undistort(x, y, self.distortion)
        if self.telecentric:
            local = np.stack([x, y, np.zeros_like(x)], axis=-1)
            return (local - self.t) @ self.R, np.broadcast_to(self.axis, local.shape)
        direction = np.stack([x, y, np.ones_like(x)], axis=-1) @ self.R
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        return np.broadcast_to(self.origin_mm, direction.shape), direction

    def points_at(
        self, height_mm: ArrayLike, pixels: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """World points where the pixels' rays meet the plane z = `height_mm`.

        Parameters
        ----------
        height_mm
            World z in mm: one number, or one for each pixel (any shape that broadcasts with theirs).
        pixels
            Continuous pixels (..., 2) as (column, row); None: the centres of all pixels, (row, col, 2).

        Returns
        -------
        points_mm
            (..., 3) world points in mm; NaN where the height is NaN.

        Examples
        --------
        >>> import scenes
        >>> camera = scenes.load("step").camera.projection()
        >>> camera.points_at(1.5).shape == (camera.height, camera.width, 3)
        True
        """
        return self.ray_points(
            *self.rays(self.pixel_centres() if pixels is None else pixels), height_mm
        )

    @staticmethod
    def ray_points(
        origin_mm: NDArray[np.float64], direction: NDArray[np.float64], height_mm: ArrayLike
    ) -> NDArray[np.float64]:
        """Points where rays meet a plane of constant z.

        Parameters
        ----------
        origin_mm, direction
            Rays (..., 3) as `rays` returns them, world.
        height_mm
            z of the plane (...), mm.

        Returns
        -------
        ndarray of float64, (..., 3)
            World points, mm.
        """
        distance = np.subtract(height_mm, origin_mm[..., 2]) / direction[..., 2]
        return np.asarray(origin_mm + distance[..., None] * direction)

    def require_shape(self, shape: Sequence[int], what: str, error: type[FringebenchError]) -> None:
        """Raise `error` unless an image (row, col) has this device's size; `what` it shows is for the message."""
        rows, columns = shape
        if (rows, columns) != (self.height, self.width):
            raise error(
                f"the calibration's camera is {self.width} x {self.height} pixels, {what} are {columns} x {rows}: use the "
                "calibration of this camera at this resolution (resolution and calibrated_at set another)"
            )

    def pixel_centres(self) -> NDArray[np.float64]:
        """Continuous coordinates of all pixel centres.

        Returns
        -------
        ndarray of float64, (row, col, 2)
            Column and row of each centre, px: integers + 0.5.
        """
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)


def distort(x: Any, y: Any, coefficients: Coefficients) -> tuple[Any, Any]:
    """Brown's lens distortion of undistorted lens coordinates, OpenCV's formula and order k1, k2, p1, p2, k3.

    Written with arithmetic operators only, so that it accepts NumPy arrays and Dr.Jit arrays.
    """
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy = x * y
    return (
        x * radial + (2.0 * p1) * xy + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + (2.0 * p2) * xy,
    )


def distortion_jacobian(x: Any, y: Any, coefficients: Coefficients) -> tuple[Any, Any, Any]:
    """Derivatives of `distort`: (d xd / dx, d xd / dy = d yd / dx, d yd / dy); NumPy or Dr.Jit arrays."""
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3)))
    return (
        radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x,
        slope * x * y + 2.0 * (p1 * x + p2 * y),
        radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x,
    )


def undistort(
    xd: Any, yd: Any, coefficients: Coefficients, steps: int = UNDISTORT_STEPS
) -> tuple[Any, Any]:
    """Inverse of `distort` by Newton's method with the exact Jacobian; NumPy or Dr.Jit arrays."""
    if not any(coefficients):
        return xd, yd
    x, y = xd, yd
    for _ in range(steps):
        fx, fy = distort(x, y, coefficients)
        ex, ey = fx - xd, fy - yd
        jxx, cross, jyy = distortion_jacobian(x, y, coefficients)
        det = jxx * jyy - cross * cross
        x = x - (jyy * ex - cross * ey) / det
        y = y - (jxx * ey - cross * ex) / det
    return x, y


def monotone_radius(coefficients: Coefficients) -> float:
    """Largest undistorted radius up to which the radial polynomial still grows; infinity if it always does."""
    k1, k2, _, _, k3 = coefficients
    # d/dr of r (1 + k1 r^2 + k2 r^4 + k3 r^6), as a polynomial in r^2; denormal terms would overflow in `roots`
    terms = np.array([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    roots = np.roots(np.where(np.abs(terms) < 1e-30, 0.0, terms))
    turning = roots[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)].real
    return float(np.sqrt(turning.min())) if turning.size else float("inf")
