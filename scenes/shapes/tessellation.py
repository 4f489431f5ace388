"""Polygons cut into triangles: a square lattice inside, Delaunay's triangles along the outline."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from scenes.support.errors import MeshError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Nodes nearer to the outline than this share of a step would make slivers against it; at more than half a step
# they also stay outside the circles over the outline's pieces, so Delaunay's triangles keep the outline.
CLEARANCE = 0.6
REFINEMENTS = 4


@dataclass(frozen=True, eq=False)
class Tessellation:
    """A polygon cut into triangles about `step_mm` wide, the outline kept exactly."""

    xy_mm: Floats
    """(vertex, 2)."""
    faces: Ints
    """(face, 3), counter-clockwise seen from above."""
    rims: tuple[Ints, ...]
    """Vertices of each ring of the outline in order, the solid on the left."""
    depth_mm: Floats
    """(vertex,) distance to the outline; 0 on it."""
    weights_mm2: Floats
    """(vertex,) a third of the area of the triangles around it: heights times these sum to the volume, exactly."""


def areas(xy_mm: Floats, faces: Ints) -> Floats:
    """Signed areas (face,) of triangles in mm2; counter-clockwise is positive."""
    a, b, c = (xy_mm[faces[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    signed: Floats = 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    return signed


def tessellate(polygon: shapely.Polygon, step_mm: float) -> Tessellation:
    """Cut a polygon in mm, which may have holes, into triangles about `step_mm` wide; its outline is kept exactly.

    A square lattice fills the inside; only the band between it and the outline needs Delaunay's triangulation. Raises
    `MeshError` for a polygon that is invalid, or has details finer than the step after refining it four times.

    >>> mesh = tessellate(shapely.box(0.0, 0.0, 1.0, 0.5), step_mm=0.1)
    >>> round(float(mesh.weights_mm2.sum()), 9)
    0.5
    """
    polygon = shapely.orient_polygons(polygon)
    if polygon.is_empty or not polygon.is_valid:
        raise MeshError(
            f"an outline of area {polygon.area:.3g} mm2 is empty or crosses itself: repair the aperture"
        )
    for _ in range(REFINEMENTS):
        found = _tessellate(polygon, step_mm)
        if found:
            return found
        # Only necks and acute corners narrower than a step get here.
        step_mm /= 2.0
    raise MeshError(
        f"the outline at {tuple(np.round(polygon.bounds, 4))} mm has details finer than {step_mm:.2g} mm that cannot "
        "be triangulated: simplify the aperture"
    )


def _tessellate(polygon: shapely.Polygon, step_mm: float) -> Tessellation | None:
    rings = [
        shapely.get_coordinates(shapely.segmentize(ring, step_mm))[:-1]
        for ring in (polygon.exterior, *polygon.interiors)
    ]
    rim_xy = np.concatenate(rings)
    nodes, cells, shape = _lattice(polygon, step_mm)
    rim = shapely.boundary(polygon)
    shapely.prepare(rim)
    depth = shapely.distance(shapely.points(nodes), rim)
    depth[~shapely.contains_xy(polygon, nodes)] = -1.0
    inner = (depth >= CLEARANCE * step_mm).reshape(shape)
    full = inner[:-1, :-1] & inner[:-1, 1:] & inner[1:, :-1] & inner[1:, 1:]
    padded = np.pad(full, 1)
    # Nodes with four full cells around them are inside the lattice and need no further triangle.
    surrounded = padded[:-1, :-1] & padded[:-1, 1:] & padded[1:, :-1] & padded[1:, 1:]
    used = np.flatnonzero(inner.ravel())
    number = np.full(inner.size, -1)
    number[used] = np.arange(len(used)) + len(rim_xy)
    band = used[~surrounded.ravel()[used]]
    candidates = np.concatenate([np.arange(len(rim_xy)), number[band]])
    points = np.concatenate([rim_xy, nodes[band]])
    strip = Delaunay(points).simplices.astype(np.int64)
    signed = areas(points, strip)
    strip[signed < 0] = strip[signed < 0][:, ::-1]
    centre = points[strip].mean(axis=1)
    column, row = np.floor((centre - nodes[0]) / step_mm).astype(int).T
    on_grid = (row >= 0) & (row < full.shape[0]) & (column >= 0) & (column < full.shape[1])
    in_full = np.zeros(len(strip), bool)
    in_full[on_grid] = full[row[on_grid], column[on_grid]]
    keep = (np.abs(signed) > 1e-9 * step_mm**2) & ~in_full & shapely.contains_xy(polygon, centre)
    strip = candidates[strip[keep]]
    squares = number[cells.reshape(*full.shape, 4)[full]]
    faces = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]], strip]).astype(np.int64)
    xy = np.concatenate([rim_xy, nodes[used]])
    rims, start = [], 0
    for ring in rings:
        rims.append(np.arange(start, start + len(ring)))
        start += len(ring)
    outline = [np.column_stack([rim, np.roll(rim, -1)]) for rim in rims]
    # The band must fill what the lattice leaves, and meet the outline and the lattice's own rim edge by edge.
    border = np.concatenate([*outline, _lattice_rim(squares, padded[1:-1, 1:-1], padded)])
    left = polygon.area - len(squares) * step_mm**2
    if abs(areas(xy, strip).sum() - left) > 1e-9 * polygon.area or not _bounded(strip, border):
        return None
    vertex_depth = np.concatenate([np.zeros(len(rim_xy)), depth[used]])
    thirds = np.repeat(areas(xy, faces) / 3.0, 3)
    weights: Floats = np.bincount(faces.ravel(), thirds, len(xy)).astype(np.float64)
    return Tessellation(xy, faces, tuple(rims), vertex_depth, weights)


def _lattice(polygon: shapely.Polygon, step_mm: float) -> tuple[Floats, Ints, tuple[int, int]]:
    """Lattice nodes about the bounds' centre, the four nodes of each cell counter-clockwise, and (rows, columns)."""
    low, high = np.array(polygon.bounds).reshape(2, 2)
    counts = np.maximum(np.ceil((high - low) / step_mm).astype(int), 1)
    x, y = (
        (low[i] + high[i]) / 2 + step_mm * (np.arange(counts[i]) - (counts[i] - 1) / 2)
        for i in range(2)
    )
    grid_x, grid_y = np.meshgrid(x, y)
    shape = grid_x.shape
    index = np.arange(grid_x.size).reshape(shape)
    cells = np.stack(
        [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1
    ).reshape(-1, 4)
    return np.column_stack([grid_x.ravel(), grid_y.ravel()]), cells, (shape[0], shape[1])


def _lattice_rim(squares: Ints, full: NDArray[np.bool_], padded: NDArray[np.bool_]) -> Ints:
    """Edges (edge, 2) of full cells that have no full cell beyond them, run clockwise: as the band sees them."""
    beyond = [padded[:-2, 1:-1], padded[1:-1, 2:], padded[2:, 1:-1], padded[1:-1, :-2]]
    sides = [(0, 1), (1, 2), (2, 3), (3, 0)]
    edges = [
        squares[~neighbour[full]][:, [end, start]]
        for neighbour, (start, end) in zip(beyond, sides, strict=True)
    ]
    return np.concatenate(edges)


def _bounded(faces: Ints, border: Ints) -> bool:
    """Whether the triangles' free edges are those of the border, each once."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(max(edges.max(initial=0), border.max(initial=0))) + 1
    forth, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    forth.sort()
    if np.any(forth[1:] == forth[:-1]):
        return False
    back.sort()
    free = np.setdiff1d(forth, back, assume_unique=True)
    return np.array_equal(free, np.sort(border[:, 0] * count + border[:, 1]))
