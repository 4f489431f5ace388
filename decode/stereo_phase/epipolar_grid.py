"""Candidates for matching pixels: every place on a pixel's epipolar line in the right image with the pixel's coordinate.

A point, the two cameras' centres and the baseline through them share a plane. So each viewing direction is described by the
angle of its plane about the baseline, `plane_rad`, and by its angle from the baseline, `along_rad`; matching pixels have the
same plane, whatever the poses. The right camera's map is resampled once on a grid of these two angles, whose rows are
epipolar lines; each left pixel then meets only the segments of its row that contain its coordinate, found by sorting.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenes.acquisition.patterns import Axis
from scenes.rig.projection import Projection

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

# A map that jumps by this many typical steps has an edge of the surface there, and no crossing.
EDGE = 6.0
# Rounding of interpolated coordinates, projector px: cells of a Gray code are equal only to that.
ROUNDING_PX = 1e-3
# Nodes of the grid for each pixel of the right image, at most: near the baseline's own direction there would be more.
MOST_NODES = 4


@dataclass(frozen=True)
class CameraBaseline:
    """The line through two cameras' centres, and directions square to it, as unit vectors."""

    origin_mm: Floats
    along: Floats
    length_mm: float
    square: Floats
    """(2, 3)."""

    @classmethod
    def of(cls, left: Projection, right: Projection) -> "CameraBaseline":
        """From the left camera to the right one; planes are measured from the left camera's axis."""
        way = right.origin_mm - left.origin_mm
        length = float(np.linalg.norm(way))
        along = way / length
        first = left.axis - (left.axis @ along) * along
        if np.linalg.norm(first) < 1e-6:
            first = np.cross(along, np.eye(3)[np.abs(along).argmin()])
        first /= np.linalg.norm(first)
        return cls(left.origin_mm, along, length, np.stack([first, np.cross(along, first)]))

    def angles(self, direction: Floats) -> tuple[Floats, Floats]:
        """Plane and angle from the baseline, rad, of directions (..., 3)."""
        across = direction @ self.square.T
        plane = np.arctan2(across[..., 1], across[..., 0])
        along = np.arctan2(np.hypot(across[..., 0], across[..., 1]), direction @ self.along)
        return plane, np.asarray(along)

    def directions(self, plane_rad: Floats, along_rad: Floats) -> Floats:
        """Unit directions (..., 3)."""
        across = np.cos(plane_rad)[..., None] * self.square[0]
        across = across + np.sin(plane_rad)[..., None] * self.square[1]
        along = np.cos(along_rad)[..., None] * self.along
        return np.asarray(along + np.sin(along_rad)[..., None] * across)

    def distance_mm(self, left_rad: Floats, right_rad: Floats) -> Floats:
        """Distance from the left camera of the point seen at two angles from the baseline; NaN where rays part."""
        apex = right_rad - left_rad
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = self.length_mm * np.sin(right_rad) / np.sin(apex)
        return np.where(apex > 0.0, distance, np.nan)


