"""Openings of a paste layer, and the area that a layer paints."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scenes.board.gerber.apertures import Painted
from scenes.board.gerber.interpreter import read
from scenes.board.gerber.strokes import Point
from scenes.board.gerber.tokens import Malformed
from scenes.board.pad_layout import Area, Bounds, Pad, moved, rounded
from scenes.support.errors import FileError

SMALLEST_PAD_MM2 = 1e-4


def read_pads(path: Path, mirrored: bool = False) -> tuple[Pad, ...]:
    """Read the openings of a paste layer: the connected pieces of what the file paints.

    Parameters
    ----------
    path
        The Gerber file.
    mirrored
        Reverse the sign of x, as for the bottom side seen from below.

    Returns
    -------
    tuple of Pad
        In the order in which the file first paints them. A pad's centre is where its first aperture is flashed, or its
        centroid where it is drawn; its aperture is relative to that, mm.

    Raises
    ------
    FileError
        For a file that is not a whole, valid Gerber file, or holds no opening.

    Notes
    -----
    Polarity acts in order: a clear object erases what was painted before it, not what comes later. Pieces smaller than
    1e-4 mm2 are left out.
    """
    with drawable(path):
        image = read(path)
        if image.negative:
            raise Malformed("a negative image (IPNEG) has no separate openings")
        pads = [
            Pad(i, f"P{i}", place, rounded(moved(shape, (-place[0], -place[1]))))
            for i, (place, shape) in enumerate(_openings(image.objects, mirrored), start=1)
        ]
    if not pads:
        raise FileError(f"'{path}' holds no paste opening: give the board's paste layer")
    return tuple(pads)


def read_area(path: Path, box: Bounds, mirrored: bool = False) -> Area:
    """Read what a layer paints inside a box.

    Parameters
    ----------
    path
        The Gerber file.
    box
        x and y from, x and y to, mm; after mirroring.
    mirrored
        Reverse the sign of x, as for the bottom side seen from below.

    Returns
    -------
    shapely.Geometry
        Painted area, mm.

    Raises
    ------
    FileError
        For a file that is not a whole, valid Gerber file.
    """
    with drawable(path):
        image = read(path)
        window = (-box[2], box[1], -box[0], box[3]) if mirrored else box
        # Most of a board's copper is outside, and polygons cost more than bounds.
        near = [item for item in image.objects if _meet(item.bounds, window)]
        area = painted([(item.shape(), item.dark) for item in near])
        frame = shapely.box(*window)
        area = frame.difference(area) if image.negative else area.intersection(frame)
        return shapely.transform(area, flipped) if mirrored else area


def read_fiducials(path: Path, mirrored: bool = False) -> tuple[shapely.Polygon, ...]:
    """Read what a copper layer flashes with apertures of the attribute ``FiducialPad``.

    Parameters
    ----------
    path
        The Gerber file.
    mirrored
        Reverse the sign of x, as for the bottom side seen from below.

    Returns
    -------
    tuple of Polygon
        Outlines in mm, in the file's order; empty where the file names none.

    Raises
    ------
    FileError
        For a file that is not a whole, valid Gerber file.
    """
    with drawable(path):
        named = [o for o in read(path).objects if o.dark and o.function == "FiducialPad"]
        shapes = [part for item in named for part in shapely.get_parts(item.shape())]
        return tuple(shapely.transform(s, flipped) if mirrored else s for s in shapes)


def painted(pieces: Sequence[tuple[Area, bool]]) -> Area:
    """Dark pieces added and clear ones removed, in order."""
    area: Area = shapely.Polygon()
    start = 0
    while start < len(pieces):
        dark, end = pieces[start][1], start
        while end < len(pieces) and pieces[end][1] == dark:
            end += 1
        layer = shapely.union_all([shape for shape, _ in pieces[start:end]])
        area = area.union(layer) if dark else area.difference(layer)
        start = end
    return area


def flipped(xy: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points seen from below."""
    return np.column_stack([-xy[:, 0], xy[:, 1]])


def _openings(
    objects: Sequence[Painted], mirrored: bool
) -> Iterator[tuple[Point, shapely.Polygon]]:
    # To a nanometre, so that strokes and windows that abut share their edge.
    shapes = np.array([rounded(item.shape()) for item in objects])
    kept = ~shapely.is_empty(shapes)
    objects, shapes = [o for o, k in zip(objects, kept, strict=True) if k], shapes[kept]
    dark = np.array([item.dark for item in objects], dtype=bool)
    clear = np.flatnonzero(~dark)
    for members in _groups(shapes, np.flatnonzero(dark)):
        area, first = shapes[members[0]], members[0]
        erasing = clear[clear > first]
        erasing = erasing[shapely.intersects(shapely.union_all(shapes[members]), shapes[erasing])]
        if len(members) > 1 or len(erasing):
            order = np.sort(np.concatenate([members, erasing]))
            area = painted([(shapes[i], bool(dark[i])) for i in order])
        flashes = [i for i in members if objects[i].place is not None]
        for part in shapely.get_parts(area):
            if part.geom_type != "Polygon" or part.area <= SMALLEST_PAD_MM2:
                continue
            place = (part.centroid.x, part.centroid.y)
            for i in flashes:
                flashed = objects[i].place
                if flashed is not None and part.intersects(shapes[i]):
                    place = flashed
                    break
            if mirrored:
                yield (-place[0], place[1]), shapely.transform(part, flipped)
            else:
                yield place, part


def _groups(shapes: NDArray[np.object_], chosen: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Indices of shapes that touch each other, directly or through others, in the order of each group's first."""
    if not len(chosen):
        return []
    a, b = shapely.STRtree(shapes[chosen]).query(shapes[chosen], predicate="intersects")
    size = len(chosen)
    _, group = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(size, size)))
    order = np.argsort(group, kind="stable")
    ends = np.flatnonzero(np.diff(group[order])) + 1
    groups = [np.sort(chosen[part]) for part in np.split(order, ends)]
    return sorted(groups, key=lambda members: int(members[0]))


def _meet(a: Bounds, b: Bounds) -> bool:
    return a[0] <= b[2] and a[2] >= b[0] and a[1] <= b[3] and a[3] >= b[1]


@contextmanager
def drawable(path: Path) -> Iterator[None]:
    """Shapes that cannot be, of damaged files mostly, as `FileError`."""
    try:
        yield
    except (shapely.errors.ShapelyError, ValueError, TypeError, OverflowError) as error:
        raise FileError(
            f"'{path}' draws a shape that cannot be: {error}; export the layer again"
        ) from error
