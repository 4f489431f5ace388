"""Straight and circular segments, and what an aperture paints along them, as polygons of exact area."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.gerber.tokens import Malformed
from scenes.board.pad_layout import CIRCLE, Area, disk

Floats = NDArray[np.float64]
Point = tuple[float, float]

# Distance of an arc's chords from the arc, at most.
ARC_MM = 0.002
# Start and end of an arc may differ in their distance from its centre by this share, or by this length: old files have
# coordinates of few digits.
UNEQUAL, UNEQUAL_MM = 0.2, 0.05


@dataclass(frozen=True)
class Segment:
    """A piece of a path; with a centre, an arc about it."""

    start: Point
    end: Point
    centre: Point | None = None
    clockwise: bool = False

    def points(self) -> Floats:
        """(point, 2) from start to end; the polygon between an arc and its centre has the sector's area."""
        if self.centre is None:
            return np.array([self.start, self.end])
        first, sweep, radius, last_radius = self.arc()
        points = arc(self.centre, radius, first, sweep, last_radius)
        points[0], points[-1] = self.start, self.end
        return points

    def arc(self) -> tuple[float, float, float, float]:
        """Angle of the start, sweep (radians, positive counter-clockwise), radius at start and at end."""
        assert self.centre is not None
        a, b = np.subtract(self.start, self.centre), np.subtract(self.end, self.centre)
        radius, last = float(np.hypot(*a)), float(np.hypot(*b))
        if abs(radius - last) > max(UNEQUAL * max(radius, last), UNEQUAL_MM) or not radius * last:
            raise Malformed(
                f"an arc starts {radius:.4g} mm and ends {last:.4g} mm from its centre: both ends must be on one circle"
            )
        first = float(np.arctan2(a[1], a[0]))
        turn = float(np.arctan2(b[1], b[0])) - first
        sweep = (-turn if self.clockwise else turn) % (2 * np.pi)
        if self.start == self.end:
            sweep = 2 * np.pi
        return first, -sweep if self.clockwise else sweep, radius, last


def arc(
    centre: Point, radius: float, first: float, sweep: float, last_radius: float | None = None
) -> Floats:
    """(point, 2) along an arc; inner points are moved outwards so that the sector keeps its area."""
    finest = 2.0 * np.arccos(max(1.0 - ARC_MM / max(radius, ARC_MM), 0.0))
    step = min(2.0 * np.pi / CIRCLE, max(finest, 1e-3))
    count = max(int(np.ceil(abs(sweep) / step - 1e-9)), 2)
    # Triangles of the sector: two with one end on the circle, the others with both ends moved to k times the radius.
    part = abs(sweep) / count
    a, b, c = (count - 2) * np.sin(part), 2.0 * np.sin(part), -abs(sweep)
    k = -c / b if count == 2 else (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    angle = first + np.linspace(0.0, sweep, count + 1)
    reach = np.linspace(radius, radius if last_radius is None else last_radius, count + 1)
    reach[1:-1] *= k
    points: Floats = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])
    points += np.asarray(centre)
    return points


def valid(polygon: shapely.Polygon) -> Area:
    """The polygon; cut-ins, by which a contour has holes, touch themselves and are resolved."""
    return polygon if polygon.is_valid else shapely.make_valid(polygon, method="structure")


def stroke_of_disk(segment: Segment, radius: float) -> Area:
    """What a disk paints along a segment."""
    if segment.start == segment.end and segment.centre is None:
        return disk(*segment.start, radius)
    if segment.centre is None:
        along = np.subtract(segment.end, segment.start)
        angle = float(np.arctan2(along[1], along[0]))
        caps = [arc(segment.end, radius, angle - np.pi / 2, np.pi)]
        caps.append(arc(segment.start, radius, angle + np.pi / 2, np.pi))
        return shapely.Polygon(np.concatenate(caps))
    first, sweep, middle, last = segment.arc()
    if middle <= radius or abs(middle - last) > 1e-3 * middle:
        # The inner rim is lost, or a spiral: straight pieces.
        points = [(float(x), float(y)) for x, y in segment.points()]
        pieces = [stroke_of_disk(Segment(a, b), radius) for a, b in pairwise(points)]
        return shapely.union_all(pieces)
    if abs(sweep) >= 2 * np.pi:
        rims = [arc(segment.centre, r, 0.0, 2 * np.pi) for r in (middle + radius, middle - radius)]
        return shapely.Polygon(rims[0], [rims[1]])
    if sweep < 0:
        first, sweep = first + sweep, -sweep
    centre = np.asarray(segment.centre)
    ends = [centre + middle * np.array([np.cos(t), np.sin(t)]) for t in (first, first + sweep)]
    start, end = ((float(x), float(y)) for x, y in ends)
    outer = arc(segment.centre, middle + radius, first, sweep)
    inner = arc(segment.centre, middle - radius, first, sweep)[::-1]
    end_cap = arc(end, radius, first + sweep, np.pi)
    start_cap = arc(start, radius, first + np.pi, np.pi)
    whole = shapely.Polygon(np.concatenate([outer, end_cap[1:-1], inner, start_cap[1:-1]]))
    if whole.is_valid:
        return whole
    # The caps overlap.
    band = shapely.Polygon(np.concatenate([outer, inner]))
    return shapely.union_all([band, shapely.Polygon(end_cap), shapely.Polygon(start_cap)])


def stroke_of_shape(segment: Segment, shape: Area) -> Area:
    """What any other aperture paints along a segment: its own shape swept, without turning."""
    points = segment.points()
    pieces = [_swept(shape, a, b) for a, b in pairwise(points)]
    return shapely.union_all(pieces)


def _swept(shape: Area, start: Floats, end: Floats) -> Area:
    ends = [shapely.transform(shape, lambda xy, at=at: xy + at) for at in (start, end)]
    if np.array_equal(start, end):
        return ends[0]
    if shape.geom_type == "Polygon" and not shape.interiors and _is_convex(shape):
        return shapely.convex_hull(shapely.union_all(ends))
    sides = []
    for part in shapely.get_parts(shape):
        for ring in (part.exterior, *part.interiors):
            corners = shapely.get_coordinates(ring)
            a, b = corners[:-1], corners[1:]
            sides.append(np.stack([a + start, b + start, b + end, a + end], axis=1))
    walls = shapely.polygons(np.concatenate(sides))
    return shapely.union_all([*ends, *walls[shapely.area(walls) > 0]])


def _is_convex(shape: Area) -> bool:
    return bool(shapely.convex_hull(shape).area <= shape.area * (1.0 + 1e-9))
