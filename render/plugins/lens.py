"""A device's geometry in Dr.Jit: camera rays out of pixels, projector pixels out of points.

Both plugins and the tracer use these formulas, so that the tracer and Mitsuba's own integrators have the same device.
Lens coordinates and pixels are those of `scenes.Projection`. A thin lens of a pinhole device has its pupil, a disk, in
the device's plane z = 0; that of a telecentric device has it at infinity, a disk of direction sines (sine condition).
Both are sampled uniformly.
"""

from dataclasses import dataclass
from typing import Any

from render.plugins.variant import dr, mi
from scenes.rig.devices import PinholeLens
from scenes.rig.projection import distort, undistort
from scenes.rig.projectors import Camera, Projector


@dataclass(frozen=True)
class Optics:
    """One device for one Mitsuba variant; numbers are opaque, so that all devices use the same compiled kernels."""

    telecentric: bool
    lens: Any
    """Radius of the pupil in mm (pinhole) or its sine (telecentric); None: no lens."""
    focus: Any
    focal: Any
    centre: Any
    size: Any
    distortion: tuple[float, float, float, float, float]
    max_radius2: Any
    rotation: Any
    translation: Any

    def ray(self, pixel: Any, lens_sample: Any) -> tuple[Any, Any]:
        """World origin (on the device's plane z = 0) and unit direction through a continuous pixel (x, y)."""
        distorted = (pixel - self.centre) / self.focal
        x, y = undistort(distorted.x, distorted.y, self.distortion)
        if self.telecentric:
            origin, direction = mi.Point3f(x, y, 0), mi.Vector3f(0, 0, 1)
            if self.lens is not None:
                direction = self._cone(lens_sample)
                origin = mi.Point3f(x, y, self.focus) - direction * (self.focus / direction.z)
        else:
            origin, direction = mi.Point3f(0), mi.Vector3f(x, y, 1)
            if self.lens is not None:
                origin = self._pupil(lens_sample)
                direction = direction * self.focus - origin
        return self.to_world(origin), self.turn_back(dr.normalize(direction))

    def light_source(self, local: Any, lens_sample: Any) -> Any:
        """Point of the device's plane z = 0 from which light reaches the point `local`, both in the device's frame."""
        if self.telecentric:
            if self.lens is None:
                return mi.Point3f(local.x, local.y, 0)
            direction = self._cone(lens_sample)
            return local - direction * (local.z / direction.z)
        return mi.Point3f(0) if self.lens is None else self._pupil(lens_sample)

    def pixel(self, local: Any, source: Any) -> tuple[Any, Any]:
        """Continuous projector pixel whose light goes from `source` to `local`, and whether it exists."""
        x, y = local.x, local.y
        if self.lens is not None:
            # The ray's point in the focus plane: all rays of one pixel meet there.
            step = self.focus / local.z
            x, y = dr.lerp(source.x, x, step), dr.lerp(source.y, y, step)
            if not self.telecentric:
                x, y = x / self.focus, y / self.focus
        elif not self.telecentric:
            x, y = x / local.z, y / local.z
        imaged = (local.z > 0) & (dr.square(x) + dr.square(y) <= self.max_radius2)
        if any(self.distortion):
            x, y = distort(x, y, self.distortion)
        pixel = mi.Point2f(x, y) * self.focal + self.centre
        lit = imaged & dr.all((pixel >= 0) & (pixel < self.size))
        # Coordinates of a missing pixel may be NaN, and 0 * NaN is NaN: a mask would not remove it.
        return dr.select(lit, pixel, 0), lit

    def axis(self) -> Any:
        """Unit viewing direction in the world."""
        return self.turn_back(mi.Vector3f(0, 0, 1))

    def to_local(self, point: Any) -> Any:
        """World point in the device's frame."""
        return mi.Point3f(self.rotation @ mi.Vector3f(point)) + self.translation

    def to_world(self, local: Any) -> Any:
        """Device point in the world."""
        return mi.Point3f(self.turn_back(mi.Vector3f(local - self.translation)))

    def turn_back(self, direction: Any) -> Any:
        """Direction in the device's frame in the world."""
        return self.rotation.T @ mi.Vector3f(direction)

    def _pupil(self, lens_sample: Any) -> Any:
        disk = mi.warp.square_to_uniform_disk_concentric(lens_sample) * self.lens
        return mi.Point3f(disk.x, disk.y, 0)

    def _cone(self, lens_sample: Any) -> Any:
        disk = mi.warp.square_to_uniform_disk_concentric(lens_sample) * self.lens
        return mi.Vector3f(disk.x, disk.y, dr.sqrt(1 - dr.squared_norm(disk)))


def optics(device: Camera | Projector) -> Optics:
    """Geometry of a camera or projector for the Mitsuba variant in use."""
    p = device.projection()
    lens = device.lens
    if lens is None:
        size, focus = None, None
    else:
        half = lens.aperture_mm / 2 if isinstance(lens, PinholeLens) else lens.numerical_aperture
        size, focus = dr.opaque(mi.Float, half), dr.opaque(mi.Float, lens.focus_mm)
    return Optics(
        p.telecentric,
        size,
        focus,
        dr.opaque(mi.Vector2f, [p.fx, p.fy]),
        dr.opaque(mi.Point2f, [p.cx, p.cy]),
        dr.opaque(mi.Point2f, [p.width, p.height]),
        p.distortion,
        dr.opaque(mi.Float, p.max_radius**2),
        _opaque(mi.Matrix3f(p.R.tolist())),
        _opaque(mi.Vector3f(p.t.tolist())),
    )


def _opaque(value: Any) -> Any:
    dr.make_opaque(value)
    return value
