"""The bare board as a surface: laminate, copper under its finish, mask with its openings, and the legend on it.

The artwork's outlines cut the plane into faces, each of one height; neighbouring faces share their corners, and where
heights differ a vertical wall joins them. So the surface has neither gaps nor overlaps.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.board import LEGEND
from scenes.board.layers import Stackup
from scenes.board.pad_layout import Layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Outlines are noded on this grid (10 nm), which makes their overlay robust.
GRID_MM = 1e-5


@dataclass(frozen=True, eq=False)
class BoardSurface:
    """Triangles in board coordinates, z in mm above the laminate."""

    vertices: Floats
    faces: Ints
    pad: Ints
    """(face,) id of the pad whose opening is printed on the copper it belongs to; 0 for none, or for several."""


def surfaces(
    layout: Layout, stackup: Stackup, face_mm: float | None = None
) -> dict[str, BoardSurface]:
    """Label -> triangles, with their upright edges: `base` bare laminate, `mask`, `pad` copper free of it, `legend`.

    With `face_mm` faces are cut into squares of this size, so that the surface can be bent.
    """
    faces, kinds, heights, pads = _faces(layout, stackup)
    if face_mm is not None:
        faces, parent = _cut(faces, face_mm)
        kinds, heights, pads = kinds[parent], heights[parent], pads[parent]
    walls, wall_of = _walls(faces, heights)
    built = {}
    for label in ("base", "mask", "pad", LEGEND):
        chosen = np.flatnonzero(kinds == label)
        if not len(chosen):
            continue
        tops = [_flat(faces[i], heights[i]) for i in chosen]
        of_label = kinds[wall_of] == label
        corners = np.concatenate([*tops, walls[of_label]])
        owner = np.concatenate([np.repeat(chosen, [len(top) for top in tops]), wall_of[of_label]])
        vertices, index = _shared(corners)
        built[label] = BoardSurface(vertices, index, pads[owner])
    return built


def _shared(corners: Floats) -> tuple[Floats, Ints]:
    """(triangle, 3, 3) corners as vertices and triangles of them; corners were snapped, so equal ones are equal bits."""
    flat = np.ascontiguousarray(corners.reshape(-1, 3))
    _, first, index = np.unique(
        flat.view([("x", "f8"), ("y", "f8"), ("z", "f8")]), return_index=True, return_inverse=True
    )
    return flat[first], index.reshape(-1, 3).astype(np.int64)


def _faces(
    layout: Layout, stackup: Stackup
) -> tuple[list[shapely.Polygon], NDArray[np.str_], Floats, Ints]:
    """The plane's faces: polygons wound counter-clockwise, label, height, pad id."""
    printed_on = layout.legend.difference(layout.openings) if stackup.legend_mm else None
    areas = [layout.copper, layout.openings, layout.board, printed_on or shapely.Polygon()]
    areas = [shapely.set_precision(area, GRID_MM) for area in areas]
    lines = shapely.union_all([shapely.boundary(area) for area in areas], grid_size=GRID_MM)
    copper, openings, board, legend = areas
    cut = shapely.orient_polygons(shapely.get_parts(shapely.polygonize([lines])))
    inside = shapely.point_on_surface(cut)
    for area in areas:
        shapely.prepare(area)
    on_board = shapely.intersects(board, inside)
    cut, inside = cut[on_board], inside[on_board]
    metal, bare = shapely.intersects(copper, inside), shapely.intersects(openings, inside)
    marked = shapely.intersects(legend, inside)
    kinds = np.select([bare & metal, bare, marked], ["pad", "base", LEGEND], "mask")
    covered = stackup.mask_mm + stackup.copper_mm * metal + stackup.legend_mm * marked
    heights = np.select([bare & metal, bare], [stackup.pad_mm, 0.0], covered)
    owner = np.zeros(len(cut), dtype=np.int64)
    if layout.pads:
        middles = np.array([pad.outline.point_on_surface() for pad in layout.pads])
        face, pad = shapely.STRtree(middles).query(cut, predicate="intersects")
        for f in np.unique(face):
            printed = pad[face == f]
            if kinds[f] == "pad" and len(printed) == 1:
                owner[f] = layout.pads[int(printed[0])].id
    return list(cut), kinds, heights.astype(np.float64), owner


def _cut(faces: list[shapely.Polygon], size_mm: float) -> tuple[list[shapely.Polygon], Ints]:
    """Faces cut along a square grid, and (face,) the one that each was part of."""
    x0, y0, x1, y1 = shapely.total_bounds(faces)
    grid = [((x, y0), (x, y1)) for x in np.arange(x0, x1, size_mm)[1:]]
    grid += [((x0, y), (x1, y)) for y in np.arange(y0, y1, size_mm)[1:]]
    edges = [*shapely.boundary(faces), *map(shapely.LineString, grid)]
    lines = shapely.union_all(edges, grid_size=GRID_MM)
    cut = shapely.orient_polygons(shapely.get_parts(shapely.polygonize([lines])))
    piece, parent = shapely.STRtree(faces).query(shapely.point_on_surface(cut), "intersects")
    piece, first = np.unique(piece, return_index=True)
    return list(cut[piece]), parent[first]


def _flat(polygon: shapely.Polygon, height_mm: float) -> Floats:
    """(triangle, 3, 3) upward corners of a polygon; every corner of its outline is kept."""
    triangles = shapely.orient_polygons(
        shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
    )
    xy = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    return np.concatenate([xy, np.full((*xy.shape[:2], 1), height_mm)], axis=-1)


def _walls(faces: list[shapely.Polygon], heights: Floats) -> tuple[Floats, Ints]:
    """(triangle, 3, 3) of the walls from each face down to its lower neighbours, and (triangle,) the face.

    The board's own rim stays open.
    """
    starts, ends, owner = [], [], []
    for i, face in enumerate(faces):
        for ring in (face.exterior, *face.interiors):
            corners = shapely.get_coordinates(ring)
            starts.append(corners[:-1])
            ends.append(corners[1:])
            owner.append(np.full(len(corners) - 1, i))
    start, end, face_of = np.concatenate(starts), np.concatenate(ends), np.concatenate(owner)
    # Complex numbers sort by x, then y: a point's number is its place.
    points = np.concatenate([start, end])
    _, number = np.unique(points[:, 0] + 1j * points[:, 1], return_inverse=True)
    a, b = number[: len(start)], number[len(start) :]
    count = int(number.max()) + 1
    forth, back = a * count + b, b * count + a
    order = np.argsort(forth)
    place = np.minimum(np.searchsorted(forth[order], back), len(forth) - 1)
    # The same piece run the other way belongs to the face beyond it.
    shared = forth[order][place] == back
    high, low = heights[face_of], heights[face_of[order][place]]
    upright = np.flatnonzero(shared & (high > low + 1e-12))
    upper_a, upper_b = (np.column_stack([p[upright], high[upright]]) for p in (start, end))
    lower_a, lower_b = (np.column_stack([p[upright], low[upright]]) for p in (start, end))
    first = np.stack([upper_a, lower_a, lower_b], axis=1)
    second = np.stack([upper_a, lower_b, upper_b], axis=1)
    return np.concatenate([first, second]), np.tile(face_of[upright], 2)
