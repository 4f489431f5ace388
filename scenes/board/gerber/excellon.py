"""Drill files of the Excellon kind (CNC-7, XNC) as outlines of holes and slots, in mm.

What is not known is refused, and so are numbers whose meaning the file does not state, so that no hole is lost or
misplaced without a message.
"""

import re
from dataclasses import dataclass
from typing import Literal

import numpy as np
import shapely

from scenes.board.gerber.interpreter import INCH_MM
from scenes.board.gerber.strokes import Point, Segment, stroke_of_disk
from scenes.board.gerber.tokens import Malformed, length, number
from scenes.support.frozen import Frozen

# No hole is larger; a larger tool is a size written without its decimal point.
LARGEST_TOOL_MM = 200.0
MAX_HOLES = 200_000
ASK = "set board.holes.number_format"

_PLATING = re.compile(r"(NON?[-_ ]?PLATED|UNPLATED|NPTH|NPLT)|(PLATED|PTH|PLT)", re.IGNORECASE)
_STATES_PLATING = re.compile(r"TYPE=|FileFunction|AperFunction|Contents|Tolerance", re.IGNORECASE)
_HOLESIZE = re.compile(r"Holesize (\d+)\. = ([\d.]+) Tolerance.*? (MILS|MM)\b")
_DIGITS = re.compile(r"FORMAT=\{?(\d):(\d)")
_UNIT = re.compile(r"(METRIC|INCH|M7[12])((?:,(?:LZ|TZ|0+\.0+))*)$")
# Settings of the machine that move no hole.
_IGNORED = re.compile(
    r"(FMAT,2|VER,\d|DETECT,\w+|ATC,\w+|ICI,OFF|TCST,\w+|SBK,\w+|CP,.*|CCW,.*|R,[TCDH]+|OM48|M47.*|M0?[69]|%|G93X0*Y0*)$"
)
_TOOL = re.compile(r"T(\d+)((?:[CFSBHZ][\d.]+)*)$")
_WORD = re.compile(r"([GMXYAIJRFS])([+-]?[\d.]*)")


class DrillFormat(Frozen):
    """How numbers of a drill file are written, where the file itself does not say."""

    unit: Literal["mm", "inch"] | None = None
    digits: tuple[int, int] | None = None
    """Before and after the decimal point; 2 and 4 in inches, 3 and 3 in mm where nothing is said."""
    zeros_left_out: Literal["leading", "trailing"] | None = None


@dataclass(frozen=True, eq=False)
class DrilledOutline:
    """A hole or slot."""

    outline: shapely.Polygon
    plated: bool | None
    """None: not stated."""


def plating(text: str) -> bool | None:
    """Whether a comment or a name says plated; None where it says neither."""
    match = _PLATING.search(text)
    return None if match is None else match[1] is None