@dataclass(frozen=True)
class EpipolarGrid:
    """The right camera's coordinates on a grid of epipolar lines."""

    baseline: CameraBaseline
    plane_rad: Floats
    """Of the rows, evenly spaced."""
    along_rad: Floats
    """Of the columns."""
    at_px: Mapping[Axis, Floats]
    """Projector coordinates (row, col), NaN outside the image or where unknown."""

    @classmethod
    def of(
        cls,
        baseline: CameraBaseline,
        right: Projection,
        at_px: Mapping[Axis, Floats],
        planes: Floats,
    ) -> "EpipolarGrid":
        """The grid over the planes (any shape, rad) that left pixels look along, about one node a right pixel."""
        rows, columns = next(iter(at_px.values())).shape
        border = _border(columns, rows)
        edge_planes, edge_along = baseline.angles(right.rays(border)[1])
        low = max(float(planes.min()), float(edge_planes.min()))
        high = min(float(planes.max()), float(edge_planes.max()))
        start, end = float(edge_along.min()), float(edge_along.max())
        step = 1.0 / max(right.fx, right.fy)
        count = max(2, int(np.ceil((high - low) * np.sin(0.5 * (start + end)) / step)))
        width = max(2, int(np.ceil((end - start) / step)))
        fewer = min(1.0, np.sqrt(MOST_NODES * rows * columns / (count * width)))
        plane_rad = np.linspace(low, max(high, low), max(2, int(count * fewer)))
        along_rad = np.linspace(start, end, max(2, int(width * fewer)))
        at = np.empty((2, plane_rad.size, along_rad.size))
        for first in range(0, plane_rad.size, 256):
            some = np.s_[first : first + 256]
            direction = baseline.directions(plane_rad[some, None], along_rad[None, :])
            pixels, depth = right.project(right.origin_mm + direction)
            pixels = np.where((depth > 0.0)[..., None], pixels, np.nan)
            at[:, some] = np.moveaxis(pixels, -1, 0)
        sampled = {axis: interpolated(image, at[0], at[1]) for axis, image in at_px.items()}
        return cls(baseline, plane_rad, along_rad, sampled)

    def candidates(
        self, axis: Axis, plane_rad: Floats, wanted_px: Floats, cell_px: float
    ) -> tuple[Indices, Floats, dict[Axis, Floats]]:
        """Where pixels with planes and coordinates (n,) find their coordinate; `cell_px` is the jump of a map of Gray
        code alone, 0 for fringes.

        For each candidate (m,): index of the left pixel, angle of the right ray from the baseline, the right map's
        other coordinates there.
        """
        image = self.at_px[axis]
        spacing = self.plane_rad[1] - self.plane_rad[0]
        row = np.rint((plane_rad - self.plane_rad[0]) / max(spacing, 1e-300))
        inside = (row >= 0) & (row < len(self.plane_rad)) & np.isfinite(wanted_px)
        pixel = np.flatnonzero(inside)
        one, other = image[:, :-1], image[:, 1:]
        jump = np.abs(other - one)
        known = np.isfinite(jump)
        if not known.any() or not pixel.size:
            return np.empty(0, np.intp), np.empty(0), {}
        known &= jump <= max(EDGE * float(jump[known].mean()), 1.5 * cell_px)
        lines, at = np.nonzero(known)
        one, other = one[known], other[known]
        # One number for row and coordinate, so that one sorted list is enough for all rows.
        lowest = min(float(np.nanmin(image)), float(wanted_px[pixel].min())) - 1.0
        far = max(float(np.nanmax(image)), float(wanted_px[pixel].max())) - lowest + 2.0
        keys = row[pixel] * far + (wanted_px[pixel] - lowest)
        order = np.argsort(keys, kind="stable")
        keys, pixel = keys[order], pixel[order]
        base = lines * far - lowest
        first = np.searchsorted(keys, base + np.minimum(one, other) - ROUNDING_PX, "left")
        count = np.searchsorted(keys, base + np.maximum(one, other) + ROUNDING_PX, "right") - first
        segment = np.repeat(np.arange(count.size), count)
        place = np.arange(segment.size) - np.repeat(np.cumsum(count) - count, count)
        pixel = pixel[first[segment] + place]
        start, end = one[segment], other[segment]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(end == start, 0.5, (wanted_px[pixel] - start) / (end - start))
        part = np.clip(part, 0.0, 1.0)
        lines, at = lines[segment], at[segment]
        along = self.along_rad[at] + part * (self.along_rad[1] - self.along_rad[0])
        others = {
            name: values[lines, at] * (1.0 - part) + values[lines, at + 1] * part
            for name, values in self.at_px.items()
            if name != axis
        }
        return pixel, along, others


def interpolated(image: Floats, column_px: Floats, row_px: Floats) -> Floats:
    """Bilinear value of an image (row, col) at continuous pixels; NaN outside the image or next to a NaN."""
    at = np.stack([row_px - 0.5, column_px - 0.5])
    found: Floats = ndimage.map_coordinates(image, at, order=1, mode="constant", cval=np.nan)
    return found


def _border(columns: int, rows: int) -> Floats:
    """Continuous coordinates of points around the image's border, (n, 2)."""
    across, down = np.linspace(0.0, columns, 33), np.linspace(0.0, rows, 33)
    return np.concatenate(
        [np.stack([across, np.full(33, edge)], axis=-1) for edge in (0.0, float(rows))]
        + [np.stack([np.full(33, edge), down], axis=-1) for edge in (0.0, float(columns))]
    )
