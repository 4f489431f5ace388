"""Coordinates of Gerber words: their unit and format, and the lines and arcs between them."""

import re
from dataclasses import replace
from itertools import product

import numpy as np

from scenes.board.gerber.strokes import Point, Segment
from scenes.board.gerber.tokens import Malformed, length, number

_FORMAT = re.compile(r"FS([LTD]?)([AI]?)(?:[NG]\d+)?X(\d)(\d)Y(\d)(\d)(?:[DM]\d+)?$")


class CoordinateReader:
    """How numbers of words are read."""

    def __init__(self) -> None:
        self.unit: float | None = None
        self.digits: tuple[str, int, int] | None = None
        self.incremental = False
        self.interpolation = 1
        self.quadrants: int | None = None

    def take_format(self, text: str) -> None:
        """The format of a command FS."""
        match = _FORMAT.match(text)
        if not match or match[3] != match[5] or match[4] != match[6]:
            raise Malformed(f"'{text[:40]}' is not a coordinate format")
        self.digits = (match[1] or "L", int(match[3]), int(match[4]))
        self.incremental = match[2] == "I"

    def point(self, words: dict[str, str], last: Point) -> Point:
        """The point that X and Y give, mm; `last` where one is left out."""
        found = []
        for code, old in zip("XY", last, strict=True):
            value = old
            if code in words:
                value = self._coordinate(words[code])
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

    def segment(self, start: Point, end: Point, words: dict[str, str]) -> Segment:
        """The line or arc between two points."""
        if self.interpolation == 1 or not words.keys() & {"I", "J"}:
            return Segment(start, end)
        i, j = (self._coordinate(words.get(code, "0")) for code in "IJ")
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


def _is_round(segment: Segment) -> bool:
    try:
        segment.arc()
    except Malformed:
        return False
    return True