class DrillProgram:
    """What the lines of an Excellon program change."""

    def __init__(self, number_format: DrillFormat, plated: bool | None) -> None:
        unit = number_format.unit
        self.unit = None if unit is None else {"mm": 1.0, "inch": INCH_MM}[unit]
        self.digits = number_format.digits
        self.zeros = number_format.zeros_left_out
        self.plated = plated
        self.tools: dict[int, tuple[float, bool | None]] = {}
        self.tool: tuple[float, bool | None] | None = None
        self.header = self.incremental = self.routing = self.down = self.ended = False
        self.restated = False
        self.interpolation = 0
        self.point: Point = (0.0, 0.0)
        self.path: list[Segment] = []
        self.holes: list[DrilledOutline] = []

    def drilled(self) -> tuple[DrilledOutline, ...]:
        """Everything drilled; `Malformed` if the program is not at its end."""
        if not self.ended or self.down:
            raise Malformed("the file does not end with M30: it is cut off, or not a drill file")
        return tuple(self.holes)

    def obey(self, line: str) -> None:
        """Apply one line."""
        if not line:
            return
        if line[0] in ";(":
            self._comment(line)
            return
        if self.ended and line[0] not in "M%":
            raise Malformed(
                f"'{line[:40]}' comes after the end (M30, M00): give each program a file"
            )
        line = re.sub(r"^N\d+", "", line)
        if line in ("M48", "M95", "%"):
            self.header = line == "M48"
        elif match := _UNIT.match(line):
            self._units(match[1], match[2])
        elif line in ("ICI,ON", "G91", "G90"):
            self.incremental = line != "G90"
        elif match := _TOOL.match(line):
            self._tool(int(match[1]), match[2])
        elif not _IGNORED.match(line):
            self._words(line)

    def _comment(self, text: str) -> None:
        if match := _DIGITS.search(text):
            self.digits = (int(match[1]), int(match[2]))
        if _STATES_PLATING.search(text):
            plated = plating(text)
            if match := _HOLESIZE.search(text):
                size = float(match[2]) * (INCH_MM / 1000.0 if match[3] == "MILS" else 1.0)
                self.tools[int(match[1])] = (_sized(size), plated)
            elif plated is not None:
                # Old tools state the plating before a tool's holes, not before its size.
                self.plated, self.restated = plated, bool(self.tools) and not self.header

    def _units(self, unit: str, rest: str) -> None:
        self.unit = INCH_MM if unit in ("INCH", "M72") else 1.0
        for word in rest.split(",")[1:]:
            if word in ("LZ", "TZ"):
                # The zeros that are kept, not those left out.
                self.zeros = "trailing" if word == "LZ" else "leading"
            else:
                whole, decimals = word.split(".")
                self.digits = (len(whole), len(decimals))

    def _tool(self, code: int, rest: str) -> None:
        sizes = re.findall(r"C([\d.]+)", rest)
        if sizes:
            if "." not in sizes[0] and len(sizes[0]) > 2:
                raise Malformed(f"tool T{code} has size {sizes[0]} without a decimal point")
            if self.unit is None:
                raise Malformed(f"it does not say its unit; {ASK}")
            self.tools[code] = (_sized(number(sizes[0]) * self.unit), self.plated)
        if self.header or (code == 0 and code not in self.tools):
            return
        if code not in self.tools:
            raise Malformed(f"tool T{code} is not defined")
        size, plated = self.tools[code]
        self.tool = (size, self.plated if self.restated else plated)

    # Words

    def _words(self, text: str) -> None:
        words = _WORD.findall(text)
        if "".join(code + value for code, value in words) != text:
            raise Malformed(f"'{text[:40]}' is not a known command")
        if self.header:
            raise Malformed(f"'{text[:40]}' is not a known command of a header")
        place: dict[str, str] = {}
        start: Point | None = None
        repeats = 0
        for code, value in words:
            if code == "G" and value == "85":
                start, place = self._point(place), {}
                self.point = start
            elif code == "G":
                self._general(value)
            elif code == "M":
                self._miscellaneous(value)
            elif code == "R":
                repeats = int(value)
            elif code not in "FS":
                place[code] = value
        if repeats:
            step = tuple(self._length(place.get(axis, "0")) for axis in "XY")
            for _ in range(repeats):
                self.point = (self.point[0] + step[0], self.point[1] + step[1])
                self._drill([Segment(self.point, self.point)])
        elif place:
            self._go(place, start)

    def _go(self, place: dict[str, str], slot_from: Point | None) -> None:
        start, end = self.point, self._point(place)
        self.point = end
        if place.keys() - {"X", "Y"} and not (self.routing and self.interpolation > 1):
            raise Malformed("a radius or centre (A, I, J) outside an arc")
        if slot_from is not None:
            self._drill([Segment(slot_from, end)])
        elif not self.routing:
            self._drill([Segment(end, end)])
        elif self.interpolation:
            if not self.down:
                raise Malformed("a path is routed (G01) with the tool up: M15 is missing before it")
            self.path.append(self._segment(start, end, place))
        elif self.down:
            raise Malformed("a rapid move (G00) with the tool down: M16 is missing before it")

    def _segment(self, start: Point, end: Point, place: dict[str, str]) -> Segment:
        if self.interpolation == 1:
            return Segment(start, end)
        if "A" in place:
            chord = np.subtract(end, start)
            half, radius = float(np.hypot(*chord)) / 2.0, self._length(place["A"])
            if not 0.0 < half <= radius * (1.0 + 1e-3):
                raise Malformed(
                    f"an arc of radius {radius:g} mm between points {2 * half:g} mm apart"
                )
            # Of two centres the one that makes at most half a turn.
            side = -1.0 if self.interpolation == 2 else 1.0
            across = np.array([-chord[1], chord[0]]) / (2.0 * half) * side
            centre = np.add(start, end) / 2.0 + across * np.sqrt(max(radius**2 - half**2, 0.0))
        elif place.keys() & {"I", "J"}:
            centre = np.add(start, [self._length(place.get(code, "0")) for code in "IJ"])
        else:
            raise Malformed("an arc (G02, G03) without its radius (A) or centre (I, J)")
        return Segment(start, end, (float(centre[0]), float(centre[1])), self.interpolation == 2)

    def _general(self, code: str) -> None:
        match code.zfill(2):
            case "00" | "01" | "02" | "03":
                self.routing, self.interpolation = True, int(code)
            case "05" | "81":
                if self.down:
                    raise Malformed("drilling (G05) begins with the routing tool down")
                self.routing = False
            case "90" | "91":
                self.incremental = code == "91"
            case "40":
                pass
            case _:
                raise Malformed(f"'G{code}' is not a supported command")

    def _miscellaneous(self, code: str) -> None:
        match code.zfill(2):
            case "15":
                self.routing, self.down, self.path = True, True, []
            case "16" | "17":
                if self.down:
                    self._drill(self.path or [Segment(self.point, self.point)])
                self.down = False
            case "30" | "00":
                self.ended = True
            case "71" | "72":
                self._units(f"M{code}", "")
            case _:
                raise Malformed(f"'M{code}' is not a supported command")

    def _drill(self, path: list[Segment]) -> None:
        if self.tool is None:
            raise Malformed("a hole comes before its tool is selected")
        if len(self.holes) >= MAX_HOLES:
            raise Malformed(f"more than {MAX_HOLES} holes")
        size, plated = self.tool
        area = shapely.union_all([stroke_of_disk(segment, size / 2.0) for segment in path])
        self.holes += [DrilledOutline(part, plated) for part in shapely.get_parts(area)]

    # Numbers

    def _point(self, place: dict[str, str]) -> Point:
        found = []
        for axis, last in zip("XY", self.point, strict=True):
            value = self._length(place[axis]) if axis in place else 0.0
            found.append(value + last if self.incremental or axis not in place else value)
        return found[0], found[1]

    def _length(self, text: str) -> float:
        if self.unit is None:
            raise Malformed(f"it does not say its unit; {ASK}")
        if "." in text:
            return length(number(text), self.unit)
        sign, figures = (-1.0 if text[:1] == "-" else 1.0), text.lstrip("+-")
        if not figures.isdecimal():
            raise Malformed(f"'{text[:40]}' is not a coordinate")
        whole, decimals = self.digits or ((2, 4) if self.unit == INCH_MM else (3, 3))
        if len(figures) != whole + decimals and int(figures) and self.zeros is None:
            raise Malformed(
                f"it does not say which zeros '{text}' lacks of {whole}.{decimals} digits; {ASK}"
            )
        if self.zeros == "trailing":
            figures = figures.ljust(whole + decimals, "0")
        return length(sign * int(figures) / 10**decimals, self.unit)


def _sized(size_mm: float) -> float:
    if not 0.0 < size_mm <= LARGEST_TOOL_MM:
        raise Malformed(
            f"a tool is {size_mm:g} mm wide, where up to {LARGEST_TOOL_MM:g} mm is allowed"
        )
    return size_mm
