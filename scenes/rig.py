"""Cameras and projectors as geometry: where a pixel looks, where a point lands.

A device's frame is OpenCV's (x right, y down, z forward) and ``x_device = R @ X_world + t``. Continuous pixel
coordinates put a pixel's centre at integer + 0.5; OpenCV puts it at the integer, so a principal point taken from
OpenCV is half a pixel larger here.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag, model_validator

from scenes.frozen import Frozen

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Resolution = tuple[PositiveInt, PositiveInt]
# No lens comes near these limits; far beyond them arithmetic overflows.
Coefficient = Annotated[float, Field(ge=-1e12, le=1e12)]
Coefficients = tuple[Coefficient, Coefficient, Coefficient, Coefficient, Coefficient]
Focal = Annotated[float, Field(ge=1e-3, le=1e7)]
Principal = Annotated[float, Field(ge=-1e7, le=1e7)]
FieldWidth = Annotated[float, Field(ge=1e-6, le=1e7)]

# Newton's method on the Brown polynomial converges quadratically; inside the monotone radius eight
# steps reach float64 rounding from the distorted point as the start.
UNDISTORT_STEPS = 8


# Float32, in which light is traced, resolves 1 mm here.
FARTHEST_MM = 1e7


def require_reach(what: str, *coordinates: float) -> None:
    """`ValueError` for a place that no device stands at: arithmetic overflows long before numbers end."""
    farthest = max(map(abs, coordinates))
    if farthest > FARTHEST_MM:
        raise ValueError(f"{what} reach to {farthest:.3g}: keep them within {FARTHEST_MM:.0e} mm")


class LookAt(Frozen):
    """A pose from where the device stands and what it looks at."""

    origin_mm: Vector
    """Position of the device (a telecentric device: any point on its axis)."""
    target_mm: Vector = (0.0, 0.0, 0.0)
    """Point on the optical axis."""
    up: Vector = (0.0, 1.0, 0.0)
    """World direction that is up in the image."""

    @model_validator(mode="after")
    def _not_degenerate(self) -> Self:
        require_reach("origin_mm, target_mm and up", *self.origin_mm, *self.target_mm, *self.up)
        axis = np.subtract(self.target_mm, self.origin_mm)
        if np.linalg.norm(axis) < 1e-9:
            raise ValueError("origin_mm and target_mm coincide: set them apart")
        if np.linalg.norm(np.cross(axis, self.up)) < 1e-9 * np.linalg.norm(axis):
            raise ValueError("up is parallel to the viewing direction: choose another up")
        return self

    def matrix(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation (3, 3) and translation (3,) in mm of ``x_device = R X + t``."""
        origin = np.asarray(self.origin_mm)
        z = np.subtract(self.target_mm, origin)
        z = z / np.linalg.norm(z)
        x = np.cross(z, self.up)
        x = x / np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z])
        return rotation, -rotation @ origin


