"""Apertures, how they are mirrored, rotated and scaled, and the objects they paint."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.gerber.macros import regular
from scenes.board.gerber.strokes import Point, Segment, stroke_of_disk, stroke_of_shape
from scenes.board.gerber.tokens import Malformed, length
from scenes.board.pad_layout import Area, Bounds, disk, rectangle

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Painted:
    """One object of an image."""

    dark: bool
    """Paints; otherwise erases what earlier objects painted."""
    bounds: Bounds
    shape: Callable[[], Area]
    """Its area in mm, made when asked for."""
    place: Point | None = None
    """Where an aperture is flashed; None for strokes and regions."""
    paths: Callable[[], Sequence[Floats]] = tuple
    """(point, 2) centre lines of a stroke, or contours of a region."""
    function: str = ""
    """Of the aperture that is flashed, by its X2 attribute ``.AperFunction``."""

    def moved(self, turn: Floats, by: Point, flip: bool = False) -> "Painted":
        """Transformed by a (2, 2) matrix and a shift, its polarity reversed if `flip`."""
        x0, y0, x1, y1 = self.bounds
        corners = np.array([[x0, y0], [x0, y1], [x1, y0], [x1, y1]]) @ turn.T + by
        (a0, b0), (a1, b1) = corners.min(axis=0), corners.max(axis=0)
        place = None
        if self.place is not None:
            x, y = turn @ np.asarray(self.place) + by
            place = (float(x), float(y))
        return Painted(
            self.dark != flip,
            (float(a0), float(b0), float(a1), float(b1)),
            lambda: shapely.transform(self.shape(), lambda xy: xy @ turn.T + by),
            place,
            lambda: [path @ turn.T + by for path in self.paths()],
            self.function,
        )


@dataclass(frozen=True, eq=False)
class Aperture:
    """A shape about its origin in mm, a full disk, or a block of objects."""

    shape: Area
    radius: float | None = None
    block: tuple[Painted, ...] | None = None
    function: str = ""

    @property
    def reach(self) -> float:
        """Distance from the origin that it stays within."""
        if self.shape.is_empty:
            return 0.0
        return float(np.hypot(*np.abs(np.reshape(self.shape.bounds, (2, 2))).max(axis=0)))


@dataclass(frozen=True)
class AperturePose:
    """Mirroring, rotation and scaling of apertures: LM, LR, LS."""

    mirror: str = "N"
    degrees: float = 0.0
    scale: float = 1.0

    @property
    def matrix(self) -> Floats:
        """(2, 2), for column vectors."""
        angle = np.deg2rad(self.degrees)
        flip = np.diag([-1.0 if "X" in self.mirror else 1.0, -1.0 if "Y" in self.mirror else 1.0])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        # Right angles stay exact.
        turn = np.where(np.abs(turn) < 1e-15, 0.0, turn)
        posed: Floats = self.scale * (turn @ flip)
        return posed


def stroked(segment: Segment, tool: Aperture) -> Callable[[], Area]:
    """What an aperture paints along a segment, made when asked for."""
    empty: Area = tool.shape
    if empty.is_empty:
        return lambda: empty
    if tool.radius is not None:
        radius = tool.radius
        return lambda: stroke_of_disk(segment, radius)
    return lambda: stroke_of_shape(segment, tool.shape)


def standard_aperture(name: str, values: list[float], unit: float) -> Aperture:
    """Circle, rectangle, obround or polygon, with a hole where one is given."""
    needed = {"C": 1, "R": 2, "O": 2, "P": 2}[name]
    if len(values) < needed or min(values[:needed]) < 0.0:
        raise Malformed(f"aperture {name} needs {needed} sizes of 0 or more, and has {values}")
    a = length(values[0], unit)
    radius = None
    if name == "C":
        shape, hole = (disk(0.0, 0.0, a / 2) if a else shapely.Polygon()), values[1:]
        radius = None if hole else a / 2
    elif name == "P":
        shape, hole = regular(int(values[1]), a), values[3:]
        turn = AperturePose(degrees=values[2] if len(values) > 2 else 0.0).matrix
        shape = shapely.transform(shape, lambda xy: xy @ turn.T)
    else:
        b, hole = length(values[1], unit), values[2:]
        shape = rectangle(0.0, 0.0, a, b) if a * b else shapely.Polygon()
        if name == "O" and a * b:
            half = abs(a - b) / 2
            end = (half, 0.0) if a > b else (0.0, half)
            shape = stroke_of_disk(Segment((-end[0], -end[1]), end), min(a, b) / 2)
    sizes = [length(size, unit) for size in hole if size > 0.0]
    if sizes:
        cut = rectangle(0.0, 0.0, *sizes[:2]) if len(sizes) > 1 else disk(0.0, 0.0, sizes[0] / 2)
        shape = shape.difference(cut)
    return Aperture(shape, radius)
