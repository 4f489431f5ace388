"""Heights over a polygon, as triangles: exact integrals, and the solid they bound.

A heightfield is linear on each triangle, so its volume, moments and volume above a threshold have closed
forms; nothing here is sampled.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.shapes.tessellation import Floats, Ints, areas


@dataclass(frozen=True, eq=False)
class Heightfield:
    """Heights >= 0 over a tessellated polygon."""

    xy_mm: Floats
    """(vertex, 2) corners of the triangles, mm."""
    faces: Ints
    """(face, 3) indices of vertices."""
    rims: tuple[Ints, ...]
    """Indices of the vertices along each border, outer and inner."""
    height_mm: Floats
    """(vertex,) above the base plane."""
    bed: NDArray[np.bool_] | None = None
    """(vertex,) where flux is seen between grains; None: the surface shows no grains."""

    @property
    def face_areas_mm2(self) -> Floats:
        """(face,) area seen from above."""
        return areas(self.xy_mm, self.faces)

    @property
    def volume_mm3(self) -> float:
        """Volume between the surface and the base plane, mm3."""
        return integral(self.xy_mm, self.faces, self.height_mm)

    @property
    def area_mm2(self) -> float:
        """Area of the footprint."""
        return float(self.face_areas_mm2.sum())

    @property
    def centroid_mm(self) -> tuple[float, float]:
        """Centre of volume, x and y: the integral of x h over that of h, exact for linear pieces."""
        area, corners, heights = (
            self.face_areas_mm2,
            self.xy_mm[self.faces],
            self.height_mm[self.faces],
        )
        # Over a triangle, the integral of x h is A/12 (sum x sum h + sum x h).
        sums = corners.sum(axis=1) * heights.sum(axis=1)[:, None]
        products = np.einsum("fvc,fv->fc", corners, heights)
        moment = ((sums + products) * (area / 12.0)[:, None]).sum(axis=0) / self.volume_mm3
        return float(moment[0]), float(moment[1])

    def above(self, threshold_mm: float) -> tuple[float, float]:
        """(area mm2, volume mm3) where the surface is above a threshold; the volume counts from the base plane."""
        area, heights = self.face_areas_mm2, np.sort(self.height_mm[self.faces], axis=1)
        low, mid, high = heights.T
        t = threshold_mm
        with np.errstate(divide="ignore", invalid="ignore"):
            # The cut-off corners are similar triangles: above at the highest vertex, below at the lowest.
            top = (high - t) ** 2 / ((high - low) * (high - mid))
            bottom = (t - low) ** 2 / ((high - low) * (mid - low))
        whole, only_top, only_bottom = (
            low >= t,
            (low < t) & (mid <= t) & (high > t),
            (low < t) & (mid > t),
        )
        share = np.select([whole, only_top, only_bottom], [1.0, top, 1.0 - bottom], 0.0)
        excess = np.select(
            [whole, only_top, only_bottom],
            [
                heights.mean(axis=1) - t,
                top * (high - t) / 3.0,
                heights.mean(axis=1) - t + bottom * (t - low) / 3.0,
            ],
            0.0,
        )
        covered = float((area * share).sum())
        return covered, float((area * excess).sum()) + covered * threshold_mm

    def part_volume_mm3(self, region: shapely.Geometry) -> float:
        """Volume in mm3 over the part of the footprint inside `region`; triangles are cut exactly."""
        corners, heights = self.xy_mm[self.faces], self.height_mm[self.faces]
        triangles = shapely.polygons(corners)
        shapely.prepare(region)
        whole = shapely.contains(region, triangles)
        volume = float((self.face_areas_mm2 * heights.mean(axis=1))[whole].sum())
        cut = np.flatnonzero(~whole & shapely.intersects(region, triangles))
        pieces = shapely.intersection(triangles[cut], region)
        solid = shapely.area(pieces) > 0
        cut, pieces = cut[solid], pieces[solid]
        # The integral of a linear function is its value at the centroid times the area.
        centre = shapely.get_coordinates(shapely.centroid(pieces))
        values = _interpolate(corners[cut], heights[cut], centre)
        return volume + float((values * shapely.area(pieces)).sum())

    def solid(self, base_mm: float = 0.0) -> tuple[Floats, Ints]:
        """Vertices in mm and outward faces of the closed body between the base plane and the heights above it."""
        count = len(self.xy_mm)
        top = np.column_stack([self.xy_mm, self.height_mm + base_mm])
        bottom = np.column_stack([self.xy_mm, np.full(count, base_mm)])
        walls = [_wall(rim, rim + count) for rim in self.rims]
        return np.concatenate([top, bottom]), np.concatenate(
            [self.faces, self.faces[:, ::-1] + count, *walls]
        )

    def shell(self, base_mm: float, foot_mm: float, undercut_mm: float) -> tuple[Floats, Ints]:
        """Open surface to render: the heights above z = base_mm, and walls that run down to z = foot_mm.

        There is no bottom, which would coincide with the pad's own surface. The foot is moved inwards by `undercut_mm`,
        so that the wall of a deposit as wide as its pad does not coincide with the pad's wall.
        """
        count = len(self.xy_mm)
        vertices = [np.column_stack([self.xy_mm, self.height_mm + base_mm])]
        faces = [self.faces]
        for rim in self.rims:
            inward = _inward(self.xy_mm[rim])
            foot = np.column_stack(
                [self.xy_mm[rim] + undercut_mm * inward, np.full(len(rim), foot_mm)]
            )
            faces.append(_wall(rim, np.arange(count, count + len(rim))))
            vertices.append(foot)
            count += len(rim)
        return np.concatenate(vertices), np.concatenate(faces)


def integral(xy_mm: Floats, faces: Ints, values: Floats) -> float:
    """Integral over triangles of the function that is linear between its vertex values (vertex,), in their unit times
    mm2.
    """
    return float((areas(xy_mm, faces) * values[faces].mean(axis=1)).sum())


def _wall(upper: Ints, lower: Ints) -> Ints:
    """Two triangles per piece of a ring, facing away from the ring's left side."""
    next_upper, next_lower = np.roll(upper, -1), np.roll(lower, -1)
    return np.concatenate(
        [
            np.column_stack([upper, lower, next_lower]),
            np.column_stack([upper, next_lower, next_upper]),
        ]
    )


def _inward(ring: Floats) -> Floats:
    """(vertex, 2) unit vectors to the left of a ring, the mean of the two pieces that meet."""
    along = np.roll(ring, -1, axis=0) - ring
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.column_stack([-along[:, 1], along[:, 0]])
    mean = left + np.roll(left, 1, axis=0)
    unit: Floats = mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    return unit


def _interpolate(corners: Floats, values: Floats, points: Floats) -> Floats:
    """Linear function given at triangle corners (face, 3, 2), evaluated at one point (face, 2) each."""
    origin = corners[:, 0]
    b, c, p = corners[:, 1] - origin, corners[:, 2] - origin, points - origin
    det = b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0]
    u = (p[:, 0] * c[:, 1] - p[:, 1] * c[:, 0]) / det
    v = (b[:, 0] * p[:, 1] - b[:, 1] * p[:, 0]) / det
    interpolated: Floats = (
        values[:, 0] + u * (values[:, 1] - values[:, 0]) + v * (values[:, 2] - values[:, 0])
    )
    return interpolated
