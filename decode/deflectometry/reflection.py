"""Which surface element mirrors a camera's ray to a point of a screen: closed forms, and their standard deviations.

A ray of unit direction d that leaves a mirror in the unit direction r was mirrored by the normal ``n = (r - d) / |r - d|``.
With the screen in two positions the points s1 and s2 at which a pixel sees it are two points of the mirrored ray, whose
meeting with the camera's ray is the surface (T. Bothe et al., Proc. SPIE 5457, 411 (2004)). With one position the direction
to it is known once the surface point is: M. C. Knauer, J. Kaminski and G. Haeusler, Phase measuring deflectometry: a new
approach to measure specular free-form surfaces, Proc. SPIE 5457, 366 (2004).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.rig.projectors import Screen

Floats = NDArray[np.float64]

# Step of a screen's coordinate for derivatives, px.
STEP_PX = 1e-2


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays of a camera's pixels, world."""

    origin_mm: Floats
    """(pixel, 3)."""
    direction: Floats
    """(pixel, 3), unit."""

    def points(self, distance_mm: Floats) -> Floats:
        """World points at distances (pixel,) from the origins, (pixel, 3) mm."""
        return self.origin_mm + distance_mm[:, None] * self.direction

    def distance_at(self, height_mm: Floats | float) -> Floats:
        """Distances (pixel,) at which the rays have that height."""
        return np.asarray((height_mm - self.origin_mm[:, 2]) / self.direction[:, 2])


@dataclass(frozen=True, eq=False)
class Looks:
    """Where each pixel sees each position of a screen; arrays are (screen, axis, ...)."""

    screens: tuple[Screen, ...]
    coordinates_px: Floats
    sigma_px: Floats
    """Standard deviations of their noise, independent of each other as they come from different frames."""
    edge_px: Floats
    """How far an edge in the pixel's area moves all of them together, see `decode.deflectometry.edges`."""

    def of(self, mask: NDArray[np.bool_]) -> "Looks":
        """Of chosen pixels."""
        parts = (part[..., mask] for part in (self.coordinates_px, self.sigma_px, self.edge_px))
        return Looks(self.screens, *parts)

    def points(self, coordinates_px: Floats) -> list[Floats]:
        """See `seen_points`."""
        return seen_points(self.screens, coordinates_px)

    def deviation(self, function: Callable[[Floats], Floats]) -> Floats:
        """Standard deviations (quantity, pixel) of a function of coordinates, of noise and edges, to first order."""
        noise = spread(function, self.coordinates_px, self.sigma_px)
        edge = function(self.coordinates_px + self.edge_px) - function(self.coordinates_px)
        return np.asarray(np.hypot(noise, edge))


def seen_points(screens: Sequence[Screen], coordinates_px: Floats) -> list[Floats]:
    """World points of pixels (screen, axis, pixel) of each screen, each (pixel, 3) mm."""
    return [
        screen.projection().rays(np.moveaxis(own, 0, -1))[0]
        for screen, own in zip(screens, coordinates_px, strict=True)
    ]


def meeting(rays: Rays, near: Floats, far: Floats) -> tuple[Floats, Floats]:
    """Distance along each ray at which it passes closest to the line through two points, and by how much it misses it.

    ``t = ((s1 - o) x e) . (d x e) / |d x e|^2`` for the line's unit direction e; the gap has a sign. Both (pixel,) mm.
    """
    along = _unit(far - near)
    across = np.cross(rays.direction, along)
    square = _dot(across, across)
    to = near - rays.origin_mm
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _dot(np.cross(to, along), across) / square
        gap = _dot(to, across) / np.sqrt(square)
    return distance, gap


def normals(rays: Rays, point: Floats, seen: Sequence[Floats]) -> Floats:
    """Unit normals (pixel, 3) that mirror the rays at points to what they see, facing the camera.

    The direction to several points of the mirrored ray is their least-squares line through the surface point: farther ones
    tell it better, ``r ~ sum |s - p| (s - p)``.
    """
    away = np.zeros_like(point)
    for target in seen:
        way = target - point
        away += np.linalg.norm(way, axis=-1, keepdims=True) * way
    return _unit(_unit(away) - rays.direction)


def slopes(normal: Floats) -> Floats:
    """dz/dx and dz/dy of normals (..., 3), (2, ...)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        tilted: Floats = -np.moveaxis(normal[..., :2], -1, 0) / normal[..., 2]
    return tilted


def spread(
    function: Callable[[Floats], Floats], coordinates_px: Floats, sigma_px: Floats
) -> Floats:
    """Standard deviations (quantity, pixel) of a function of coordinates (screen, axis, pixel), to first order.

    Each coordinate's noise is independent of the others', as they come from different frames.
    """
    variance: Floats | float = 0.0
    for at in np.ndindex(coordinates_px.shape[:2]):
        moved = [coordinates_px.copy(), coordinates_px.copy()]
        moved[0][at] -= STEP_PX
        moved[1][at] += STEP_PX
        slope = (function(moved[1]) - function(moved[0])) / (2.0 * STEP_PX)
        variance = variance + (slope * sigma_px[at]) ** 2
    return np.asarray(np.sqrt(variance))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray((a * b).sum(axis=-1))


def _unit(vector: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))
