"""The commands of the Gerber Layer Format, in order: they set its graphics state and paint."""

import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenes.board.gerber.apertures import Aperture, standard_aperture
from scenes.board.gerber.canvas import Canvas, LayerImage
from scenes.board.gerber.coordinates import CoordinateReader
from scenes.board.gerber.macros import Macro
from scenes.board.gerber.strokes import Point, Segment
from scenes.board.gerber.tokens import Command, Malformed, length, number, split_commands
from scenes.support.errors import FileError
from scenes.support.paths import is_file, missing

Floats = NDArray[np.float64]

INCH_MM = 25.4
UNITS = {"MM": 1.0, "IN": INCH_MM}

_WORD = re.compile(r"([GDMNXYIJ])([+-]?[0-9.]+)")
_REPEAT = re.compile(r"SR(?:X(\d+))?(?:Y(\d+))?(?:I([-+.\d]+))?(?:J([-+.\d]+))?$")
_DEFINITION = re.compile(r"ADD(\d+)([A-Za-z_.$][\w.$+-]*)(?:,(.*))?$")
_PAIR = re.compile(r"(?:A([-+.\d]+))?(?:B([-+.\d]+))?$")
# Names, attributes and plotter settings, which paint nothing.
_IGNORED = ("TF", "TA", "TO", "TD", "IN", "LN", "PF", "IC")


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
    """What commands change."""

    def __init__(self) -> None:
        self.ended = False
        self.read = CoordinateReader()
        self.point: Point = (0.0, 0.0)
        self.operation: int | None = None
        self.contours: list[list[Segment]] | None = None
        self.macros: dict[str, Macro] = {}
        self.canvas = Canvas()
        self.negative = False
        self.turn = 0
        self.offset: Point = (0.0, 0.0)

    def image(self) -> LayerImage:
        """What was painted; `Malformed` if the file is not at its end."""
        if not self.ended:
            raise Malformed("the file does not end with M02: it is cut off, or not a Gerber file")
        return self.canvas.image(self.negative, self.turn, self.offset)

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
            self.read.interpolation = code
        elif code == 36:
            self.contours = []
        elif code == 37:
            self._close_region()
        elif code in (74, 75):
            self.read.quadrants = code
        elif code in (70, 71):
            self.read.unit = INCH_MM if code == 70 else 1.0
        elif code in (90, 91):
            self.read.incremental = code == 91
        elif code not in (54, 55):
            raise Malformed(f"'G{code:02}' is not a command")

    def _select(self, code: int, operation: int | None) -> int | None:
        if code in (1, 2, 3):
            return code
        if code < 10:
            raise Malformed(f"'D{code:02}' is not a command")
        # Zuken selects an undefined D10 for regions; it is only missed where it paints.
        if code not in self.canvas.apertures and code != 10:
            raise Malformed(f"aperture D{code} is not defined")
        self.canvas.selected = code
        return operation

    def _operate(self, coordinates: dict[str, str], operation: int | None) -> None:
        start = self.point
        end = self.read.point(coordinates, start)
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
            self.canvas.flash(end)

    def _draw(self, start: Point, end: Point, coordinates: dict[str, str]) -> None:
        segment = self.read.segment(start, end, coordinates)
        if self.contours is not None:
            if not self.contours:
                self.contours.append([])
            self.contours[-1].append(segment)
            return
        self.canvas.stroke(segment)

    def _close_region(self) -> None:
        if self.contours is None:
            raise Malformed("a region ends (G37) that was not begun (G36)")
        contours, self.contours = self.contours, None
        self.canvas.region(contours)

    # Extended commands

    def _extended(self, text: str) -> None:
        code, rest = text[:2], text[2:]
        if code in _IGNORED:
            self.canvas.attribute(text)
            return
        if code == "AM":
            macro = Macro.parse(rest)
            self.macros[macro.name] = macro
            return
        text = re.sub(r"\s+", "", text)
        rest = text[2:]
        handler = {
            "FS": self.read.take_format,
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

    def _units(self, text: str) -> None:
        if text[2:] not in UNITS:
            raise Malformed(f"'{text[:40]}' is not a unit: MM and IN are")
        self.read.unit = UNITS[text[2:]]

    def _define(self, text: str) -> None:
        match = _DEFINITION.match(text)
        if not match or int(match[1]) < 10:
            raise Malformed(f"'{text[:40]}' does not define an aperture")
        if self.read.unit is None:
            raise Malformed("an aperture comes before the unit (%MOMM*% or %MOIN*%)")
        values = [number(value) for value in (match[3] or "").strip("X,").split("X") if value]
        name = match[2]
        if name in ("C", "R", "O", "P"):
            tool = standard_aperture(name, values, self.read.unit)
        elif name in self.macros:
            tool = Aperture(self.macros[name].shape(values, self.read.unit))
        else:
            raise Malformed(f"aperture macro '{name[:40]}' is not defined")
        self.canvas.define(int(match[1]), tool)

    def _block(self, text: str) -> None:
        if text == "AB":
            self.canvas.close_block()
            return
        if not re.match(r"ABD[1-9]\d+$", text):
            raise Malformed(f"'{text[:40]}' does not open a block aperture")
        self.canvas.open_block(int(text[3:]))

    def _repeat(self, text: str) -> None:
        match = _REPEAT.match(text)
        if not match:
            raise Malformed(f"'{text[:40]}' is not a step and repeat")
        self.canvas.close_repeat()
        columns, rows = int(match[1] or 1), int(match[2] or 1)
        if columns < 1 or rows < 1:
            raise Malformed(f"'{text[:40]}' repeats nothing")
        if columns * rows > 1:
            unit = self.read.unit or 1.0
            step_x, step_y = (length(number(match[i] or "0"), unit) for i in (3, 4))
            self.canvas.open_repeat(columns, rows, (step_x, step_y))

    def _polarity(self, text: str) -> None:
        self.canvas.dark = {"LPD": True, "LPC": False}[_known(text, "LPD", "LPC")]

    def _mirror(self, text: str) -> None:
        self.canvas.pose = replace(
            self.canvas.pose, mirror=_known(text, "LMN", "LMX", "LMY", "LMXY")[2:]
        )

    def _rotate(self, text: str) -> None:
        self.canvas.pose = replace(self.canvas.pose, degrees=number(text[2:]) % 360.0)

    def _scale(self, text: str) -> None:
        scale = length(number(text[2:]))
        if not scale > 0.0:
            raise Malformed(f"'{text[:40]}' scales to nothing")
        self.canvas.pose = replace(self.canvas.pose, scale=scale)

    def _image_polarity(self, text: str) -> None:
        self.negative = _known(text, "IPPOS", "IPNEG") == "IPNEG"

    def _image_rotation(self, text: str) -> None:
        self.turn = int(_known(text, "IR0", "IR90", "IR180", "IR270")[2:])

    def _image_offset(self, text: str) -> None:
        x, y = _pair(text[2:], 0.0)
        unit = self.read.unit or 1.0
        self.offset = (length(x, unit), length(y, unit))


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
