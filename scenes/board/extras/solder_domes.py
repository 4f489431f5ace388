"""Domes of solder on pads that were levelled with hot air: highest in the middle, as surface tension has them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

from scenes.board.board import Board
from scenes.board.board_settings import FIDUCIAL
from scenes.board.pad_layout import Bounds, Layout, moved, rounded
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import Tessellation, areas, tessellate
from scenes.support.distribution import draw

Floats = NDArray[np.float64]

# Stream of random numbers; the others are in `board_settings`, `printing` and `damage`.
DOME = 9
# What is narrower than twice this stays flat, such as slivers between an opening's edge and the copper's.
NARROW_MM = 0.02
# Triangles are this share of the root of the area wide.
FINENESS = 1 / 30


@dataclass(frozen=True, eq=False)
class Dome:
    """Solder on one piece of bare copper, above the finish at its rim; world coordinates."""

    label: str
    pad: int
    """Id of the pad printed on it; 0 for none, or for several."""
    field: Heightfield
    crown: LinearNDInterpolator
    """Height relative to the middle's, at places relative to `origin_mm`."""
    origin_mm: Floats
    bounds: Bounds
    height_mm: float


def domes(board: Board, layout: Layout) -> list[Dome]:
    """Those of a board's layout, each of a height drawn for its pad; holes and residue leave copper flat."""
    if board.layers.dome == 0.0:
        return []
    flat = [h.outline for h in layout.holes] + [
        m.outline for m in layout.damage if m.name == "residue"
    ]
    bare = shapely.intersection(layout.copper, layout.openings)
    bare = bare.buffer(-NARROW_MM, join_style="mitre").buffer(NARROW_MM, join_style="mitre")
    pieces = shapely.get_parts(bare)
    if flat:
        pieces = pieces[~shapely.intersects(pieces, shapely.union_all(flat))]
    places = np.array([pad.outline.point_on_surface() for pad in layout.pads])
    marks, tree = shapely.union_all(layout.fiducials), shapely.STRtree(places)
    made = []
    for piece in pieces:
        printed = tree.query(piece, "intersects")
        pad = layout.pads[int(printed[0])].id if len(printed) == 1 else 0
        height = draw(board.layers.dome, board.generator(DOME, pad))
        origin = np.round(piece.centroid.coords[0], 6)
        if height == 0.0:
            continue
        outline = rounded(moved(piece, (-origin[0], -origin[1])))
        mesh, share, crown = _meniscus(outline.wkb)
        world = origin - layout.centre_mm
        field = Heightfield(mesh.xy_mm + world, mesh.faces, mesh.rims, height * share)
        label = FIDUCIAL if piece.intersects(marks) else "pad"
        bounds = moved(outline, (world[0], world[1])).bounds
        made.append(Dome(label, pad, field, crown, world, bounds, height))
    return made


def on_domes(field: Heightfield, made: Sequence[Dome]) -> Floats:
    """(vertex,) how much higher paste lies than on flat pads."""
    rise = np.zeros(len(field.xy_mm))
    (x0, y0), (x1, y1) = field.xy_mm.min(axis=0), field.xy_mm.max(axis=0)
    for dome in made:
        low_x, low_y, high_x, high_y = dome.bounds
        if low_x < x1 and low_y < y1 and high_x > x0 and high_y > y0:
            rise += dome.height_mm * dome.crown(field.xy_mm - dome.origin_mm)
    return rise


@lru_cache(maxsize=1024)
def _meniscus(outline: bytes) -> tuple[Tessellation, Floats, LinearNDInterpolator]:
    """Relative heights of a liquid's surface that is held at an outline: the same pressure everywhere, so that the Laplacian is
    constant where slopes are small (Young and Laplace), by linear finite elements.
    """
    polygon = shapely.from_wkb(outline)
    mesh = tessellate(polygon, FINENESS * float(np.sqrt(polygon.area)))
    corners = mesh.xy_mm[mesh.faces]
    # Opposite edges, turned: the gradients of the three hat functions times twice the area.
    across = np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1)
    local = (
        np.einsum("fik,fjk->fij", across, across)
        / (4.0 * areas(mesh.xy_mm, mesh.faces))[:, None, None]
    )
    rows, columns = np.repeat(mesh.faces, 3, axis=1), np.tile(mesh.faces, (1, 3))
    count = len(mesh.xy_mm)
    stiffness = coo_array((local.ravel(), (rows.ravel(), columns.ravel())), (count, count)).tocsr()
    inner, height = np.flatnonzero(mesh.depth_mm > 0.0), np.zeros(count)
    height[inner] = spsolve(stiffness[inner][:, inner], mesh.weights_mm2[inner])
    height /= height.max()
    return mesh, height, LinearNDInterpolator(mesh.xy_mm, height, fill_value=0.0)