class Extrinsics(Frozen):
    """A pose as OpenCV gives it: ``x_device = R X_world + t``."""

    R: Matrix
    t_mm: Vector

    @model_validator(mode="after")
    def _is_rotation(self) -> Self:
        require_reach("R and t_mm", *np.ravel(self.R), *self.t_mm)
        rotation = np.asarray(self.R)
        error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if error > 1e-4 or np.linalg.det(rotation) < 0:
            raise ValueError(
                f"R is no rotation (R R^T is off the identity by {error:.3g}, "
                f"determinant {np.linalg.det(rotation):.3g}): give an orthonormal, right-handed matrix"
            )
        return self

    def matrix(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation (3, 3), re-orthonormalised, and translation (3,) in mm."""
        left, _, right = np.linalg.svd(np.asarray(self.R))
        return left @ right, np.asarray(self.t_mm, dtype=np.float64)


def _pose_kind(value: Any) -> str:
    matrix = "R" in value if isinstance(value, dict) else isinstance(value, Extrinsics)
    return "matrix" if matrix else "look_at"


Pose = Annotated[
    Annotated[LookAt, Tag("look_at")] | Annotated[Extrinsics, Tag("matrix")],
    Discriminator(_pose_kind),
]


class PinholeLens(Frozen):
    """A thin lens in a pinhole device: points off the focus plane blur."""

    aperture_mm: PositiveFloat
    """Diameter of the entrance pupil."""
    focus_mm: PositiveFloat
    """Depth of the plane in focus, along the axis from the pupil."""


class TelecentricLens(Frozen):
    """Finite aperture of a telecentric device: points off the focus plane blur alike everywhere."""

    numerical_aperture: Annotated[float, Field(gt=0.0, lt=0.9)]
    """Sine of the half angle of the cone of accepted rays."""
    focus_mm: PositiveFloat
    """Depth of the plane in focus, along the axis from the device's origin."""


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
    t: NDArray[np.float64]
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
        """Image world points.

        Returns pixels (..., 2) as (column, row), continuous with centres at +0.5, and depth (...,) in mm. A point
        that is not imaged (behind a pinhole, beyond `max_radius`) has NaN pixels; one outside the frame does not.
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
        """World rays (origin mm (..., 3), unit direction (..., 3)) through continuous pixels (..., 2)."""
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

    def pixel_centres(self) -> NDArray[np.float64]:
        """Continuous coordinates of all pixel centres, (row, col, 2)."""
        u, v = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([u, v], axis=-1)


class Device(Frozen):
    """What cameras and projectors of every model share."""

    resolution: Resolution
    """Columns, rows."""
    pose: Pose


class Telecentric(Device):
    """Parallel rays: magnification does not depend on depth."""

    model: Literal["telecentric"] = "telecentric"
    field_width_mm: FieldWidth
    """Width of the field of view on a plane perpendicular to the axis; pixels are square."""
    lens: TelecentricLens | None = None
    """Absent: infinite depth of field."""

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel in object space."""
        return self.field_width_mm / self.resolution[0]

    def projection(self) -> Projection:
        """The geometry as plain numbers."""
        rotation, translation = self.pose.matrix()
        width, height = self.resolution
        scale = 1.0 / self.pixel_mm
        return Projection(
            True,
            width,
            height,
            scale,
            scale,
            width / 2,
            height / 2,
            (0.0, 0.0, 0.0, 0.0, 0.0),
            rotation,
            translation,
            np.inf,
        )


class Pinhole(Device):
    """OpenCV's pinhole with Brown distortion; intrinsics in this project's pixel coordinates."""

    model: Literal["pinhole"] = "pinhole"
    fx_px: Focal
    fy_px: Focal
    cx_px: Principal
    """Principal column, continuous, pixel centres at +0.5 (OpenCV's value + 0.5)."""
    cy_px: Principal
    calibrated_at: Resolution | None = None
    """Columns, rows the intrinsics belong to; absent: `resolution`. Other resolutions keep the field of view."""
    distortion: Coefficients = (0.0, 0.0, 0.0, 0.0, 0.0)
    """OpenCV's order: k1, k2, p1, p2, k3."""
    lens: PinholeLens | None = None
    """Absent: infinite depth of field."""

    @model_validator(mode="after")
    def _field_is_imaged(self) -> Self:
        geometry = self.projection()
        w, h = geometry.width, geometry.height
        corners = np.array([[0, 0], [w, 0], [0, h], [w, h]], dtype=np.float64)
        x = (corners[:, 0] - geometry.cx) / geometry.fx
        y = (corners[:, 1] - geometry.cy) / geometry.fy
        with np.errstate(all="ignore"):
            back = distort(*undistort(x, y, self.distortion), self.distortion)
            off = float(np.max(np.hypot(back[0] - x, back[1] - y)))
        if not off < 1e-9:
            raise ValueError(
                f"distortion {self.distortion} folds over inside the image (a corner has no ray): "
                "use coefficients that stay monotone out to the corners"
            )
        return self

    def projection(self) -> Projection:
        """The geometry as plain numbers, intrinsics scaled from `calibrated_at` to `resolution`."""
        rotation, translation = self.pose.matrix()
        width, height = self.resolution
        columns, rows = self.calibrated_at or self.resolution
        sx, sy = width / columns, height / rows
        return Projection(
            False,
            width,
            height,
            self.fx_px * sx,
            self.fy_px * sy,
            self.cx_px * sx,
            self.cy_px * sy,
            self.distortion,
            rotation,
            translation,
            monotone_radius(self.distortion),
        )


def distort(x: Any, y: Any, coefficients: Coefficients) -> tuple[Any, Any]:
    """Brown's lens distortion of undistorted lens coordinates, OpenCV's formula and order k1, k2, p1, p2, k3.

    Written with arithmetic operators only, so that NumPy arrays and Dr.Jit arrays both go through it.
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
