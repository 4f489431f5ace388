"""What gerbonara, an independent reader, makes of a Gerber file: a second opinion on what a layer paints."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from scenes.board.gerber.openings import painted
from scenes.board.pad_layout import Area, circle, rectangle
from scenes.support.errors import FileError

# Corners of a whole turn.
CORNERS = 256


def second_area(path: Path, drill: bool = False) -> Area:
    """The painted, or drilled, area in mm as gerbonara reads it; `FileError` where it cannot, or is not installed."""
    try:
        from gerbonara import ExcellonFile, GerberFile
        from gerbonara.utils import MM
    except ImportError as error:
        raise FileError(
            f"the second reader needs gerbonara ({error}): pip install 'fringebench[board]'"
        ) from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            objects = (ExcellonFile if drill else GerberFile).open(path).objects
            pieces = [p for item in objects for p in item.to_primitives(unit=MM)]
        return painted([(_shape(p), bool(p.polarity_dark)) for p in pieces])
    except Exception as error:  # of any kind: it is another program's
        raise FileError(
            f"gerbonara cannot read '{path}': {type(error).__name__}: {error}"
        ) from error


def _shape(item: Any) -> Area:
    kind = type(item).__name__
    if kind == "Circle":
        return shapely.Polygon(circle(item.r, CORNERS) + np.array([item.x, item.y]))
    if kind == "Rectangle":
        return rectangle(item.x, item.y, item.w, item.h, item.rotation)
    if kind == "Line":
        line = shapely.LineString([(item.x1, item.y1), (item.x2, item.y2)])
        return line.buffer(item.width / 2, quad_segs=CORNERS // 4)
    if kind == "Arc":
        ends = (item.x1, item.y1), (item.x2, item.y2)
        line = shapely.LineString([*_arc(*ends, (item.cx, item.cy), item.clockwise), ends[1]])
        return line.buffer(item.width / 2, quad_segs=CORNERS // 4)
    corners: list[tuple[float, float]] = []
    for start, end, (clockwise, centre) in item.segments:
        corners += [start] if clockwise is None else _arc(start, end, centre, clockwise)
    return shapely.make_valid(shapely.Polygon(corners), method="structure", keep_collapsed=False)


def _arc(start: Any, end: Any, centre: Any, clockwise: bool) -> list[tuple[float, float]]:
    """Points of an arc, its end left out; equal ends are a whole turn."""
    (a, b), (x, y) = np.subtract((start, end), centre), centre
    first = np.arctan2(a[1], a[0])
    sweep = (np.arctan2(b[1], b[0]) - first) % (2.0 * np.pi) or 2.0 * np.pi
    if clockwise and sweep < 2.0 * np.pi:
        sweep -= 2.0 * np.pi
    count = max(int(CORNERS * abs(sweep) / (2.0 * np.pi)), 2)
    angle, radius = first + sweep * np.arange(count) / count, float(np.hypot(*a))
    return [(float(x + radius * np.cos(t)), float(y + radius * np.sin(t))) for t in angle]
