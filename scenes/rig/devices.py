"""Geometry of cameras and projectors: which ray a pixel sees, on which pixel a point is imaged.

A device's frame is OpenCV's (x right, y down, z forward) and ``x_device = R @ X_world + t``. Continuous pixel
coordinates put a pixel's centre at integer + 0.5; OpenCV puts it at the integer, so a principal point taken from
OpenCV is half a pixel larger here.
"""

from types import MappingProxyType
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, PositiveFloat, PositiveInt, Tag, model_validator

from scenes.rig.calibration_numbers import off_rotation
from scenes.rig.illumination_map import IlluminationMap, interpolated
from scenes.rig.projection import Coefficients, Projection, distort, monotone_radius, undistort
from scenes.support.frozen import Frozen

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Resolution = tuple[PositiveInt, PositiveInt]
Focal = Annotated[float, Field(ge=1e-3, le=1e7)]
Principal = Annotated[float, Field(ge=-1e7, le=1e7)]
FieldWidth = Annotated[float, Field(ge=1e-6, le=1e7)]


# Float32, in which light is traced, resolves 1 mm here.
MAX_COORDINATE_MM = 1e7


def require_reach(what: str, *coordinates: float) -> None:
    """Raise `ValueError` for coordinates beyond `MAX_COORDINATE_MM`, where arithmetic loses its precision."""
    farthest = max(map(abs, coordinates))
    if farthest > MAX_COORDINATE_MM:
        raise ValueError(
            f"{what} reach to {farthest:.3g}: keep them within {MAX_COORDINATE_MM:.0e} mm"
        )


# Keys of a device that is equally bright all over its image, and their values.
EVEN = MappingProxyType({"vignetting": (), "evenness": None, "illumination_map": None})


class LookAt(Frozen):
    """A pose given by the device's position and the point it looks at."""

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
        """Rotation and translation of ``x_device = R X + t``.

        Returns
        -------
        R, t : ndarray of float64, (3, 3) and (3,)
            Rotation, and translation in mm.
        """
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
        off, determinant = off_rotation(self.R)
        if off > 1e-4 or determinant < 0:
            raise ValueError(
                f"R is no rotation (R R^T is off the identity by {off:.3g}, determinant {determinant:.3g}): give an "
                "orthonormal, right-handed matrix"
            )
        return self

    def matrix(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rotation, orthonormalised, and translation of ``x_device = R X + t``.

        Returns
        -------
        R, t : ndarray of float64, (3, 3) and (3,)
            Rotation, and translation in mm.
        """
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
    """A thin lens in a pinhole device: points off the focus plane are blurred."""

    aperture_mm: PositiveFloat
    """Diameter of the entrance pupil."""
    focus_mm: PositiveFloat
    """Depth of the plane in focus, along the axis from the pupil."""


class TelecentricLens(Frozen):
    """Finite aperture of a telecentric device: the blur depends only on the distance from the focus plane."""

    numerical_aperture: Annotated[float, Field(gt=0.0, lt=0.9)]
    """Sine of the half angle of the cone of accepted rays."""
    focus_mm: PositiveFloat
    """Depth of the plane in focus, along the axis from the device's origin."""


class RigDevice(Frozen):
    """Fields common to all cameras and projectors."""

    resolution: Resolution
    """Columns, rows."""
    pose: Pose
    vignetting: Annotated[tuple[float, ...], Field(max_length=4)] = ()
    """a1, a2, ...: illumination is ``1 + a1 r^2 + a2 r^4 ...`` of the image centre's, r = 1 in the corners."""
    evenness: tuple[float, float, float, float, float] | None = None
    """Of light that is not centred or not round: coefficients of u, v, u^2, u v, v^2 added to 1, where u and v go from -1 to
    1 across the image. Multiplies `vignetting`."""
    illumination_map: IlluminationMap | None = None
    """Measured, as an image. Multiplies the others."""

    @model_validator(mode="after")
    def _corners_have_light(self) -> Self:
        width, height = self.resolution
        across = np.linspace(0.0, 1.0, 65)
        share = self.smooth_illumination(width * across, height * across[:, None])
        if not (np.isfinite(share).all() and np.min(share) > 0.0):
            key = "vignetting" if self.evenness is None else "vignetting times evenness"
            raise ValueError(
                f"{key} {[*self.vignetting, *(self.evenness or ())]} leaves no light somewhere in the image: use smaller "
                "coefficients, e.g. vignetting = [-0.3]"
            )
        return self

    def relative_illumination(self, column: Any, row: Any) -> Any:
        """Illumination over the image centre's at continuous pixels (NumPy arrays), map included; raises `FileError` for a map that is gone."""
        share = self.smooth_illumination(column, row)
        if self.illumination_map is not None:
            width, height = self.resolution
            values = self.illumination_map.values()
            share = share * interpolated(values, column / width, row / height)
        return share

    def smooth_illumination(self, column: Any, row: Any) -> Any:
        """That of `vignetting` and `evenness` alone; NumPy or Dr.Jit arrays."""
        width, height = self.resolution
        x, y = column - width / 2, row - height / 2
        r2 = (x * x + y * y) * (4.0 / (width**2 + height**2))
        share = 0.0 * r2
        for a in reversed(self.vignetting):
            share = (share + a) * r2
        share = 1.0 + share
        if self.evenness is not None:
            u, v = x * (2.0 / width), y * (2.0 / height)
            a, b, c, d, e = self.evenness
            share = share * (1.0 + (a + c * u + d * v) * u + (b + e * v) * v)
        return share

    @property
    def even(self) -> bool:
        """Whether illumination is the same all over the image."""
        return self.polynomials_even and self.illumination_map is None

    @property
    def polynomials_even(self) -> bool:
        """Whether neither `vignetting` nor `evenness` is given."""
        return not self.vignetting and self.evenness is None


class Telecentric(RigDevice):
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
        """The geometry as plain numbers: rays of pixels, pixels of points."""
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


class Pinhole(RigDevice):
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
