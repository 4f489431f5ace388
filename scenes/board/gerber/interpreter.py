"""The Gerber Layer Format's graphics state, and the objects that a file paints, in order."""

import re
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.gerber.apertures import (
    Aperture,
    AperturePose,
    Painted,
    standard_aperture,
    stroked,
)
from scenes.board.gerber.macros import Macro
from scenes.board.gerber.strokes import Point, Segment, valid
from scenes.board.gerber.tokens import Command, Malformed, length, number, split_commands
from scenes.support.errors import FileError
from scenes.support.paths import is_file, missing

Floats = NDArray[np.float64]

# Step and repeat and blocks multiply objects; a panel of boards has some hundred thousand.
MAX_OBJECTS = 1_000_000
INCH_MM = 25.4
UNITS = {"MM": 1.0, "IN": INCH_MM}

_WORD = re.compile(r"([GDMNXYIJ])([+-]?[0-9.]+)")
_FORMAT = re.compile(r"FS([LTD]?)([AI]?)(?:[NG]\d+)?X(\d)(\d)Y(\d)(\d)(?:[DM]\d+)?$")
_REPEAT = re.compile(r"SR(?:X(\d+))?(?:Y(\d+))?(?:I([-+.\d]+))?(?:J([-+.\d]+))?$")
_DEFINITION = re.compile(r"ADD(\d+)([A-Za-z_.$][\w.$+-]*)(?:,(.*))?$")
_PAIR = re.compile(r"(?:A([-+.\d]+))?(?:B([-+.\d]+))?$")
# Names, attributes and plotter settings, which paint nothing.
_IGNORED = ("TF", "TA", "TO", "TD", "IN", "LN", "PF", "IC")


@dataclass(frozen=True)
class LayerImage:
    """What a file paints."""

    objects: tuple[Painted, ...]
    negative: bool
    """Everything is painted that the objects leave free (deprecated)."""


@dataclass
class _Frame:
    """Objects under construction: the image, a step-and-repeat block, or a block aperture."""

    objects: list[Painted] = field(default_factory=list)
    repeat: tuple[int, int, float, float] | None = None
    block: int | None = None


def read(path: Path) -> LayerImage:
    """The objects of a Gerber file, in order, in mm. Raises `FileError` for what is not a whole, valid file."""
    if not is_file(path):
        raise FileError(f"Gerber file '{path}' {missing(path)}: check the path")
    status = path.stat()
    return _read(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=8)
