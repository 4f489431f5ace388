"""A board's outline from the centre lines of an outline layer, small gaps closed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scenes.board.gerber.interpreter import read
from scenes.board.gerber.openings import drawable, flipped
from scenes.board.pad_layout import Area
from scenes.support.errors import FileError

Floats = NDArray[np.float64]

# Free ends of lines this close are joined: less than an outline's usual stroke, so that the drawing looks closed.
CLOSE_MM = 0.1
# Lines are noded on this grid (10 nm).
GRID_MM = 1e-5


def read_outline(path: Path, mirrored: bool = False) -> Area:
    """Read the laminate inside an outline layer's lines.

    Parameters
    ----------
    path
        The Gerber file.
    mirrored
        Reverse the sign of x, as for the bottom side seen from below.

    Returns
    -------
    shapely.Geometry
        The board without its cut-outs, mm.

    Raises
    ------
    FileError
        For a file that is not a whole, valid Gerber file, for lines that enclose nothing, and for an open outline
        around the rest.

    Notes
    -----
    Gaps up to 0.1 mm between free ends, or between a free end and another line, are closed by a straight line. Outline
    and cut-outs nest: what an odd number of rings encloses is board.
    """
    with drawable(path):
        paths = [points for item in read(path).objects for points in item.paths()]
        lines = [
            shapely.LineString(points) for points in paths if len(np.unique(points, axis=0)) > 1
        ]
        if mirrored:
            lines = [shapely.transform(line, flipped) for line in lines]
        return _enclosed(lines, path)


def _enclosed(lines: Sequence[shapely.LineString], path: Path) -> Area:
    pieces = _noded(lines)
    bridges = _bridges(pieces)
    if bridges:
        pieces = _noded([*pieces, *bridges])
    faces = shapely.get_parts(shapely.polygonize(pieces))
    board = _odd(faces)
    _refuse_open(pieces, board, path)
    if board.is_empty:
        raise FileError(
            f"the lines of '{path}' enclose no area: give the board's outline layer, or leave it out"
        )
    return board


def _noded(lines: Sequence[shapely.LineString]) -> list[shapely.LineString]:
    """The lines cut at every crossing."""
    if not lines:
        return []
    noded = shapely.node(shapely.set_precision(shapely.MultiLineString(list(lines)), GRID_MM))
    return [line for line in shapely.get_parts(noded) if line.length > 0.0]


def _free_ends(pieces: Sequence[shapely.LineString]) -> tuple[Floats, NDArray[np.intp]]:
    """(end, 2) points where only one piece ends, and (end,) the piece."""
    ends = np.concatenate([shapely.get_coordinates(p)[[0, -1]] for p in pieces])
    owner = np.repeat(np.arange(len(pieces)), 2)
    _, inverse, count = np.unique(
        np.round(ends / GRID_MM), axis=0, return_inverse=True, return_counts=True
    )
    free = count[inverse.ravel()] == 1
    return ends[free], owner[free]


def _bridges(pieces: Sequence[shapely.LineString]) -> list[shapely.LineString]:
    """Lines across the gaps at free ends: to the nearest free end, else to the nearest other line."""
    if not pieces:
        return []
    ends, owner = _free_ends(pieces)
    if not len(ends):
        return []
    joined = np.zeros(len(ends), dtype=bool)
    bridges = []
    pairs = cKDTree(ends).query_pairs(CLOSE_MM, output_type="ndarray")
    apart = np.linalg.norm(ends[pairs[:, 0]] - ends[pairs[:, 1]], axis=1)
    for i, j in pairs[np.argsort(apart, kind="stable")]:
        short = owner[i] == owner[j] and pieces[owner[i]].length <= 2 * CLOSE_MM
        if not (joined[i] or joined[j] or short):
            joined[[i, j]] = True
            bridges.append(shapely.LineString([ends[i], ends[j]]))
    tree = shapely.STRtree(pieces)
    for end, own in zip(ends[~joined], owner[~joined], strict=True):
        point = shapely.Point(end)
        near = [int(k) for k in tree.query(point, predicate="dwithin", distance=CLOSE_MM)]
        others = [pieces[k] for k in near if k != own]
        if others:
            closest = min(others, key=point.distance)
            bridge = shapely.shortest_line(point, closest)
            if bridge.length > 0.0:
                bridges.append(bridge)
    return bridges


def _odd(faces: Sequence[shapely.Polygon]) -> Area:
    """What an odd number of the faces' outer rings encloses."""
    rings = np.array([shapely.Polygon(face.exterior) for face in faces])
    inner = np.array([face.representative_point() for face in faces])
    if not len(faces):
        return shapely.Polygon()
    _, face = shapely.STRtree(inner).query(rings, predicate="contains")
    depth = np.bincount(face, minlength=len(faces))
    return shapely.union_all([f for f, d in zip(faces, depth, strict=True) if d % 2])


def _refuse_open(pieces: Sequence[shapely.LineString], board: Area, path: Path) -> None:
    """`FileError` where an open line would, if closed, enclose more than everything that is closed."""
    if not pieces:
        return
    chains = shapely.get_parts(shapely.line_merge(shapely.MultiLineString(list(pieces))))
    for chain in chains:
        corners = shapely.get_coordinates(chain)
        gap = float(np.linalg.norm(corners[0] - corners[-1]))
        if gap == 0.0 or len(corners) < 3 or gap > chain.length / 2:
            continue
        hull = shapely.convex_hull(chain)
        around = board.is_empty or hull.buffer(CLOSE_MM).contains(board)
        if around and hull.area > board.area:
            raise FileError(
                f"the outline in '{path}' is open: its ends at ({corners[0][0]:.3f}, {corners[0][1]:.3f}) and "
                f"({corners[-1][0]:.3f}, {corners[-1][1]:.3f}) mm are {gap:.3g} mm apart, up to {CLOSE_MM:g} mm is "
                "closed; close it in the CAD tool, or leave the outline layer out"
            )
