"""Calibrated geometry per pixel: the camera's ray meets the projector's fringe.

Everything is arithmetic on arrays, so NumPy and Dr.Jit run the same formulas, in float64. A camera ray is kept twice:
in the world, where height is z, and in the projector's frame, where the fringe is a surface of constant coordinate.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.patterns import Axis
from scenes.rig.projection import (
    UNDISTORT_STEPS,
    Projection,
    distort,
    distortion_jacobian,
    undistort,
)

# Lanes, NumPy array or float.
Real = Any
Triple = tuple[Real, Real, Real]

MOST_STEPS = 12


@dataclass(frozen=True)
class Ray:
    """Points ``origin + t direction`` of each pixel's ray, in the world (mm) and in the projector's frame (mm)."""

    world_origin: Triple
    world_direction: Triple
    local_origin: Triple
    local_direction: Triple

    def t_at(self, height_mm: Real) -> Real:
        """Ray parameter where the ray has that height."""
        return (height_mm - self.world_origin[2]) / self.world_direction[2]

    def point(self, t: Real) -> Triple:
        """World point at a ray parameter, mm."""
        (x, y, z), (dx, dy, dz) = self.world_origin, self.world_direction
        return x + t * dx, y + t * dy, z + t * dz


def _reciprocal(value: Real) -> Real:
    return 1.0 / value


def _product_and_sum(a: Real, b: Real, c: Real) -> Real:
    return a * b + c


@dataclass(frozen=True)
class Arithmetic:
    """What NumPy and Dr.Jit do differently; the defaults are NumPy's."""

    number: Callable[[float], Real] = float
    """A constant of the rig: a kernel takes it as an argument, so that another rig compiles no other kernel."""
    invert: Callable[[Real], Real] = _reciprocal
    fma: Callable[[Real, Real, Real], Real] = _product_and_sum
    """``a * b + c``, in one step where the machine has one: compilers may not join them by themselves."""


NUMPY = Arithmetic()