def _read(path: Path, size: int, time_ns: int) -> LayerImage:
    """The same, cached for one state of the file: each sample of a data set may show another region of it."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error}") from error
    state = _State()
    done = 0
    try:
        for command in split_commands(text):
            state.obey(command)
            done += 1
            if state.ended:
                break
        image = state.image()
    except Malformed as error:
        raise FileError(
            f"'{path}' cannot be read as a Gerber file: {error} (after {done} commands); export the layer again"
        ) from error
    if not image.objects:
        raise FileError(f"'{path}' draws nothing: it is empty or not a Gerber file")
    return image


class _State:
    """Everything that commands change."""

    def __init__(self) -> None:
        self.ended = False
        self.unit: float | None = None
        self.digits: tuple[str, int, int] | None = None
        self.incremental = False
        self.point: Point = (0.0, 0.0)
        self.operation: int | None = None
        self.interpolation = 1
        self.quadrants: int | None = None
        self.aperture: int | None = None
        self.dark = True
        self.pose = AperturePose()
        self.contours: list[list[Segment]] | None = None
        self.macros: dict[str, Macro] = {}
        self.apertures: dict[int, Aperture] = {}
        self.posed: dict[tuple[int, AperturePose], Aperture] = {}
        self.frames = [_Frame()]
        self.negative = False
        self.turn = 0
        self.offset: Point = (0.0, 0.0)

    def image(self) -> LayerImage:
        """What was painted; `Malformed` if the file is not at its end."""
        if not self.ended:
            raise Malformed("the file does not end with M02: it is cut off, or not a Gerber file")
        self._close_repeat()
        if len(self.frames) > 1:
            raise Malformed("a block aperture is not closed by %AB*%")
        objects = tuple(self.frames[0].objects)
        if self.turn or self.offset != (0.0, 0.0):
            if self.turn and self.offset != (0.0, 0.0):
                raise Malformed("image rotation (IR) with an offset (OF) is not supported")
            matrix = AperturePose(degrees=float(self.turn)).matrix
            objects = tuple(item.moved(matrix, self.offset) for item in objects)
        return LayerImage(objects, self.negative)

    def obey(self, command: Command) -> None:
        """Apply one command."""
        if command.extended:
            self._extended(command.text)
        elif command.text:
            self._words(command.text)

    # Words

    def _words(self, text: str) -> None:
        if text == "ICAS":
            return
        words = _WORD.findall(text)
        if "".join(code + value for code, value in words) != text:
            raise Malformed(f"'{text[:40]}' is not a command")
        coordinates: dict[str, str] = {}
        operation = None
        for code, value in words:
            if code == "G":
                self._general(_integer(value))
            elif code == "M":
                if _integer(value) not in (0, 1, 2, 30):
                    raise Malformed(f"'M{value}' is not a command")
                self.ended = self.ended or _integer(value) != 1
            elif code == "D":
                operation = self._select(_integer(value), operation)
            elif code != "N":
                coordinates[code] = value
        if coordinates or operation in (1, 2, 3):
            self._operate(coordinates, operation)

    def _general(self, code: int) -> None:
        if code in (1, 2, 3):
            self.interpolation = code
        elif code == 36:
            self.contours = []
        elif code == 37:
            self._close_region()
        elif code in (74, 75):
            self.quadrants = code
        elif code in (70, 71):
            self.unit = INCH_MM if code == 70 else 1.0
        elif code in (90, 91):
            self.incremental = code == 91
        elif code not in (54, 55):
            raise Malformed(f"'G{code:02}' is not a command")

    def _select(self, code: int, operation: int | None) -> int | None:
        if code in (1, 2, 3):
            return code
        if code < 10:
            raise Malformed(f"'D{code:02}' is not a command")
        # Zuken selects an undefined D10 for regions; it is only missed where it paints.
        if code not in self.apertures and code != 10:
            raise Malformed(f"aperture D{code} is not defined")
        self.aperture = code
        return operation

    def _operate(self, coordinates: dict[str, str], operation: int | None) -> None:
        start = self.point
        end = self._point(coordinates)
        # Deprecated: coordinates alone repeat the last operation.
        operation = operation or self.operation
        self.operation, self.point = operation, end
        if operation == 1:
            self._draw(start, end, coordinates)
        elif operation == 2 and self.contours is not None:
            self.contours.append([])
        elif operation == 3:
            if self.contours is not None:
                raise Malformed("a flash (D03) inside a region")
            self._flash(end)

    def _point(self, coordinates: dict[str, str]) -> Point:
        found = []
        for code, old in zip("XY", self.point, strict=True):
            value = old
            if code in coordinates:
                value = self._coordinate(coordinates[code])
                value += old if self.incremental else 0.0
            found.append(length(value))
        return found[0], found[1]

    def _coordinate(self, text: str) -> float:
        """In mm."""
        if self.unit is None:
            raise Malformed("coordinates come before their unit (%MOMM*% or %MOIN*%)")
        if "." in text:
            return length(number(text), self.unit)
        if self.digits is None:
            raise Malformed("coordinates come before their format (%FS...*%)")
        zeros, whole, decimals = self.digits
        sign, figures = (-1.0 if text[0] == "-" else 1.0), text.lstrip("+-")
        if zeros == "T":
            figures = figures.ljust(whole + decimals, "0")
        if not figures.isdecimal():
            raise Malformed(f"'{text[:40]}' is not a coordinate")
        return length(sign * int(figures) / 10**decimals, self.unit)

    def _draw(self, start: Point, end: Point, coordinates: dict[str, str]) -> None:
        segment = self._segment(start, end, coordinates)
        if self.contours is not None:
            if not self.contours:
                self.contours.append([])
            self.contours[-1].append(segment)
            return
        tool = self._tool()
        if tool.block is not None:
            raise Malformed("a stroke (D01) with a block aperture")
        points, reach = segment.points(), tool.reach
        (x0, y0), (x1, y1) = points.min(axis=0) - reach, points.max(axis=0) + reach
        bounds = (float(x0), float(y0), float(x1), float(y1))
        self._add(Painted(self.dark, bounds, stroked(segment, tool), None, lambda: [points]))

    def _segment(self, start: Point, end: Point, coordinates: dict[str, str]) -> Segment:
        if self.interpolation == 1 or not coordinates.keys() & {"I", "J"}:
            return Segment(start, end)
        i, j = (self._coordinate(coordinates.get(code, "0")) for code in "IJ")
        clockwise = self.interpolation == 2
        whole = Segment(start, end, (start[0] + i, start[1] + j), clockwise)
        if self.quadrants == 75 or (self.quadrants is None and _is_round(whole)):
            return whole
        if start == end:
            return Segment(start, end)
        # Single quadrant (deprecated): the signs of I and J follow from an arc of at most 90 degrees.
        fits = []
        for a, b in product((1, -1), repeat=2):
            arc = replace(whole, centre=(start[0] + a * abs(i), start[1] + b * abs(j)))
            if _is_round(arc):
                _, sweep, first, last = arc.arc()
                if abs(sweep) <= np.pi / 2 + 1e-3:
                    fits.append((abs(first - last), arc))
        if not fits:
            raise Malformed("no centre gives a circular arc of at most 90 degrees (G74)")
        return min(fits, key=lambda fit: fit[0])[1]

    def _close_region(self) -> None:
        if self.contours is None:
            raise Malformed("a region ends (G37) that was not begun (G36)")
        contours = [np.concatenate([s.points() for s in c]) for c in self.contours if c]
        self.contours = None
        if not contours:
            return
        if any(len(np.unique(contour, axis=0)) < 3 for contour in contours):
            raise Malformed("a region's contour that cannot be: it has fewer than three points")
        every = np.concatenate(contours)
        (x0, y0), (x1, y1) = every.min(axis=0), every.max(axis=0)
        self._add(
            Painted(
                self.dark,
                (float(x0), float(y0), float(x1), float(y1)),
                lambda: shapely.union_all([valid(shapely.Polygon(c)) for c in contours]),
                None,
                lambda: contours,
            )
        )

    def _flash(self, at: Point) -> None:
        tool = self._tool()
        if tool.block is not None:
            matrix = self.pose.matrix
            for item in tool.block:
                self._add(item.moved(matrix, at, flip=not self.dark))
            return
        x0, y0, x1, y1 = (0.0,) * 4 if tool.shape.is_empty else tool.shape.bounds
        bounds = (x0 + at[0], y0 + at[1], x1 + at[0], y1 + at[1])
        place = np.asarray(at)
        self._add(
            Painted(
                self.dark, bounds, lambda: shapely.transform(tool.shape, lambda xy: xy + place), at
            )
        )

    def _tool(self) -> Aperture:
        """The selected aperture as mirrored, rotated and scaled."""
        if self.aperture is None or self.aperture not in self.apertures:
            raise Malformed("an aperture is used before it is defined and selected")
        plain = self.apertures[self.aperture]
        if self.pose == AperturePose() or plain.block is not None:
            return plain
        key = (self.aperture, self.pose)
        if key not in self.posed:
            matrix, radius = self.pose.matrix, plain.radius
            shape = shapely.transform(plain.shape, lambda xy: xy @ matrix.T)
            self.posed[key] = Aperture(shape, None if radius is None else radius * self.pose.scale)
        return self.posed[key]

    def _add(self, item: Painted) -> None:
        if len(self.frames[-1].objects) >= MAX_OBJECTS:
            raise Malformed(f"more than {MAX_OBJECTS} objects")
        self.frames[-1].objects.append(item)

    # Extended commands

    def _extended(self, text: str) -> None:
        code, rest = text[:2], text[2:]
        if code in _IGNORED:
            return
        if code == "AM":
            macro = Macro.parse(rest)
            self.macros[macro.name] = macro
            return
        text = re.sub(r"\s+", "", text)
        rest = text[2:]
        handler = {
            "FS": self._format,
            "MO": self._units,
            "AD": self._define,
            "AB": self._block,
            "SR": self._repeat,
            "LP": self._polarity,
            "LM": self._mirror,
            "LR": self._rotate,
            "LS": self._scale,
            "IP": self._image_polarity,
            "IR": self._image_rotation,
            "OF": self._image_offset,
        }.get(code)
        if handler is not None:
            handler(text)
        elif code in ("MI", "SF", "AS"):
            neutral = {"MI": (0.0, 0.0), "SF": (1.0, 1.0)}
            if rest != "AXBY" and (code == "AS" or _pair(rest, neutral[code][0]) != neutral[code]):
                raise Malformed(f"'{text[:40]}' transforms the whole image, which is not supported")
        elif re.match(r"[GDMXY]\d", text):
            # Some tools put words between percent signs.
            self._words(text)
        else:
            raise Malformed(f"'{text[:40]}' is not a supported command")

    def _format(self, text: str) -> None:
        match = _FORMAT.match(text)
        if not match or match[3] != match[5] or match[4] != match[6]:
            raise Malformed(f"'{text[:40]}' is not a coordinate format")
        self.digits = (match[1] or "L", int(match[3]), int(match[4]))
        self.incremental = match[2] == "I"

    def _units(self, text: str) -> None:
        if text[2:] not in UNITS:
            raise Malformed(f"'{text[:40]}' is not a unit: MM and IN are")
        self.unit = UNITS[text[2:]]

    def _define(self, text: str) -> None:
        match = _DEFINITION.match(text)
        if not match or int(match[1]) < 10:
            raise Malformed(f"'{text[:40]}' does not define an aperture")
        if self.unit is None:
            raise Malformed("an aperture comes before the unit (%MOMM*% or %MOIN*%)")
        values = [number(value) for value in (match[3] or "").strip("X,").split("X") if value]
        name = match[2]
        if name in ("C", "R", "O", "P"):
            self.apertures[int(match[1])] = standard_aperture(name, values, self.unit)
        elif name in self.macros:
            self.apertures[int(match[1])] = Aperture(self.macros[name].shape(values, self.unit))
        else:
            raise Malformed(f"aperture macro '{name[:40]}' is not defined")
        self.posed = {key: tool for key, tool in self.posed.items() if key[0] != int(match[1])}

    def _block(self, text: str) -> None:
        if text == "AB":
            frame = self.frames.pop() if self.frames[-1].block is not None else None
            if frame is None or frame.block is None:
                raise Malformed("%AB*% closes a block aperture that was not opened")
            self.apertures[frame.block] = Aperture(shapely.Polygon(), None, tuple(frame.objects))
            return
        if not re.match(r"ABD[1-9]\d+$", text):
            raise Malformed(f"'{text[:40]}' does not open a block aperture")
        self.frames.append(_Frame(block=int(text[3:])))

    def _repeat(self, text: str) -> None:
        match = _REPEAT.match(text)
        if not match:
            raise Malformed(f"'{text[:40]}' is not a step and repeat")
        self._close_repeat()
        columns, rows = int(match[1] or 1), int(match[2] or 1)
        if columns < 1 or rows < 1:
            raise Malformed(f"'{text[:40]}' repeats nothing")
        if columns * rows > 1:
            unit = self.unit or 1.0
            step_x, step_y = (length(number(match[i] or "0"), unit) for i in (3, 4))
            self.frames.append(_Frame(repeat=(columns, rows, step_x, step_y)))

    def _close_repeat(self) -> None:
        frame = self.frames[-1]
        if frame.repeat is None:
            return
        self.frames.pop()
        columns, rows, step_x, step_y = frame.repeat
        if columns * rows * len(frame.objects) > MAX_OBJECTS:
            raise Malformed(f"step and repeat makes more than {MAX_OBJECTS} objects")
        for column in range(columns):
            for row in range(rows):
                by = (column * step_x, row * step_y)
                for item in frame.objects:
                    self._add(item.moved(np.eye(2), by) if by != (0.0, 0.0) else item)

    def _polarity(self, text: str) -> None:
        self.dark = {"LPD": True, "LPC": False}[_known(text, "LPD", "LPC")]

    def _mirror(self, text: str) -> None:
        self.pose = replace(self.pose, mirror=_known(text, "LMN", "LMX", "LMY", "LMXY")[2:])

    def _rotate(self, text: str) -> None:
        self.pose = replace(self.pose, degrees=number(text[2:]) % 360.0)

    def _scale(self, text: str) -> None:
        scale = length(number(text[2:]))
        if not scale > 0.0:
            raise Malformed(f"'{text[:40]}' scales to nothing")
        self.pose = replace(self.pose, scale=scale)

    def _image_polarity(self, text: str) -> None:
        self.negative = _known(text, "IPPOS", "IPNEG") == "IPNEG"

    def _image_rotation(self, text: str) -> None:
        self.turn = int(_known(text, "IR0", "IR90", "IR180", "IR270")[2:])

    def _image_offset(self, text: str) -> None:
        x, y = _pair(text[2:], 0.0)
        unit = self.unit or 1.0
        self.offset = (length(x, unit), length(y, unit))


def _is_round(segment: Segment) -> bool:
    try:
        segment.arc()
    except Malformed:
        return False
    return True


def _known(text: str, *allowed: str) -> str:
    if text not in allowed:
        raise Malformed(f"'{text[:40]}' is not a command: {', '.join(allowed)} are")
    return text


def _pair(text: str, default: float) -> tuple[float, float]:
    match = _PAIR.match(text)
    if not match:
        raise Malformed(f"'{text[:40]}' is not a pair of numbers")
    return (number(match[1]) if match[1] else default, number(match[2]) if match[2] else default)


def _integer(text: str) -> int:
    if not text.isdecimal() or len(text) > 9:
        raise Malformed(f"'{text[:40]}' is not a command number")
    return int(text)
