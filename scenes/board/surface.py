"""The bare board as a surface: laminate, copper under its finish, mask with its openings, and the legend on it.

The artwork's outlines cut the plane into faces, each of one height; neighbouring faces share their corners, and where
heights differ a vertical wall joins them. So the surface has neither gaps nor overlaps.
"""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.board_settings import FIDUCIAL, HOLE, LEGEND, RESIDUE
from scenes.board.layers import Stackup
from scenes.board.pad_layout import Layout

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Outlines are noded on this grid (10 nm), which makes their overlay robust.
GRID_MM = 1e-5
# Those of most boards, in the order of their labels.
KINDS = ("base", "mask", "pad", LEGEND)


@dataclass(frozen=True, eq=False)
class BoardSurface:
    """Triangles in board coordinates, z in mm above the laminate."""

    vertices: Floats
    faces: Ints
    pad: Ints
    """(face,) id of the pad whose opening is printed on the copper it belongs to; 0 for none, or for several."""


@dataclass(frozen=True, eq=False)
class _Faces:
    """The plane cut into polygons, wound counter-clockwise, each of one kind and height."""

    cut: list[shapely.Polygon]
    kind: NDArray[np.str_]
    sides: NDArray[np.str_]
    """Kind of the walls around it, where it is a hole's."""
    height: Floats
    pad: Ints

    def split(self, cut: list[shapely.Polygon], parent: Ints) -> "_Faces":
        """The same in smaller pieces, each with the face that it was part of."""
        return _Faces(
            cut, self.kind[parent], self.sides[parent], self.height[parent], self.pad[parent]
        )


def surfaces(
    layout: Layout, stackup: Stackup, face_mm: float | None = None
) -> dict[str, BoardSurface]:
    """Kind of surface -> triangles, with their upright edges: `base` bare laminate, `mask`, `pad` copper free of it,
    `legend`, `fiducial`, `residue`, `scratched copper` and `scratched laminate`, `hole` what an open hole shows, `plated wall`
    and `bare wall` its sides.

    With `face_mm` faces are cut into squares of this size, so that the surface can be bent.
    """
    faces = _faces(layout, stackup)
    if face_mm is not None:
        faces = faces.split(*_cut(faces.cut, face_mm))
    walls, wall_of, below = _walls(faces.cut, faces.height)
    # A wall belongs to the face that it falls from, a hole's to the hole.
    wall_kind = np.where(faces.kind[below] == HOLE, faces.sides[below], faces.kind[wall_of])
    built = {}
    for kind in dict.fromkeys((*KINDS, *np.unique(faces.kind), *np.unique(wall_kind))):
        chosen, sides = np.flatnonzero(faces.kind == kind), wall_kind == kind
        if not len(chosen) and not sides.any():
            continue
        tops = [_flat(faces.cut[i], faces.height[i]) for i in chosen]
        corners = np.concatenate([*tops, walls[sides]])
        owner = np.concatenate([np.repeat(chosen, [len(top) for top in tops]), wall_of[sides]])
        vertices, index = _shared(corners)
        built[str(kind)] = BoardSurface(vertices, index, faces.pad[owner])
    return built


def _shared(corners: Floats) -> tuple[Floats, Ints]:
    """(triangle, 3, 3) corners as vertices and triangles of them; corners were snapped, so equal ones are equal bits."""
    flat = np.ascontiguousarray(corners.reshape(-1, 3))
    _, first, index = np.unique(
        flat.view([("x", "f8"), ("y", "f8"), ("z", "f8")]), return_index=True, return_inverse=True
    )
    return flat[first], index.reshape(-1, 3).astype(np.int64)


def _faces(layout: Layout, stackup: Stackup) -> _Faces:
    printed_on = layout.legend.difference(layout.openings) if stackup.legend_mm else None
    areas = [layout.copper, layout.openings, layout.board, printed_on or shapely.Polygon()]
    areas += [
        shapely.union_all([hole.outline for hole in layout.holes if of_kind(hole)])
        for of_kind in (lambda h: h.tented, lambda h: h.plated > h.tented, lambda h: not h.tented)
    ]
    areas += [shapely.union_all(layout.fiducials)]
    areas += [
        shapely.union_all([mark.outline for mark in layout.damage if mark.name == name])
        for name in ("scratch", "residue")
    ]
    areas = [shapely.set_precision(area, GRID_MM) for area in areas]
    lines = shapely.union_all([shapely.boundary(area) for area in areas], grid_size=GRID_MM)
    copper, openings, board, legend, tented, plated, drilled, marks, grooves, spilt = areas
    cut = shapely.orient_polygons(shapely.get_parts(shapely.polygonize([lines])))
    inside = shapely.point_on_surface(cut)
    for area in areas:
        shapely.prepare(area)
    on_board = shapely.intersects(board, inside)
    cut, inside = cut[on_board], inside[on_board]
    metal, bare = shapely.intersects(copper, inside), shapely.intersects(openings, inside)
    marked, deep = shapely.intersects(legend, inside), shapely.intersects(drilled, inside)
    fiducial = bare & metal & shapely.intersects(marks, inside)
    groove, film = (shapely.intersects(area, inside) for area in (grooves, spilt))
    groove &= ~bare
    kinds = np.select(
        [deep, film, fiducial, bare & metal, bare, groove & metal, groove, marked],
        [HOLE, RESIDUE, FIDUCIAL, "pad", "base", "scratched copper", "scratched laminate", LEGEND],
        "mask",
    )
    sides = np.where(shapely.intersects(plated, inside), "plated wall", "bare wall")
    covered = stackup.mask_mm + stackup.copper_mm * metal + stackup.legend_mm * marked
    covered = covered - stackup.dip_mm * shapely.intersects(tented, inside)
    heights = np.select(
        [deep, bare & metal, bare, groove & metal, groove],
        [-stackup.depth_mm, stackup.pad_mm, 0.0, stackup.copper_mm, 0.0],
        covered,
    )
    heights = heights + stackup.film_mm * (film & ~deep)
    owner = np.zeros(len(cut), dtype=np.int64)
    if layout.pads:
        middles = np.array([pad.outline.point_on_surface() for pad in layout.pads])
        hidden = shapely.union(drilled, spilt)
        shapely.prepare(hidden)
        for i in np.flatnonzero(shapely.intersects(hidden, middles)):
            # A via or a stain is in the pad's middle.
            middles[i] = layout.pads[i].outline.difference(hidden).point_on_surface()
        face, pad = shapely.STRtree(middles).query(cut, predicate="intersects")
        for f in np.unique(face):
            printed = pad[face == f]
            if kinds[f] == "pad" and len(printed) == 1:
                owner[f] = layout.pads[int(printed[0])].id
    return _Faces(list(cut), kinds, sides, heights.astype(np.float64), owner)


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


def _walls(faces: list[shapely.Polygon], heights: Floats) -> tuple[Floats, Ints, Ints]:
    """(triangle, 3, 3) of the walls from each face down to its lower neighbours, (triangle,) the face, the neighbour.

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
    beyond = face_of[order][place][upright]
    return np.concatenate([first, second]), np.tile(face_of[upright], 2), np.tile(beyond, 2)