@dataclass(frozen=True)
class Rig:
    """A camera and one projector as numbers: floats for NumPy, or a kernel's arguments for Dr.Jit."""

    camera: Projection
    projector: Projection
    arithmetic: Arithmetic = NUMPY
    camera_steps: int = UNDISTORT_STEPS
    """Newton steps that undo the camera's lens distortion."""
    projector_steps: int = MOST_STEPS
    """Newton steps that meet the projector's distorted fringe."""

    @property
    def parallel(self) -> bool:
        """Whether camera rays are parallel, and projector rays too: all geometry is affine."""
        return self.camera.telecentric and self.projector.telecentric

    def ray(self, column_px: Real, row_px: Real) -> Ray:
        """Camera rays in mm, in the world and in the projector's frame, through continuous pixels (centres at + 0.5)."""
        camera, n = self.camera, self.arithmetic.number
        x, y, plane = column_px, row_px, camera.R.T
        if any(camera.distortion):
            x = (x - n(camera.cx)) * n(1.0 / camera.fx)
            y = (y - n(camera.cy)) * n(1.0 / camera.fy)
            x, y = undistort(x, y, camera.distortion, self.camera_steps)
        else:
            # From pixels at once: columns of the matrix are what a pixel to the right, one down, and the axis add.
            focal = np.diag([1.0 / camera.fx, 1.0 / camera.fy, 1.0])
            focal[:2, 2] = -camera.cx / camera.fx, -camera.cy / camera.fy
            plane = plane @ focal
        axis, origin = camera.R[2], camera.origin_mm
        turn = self.projector.R
        local_origin = turn @ origin + self.projector.t
        if not camera.telecentric:
            return Ray(
                self._numbers(origin),
                self._plane(plane, x, y),
                self._numbers(local_origin),
                self._plane(turn @ plane, x, y),
            )
        # Where the axis is the lens plane's third direction, it moves the origin instead.
        plane = plane - np.outer(axis, [0.0, 0.0, 1.0])
        return Ray(
            self._plane(plane, x, y, origin),
            self._numbers(axis),
            self._plane(turn @ plane, x, y, local_origin),
            self._numbers(turn @ axis),
        )

    def coordinate(self, ray: Ray, t: Real, axis: Axis) -> tuple[Real, Real]:
        """Projector coordinate in px of the point at parameter t of a ray, and its derivative by t."""
        xd, dxd = self._lens(ray, t, axis)
        n = self.arithmetic.number
        focal, centre = map(n, self._intrinsics(axis))
        return self.arithmetic.fma(xd, focal, centre), dxd * focal

    @property
    def distorts(self) -> bool:
        """Whether either lens bends straight lines."""
        return any(self.camera.distortion) or any(self.projector.distortion)

    def coordinate_on_plane(
        self, column_px: Real, row_px: Real, height_mm: float, axis: Axis
    ) -> Real:
        """Projector coordinate in px of the plane ``z = height_mm`` at continuous camera pixels.

        A homography (Hartley & Zisserman 2004, section 2.3), so for a rig without distortion: half the work of a ray.
        """
        columns = _from_plane(self.camera, height_mm).T
        # The adjugate: an inverse up to its scale, which exists for any plane.
        onto_plane = np.cross(np.roll(columns, -1, axis=0), np.roll(columns, -2, axis=0))
        matrix = _from_plane(self.projector, height_mm) @ onto_plane
        matrix = matrix[[0 if axis == "column" else 1, 2]] / np.abs(matrix).max()
        fma = self.arithmetic.fma
        over, under = (
            fma(a, column_px, fma(b, row_px, c)) for a, b, c in map(self._numbers, matrix)
        )
        return over * self.arithmetic.invert(under)

    def meet(self, ray: Ray, coordinate_px: Real, axis: Axis) -> tuple[Real, Real]:
        """Parameter t at which a ray meets a fringe, and d t / d coordinate there, per px.

        Closed form without projector distortion (a ray meets a plane); with it, Newton's method on the ray from there.
        """
        focal, centre = self._intrinsics(axis)
        number, invert, fma = self.arithmetic.number, self.arithmetic.invert, self.arithmetic.fma
        scale = number(1.0 / focal)
        target = fma(coordinate_px, scale, number(-centre / focal))
        i = 0 if axis == "column" else 1
        q, s = ray.local_origin, ray.local_direction
        if self.projector.telecentric:
            slope = invert(s[i])
            t = (target - q[i]) * slope
        else:
            inverse = invert(fma(-target, s[2], s[i]))
            t = fma(target, q[2], -q[i]) * inverse
            slope = fma(t, s[2], q[2]) * inverse
        if any(self.projector.distortion):
            for _ in range(self.projector_steps):
                xd, steep = self._lens(ray, t, axis)
                t = t - (xd - target) * invert(steep)
            slope = invert(self._lens(ray, t, axis)[1])
        return t, slope * scale

    def _lens(self, ray: Ray, t: Real, axis: Axis) -> tuple[Real, Real]:
        """Distorted lens coordinate along `axis` at t, and its derivative by t."""
        dx, dy, dz = ray.local_direction
        x, y, z = map(self.arithmetic.fma, (t, t, t), ray.local_direction, ray.local_origin)
        if not self.projector.telecentric:
            scale = self.arithmetic.invert(z)
            x, y = x * scale, y * scale
            dx, dy = (dx - x * dz) * scale, (dy - y * dz) * scale
        coefficients = self.projector.distortion
        if not any(coefficients):
            return (x, dx) if axis == "column" else (y, dy)
        xd, yd = distort(x, y, coefficients)
        xx, cross, yy = distortion_jacobian(x, y, coefficients)
        return (xd, xx * dx + cross * dy) if axis == "column" else (yd, cross * dx + yy * dy)

    def _intrinsics(self, axis: Axis) -> tuple[float, float]:
        p = self.projector
        return (p.fx, p.cx) if axis == "column" else (p.fy, p.cy)

    def _numbers(self, vector: Any) -> Triple:
        n = self.arithmetic.number
        return n(float(vector[0])), n(float(vector[1])), n(float(vector[2]))

    def _plane(self, matrix: Any, x: Real, y: Real, plus: Any = (0.0, 0.0, 0.0)) -> Triple:
        """``matrix @ (x, y, 1) + plus``."""
        a, b = self._numbers(matrix[:, 0]), self._numbers(matrix[:, 1])
        c, fma = self._numbers(matrix[:, 2] + plus), self.arithmetic.fma
        return (
            fma(a[0], x, fma(b[0], y, c[0])),
            fma(a[1], x, fma(b[1], y, c[1])),
            fma(a[2], x, fma(b[2], y, c[2])),
        )


def _from_plane(device: Projection, height_mm: float) -> NDArray[np.float64]:
    """Matrix (3, 3) from ``(X, Y, 1)`` in the plane ``z = height_mm`` to homogeneous pixels."""
    pose = np.column_stack([device.R[:, :2], height_mm * device.R[:, 2] + device.t])
    if device.telecentric:
        pose[2] = 0.0, 0.0, 1.0
    lens = np.array([[device.fx, 0.0, device.cx], [0.0, device.fy, device.cy], [0.0, 0.0, 1.0]])
    return np.asarray(lens @ pose)
