"""Aperture macros: their expressions, and their primitives as polygons."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from scenes.board.gerber.strokes import valid
from scenes.board.gerber.tokens import Malformed, length, number
from scenes.board.pad_layout import Area, disk, rectangle

_TOKEN = re.compile(r"\$\d+|\d+\.?\d*|\.\d+|[-+xX/()]")
# Corners of an outline farther apart than this are not one point.
CLOSED_MM = 1e-3
# Circles and polygons of a moire pattern, at most.
MAX_RINGS = 1000


@dataclass(frozen=True)
class Macro:
    """A named aperture with parameters."""

    name: str
    statements: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> "Macro":
        """Of an AM command without its code."""
        name, *body = text.split("*")
        statements = (re.sub(r"\s+", "", statement) for statement in body)
        # A comment is primitive 0.
        kept = (s for s in statements if s and not re.match(r"0(?![\d.,])|0,|0$", s))
        return cls(name.strip(), tuple(kept))

    def shape(self, parameters: Sequence[float], mm: float) -> Area:
        """The aperture for given parameters, about its origin, in mm; `mm` is the file's unit.

        Exposure off erases what earlier primitives of the same macro painted.
        """
        variables = dict(enumerate(parameters, start=1))
        area: Area = shapely.Polygon()
        for statement in self.statements:
            if statement.startswith("$"):
                left, _, right = statement.partition("=")
                if not left[1:].isdecimal():
                    raise Malformed(f"macro {self.name}: '{statement[:40]}' assigns no variable")
                variables[int(left[1:])] = _value(right, variables)
                continue
            code, *modifiers = statement.split(",")
            values = [_value(modifier, variables) for modifier in modifiers]
            try:
                piece, dark = _primitive(int(_value(code, variables)), values, mm)
            except (IndexError, OverflowError) as error:
                raise Malformed(f"macro {self.name}: '{statement[:40]}' lacks a value") from error
            area = area.union(piece) if dark else area.difference(piece)
        return area


def _primitive(code: int, v: list[float], mm: float) -> tuple[Area, bool]:
    """(shape in mm, painted rather than erased)."""
    known = {1: _circle, 2: _vector_line, 20: _vector_line, 21: _centre_line, 22: _corner_line}
    known |= {4: _outline, 5: _polygon}
    if code in known:
        shape, turn = known[code](v[1:], mm)
        return _turned(shape, turn), v[0] != 0.0
    if code == 6:
        return _turned(_moire(v, mm), _last(v, 8)), True
    if code == 7:
        return _turned(_thermal(v, mm), _last(v, 5)), True
    raise Malformed(f"macro primitive {code} is not known")


def _circle(v: list[float], mm: float) -> tuple[Area, float]:
    x, y = length(v[1], mm), length(v[2], mm)
    return disk(x, y, length(abs(v[0]), mm) / 2), _last(v, 3)


def _vector_line(v: list[float], mm: float) -> tuple[Area, float]:
    width, *ends = (length(value, mm) for value in v[:5])
    start, end = np.array(ends[:2]), np.array([ends[2], ends[3]])
    along = end - start
    reach = float(np.hypot(*along))
    if reach == 0.0:
        return shapely.Polygon(), 0.0
    x, y = (start + end) / 2
    angle = float(np.arctan2(along[1], along[0]))
    return rectangle(float(x), float(y), reach, width, angle), _last(v, 5)


def _centre_line(v: list[float], mm: float) -> tuple[Area, float]:
    width, height, x, y = (length(value, mm) for value in v[:4])
    return rectangle(x, y, width, height), _last(v, 4)


def _corner_line(v: list[float], mm: float) -> tuple[Area, float]:
    """Given by its lower left corner; deprecated."""
    width, height, x, y = (length(value, mm) for value in v[:4])
    return rectangle(x + width / 2, y + height / 2, width, height), _last(v, 4)


def _outline(v: list[float], mm: float) -> tuple[Area, float]:
    count = int(v[0]) + 1
    if count < 4 or len(v) < 1 + 2 * count:
        raise Malformed(f"a macro's outline of {int(v[0])} corners has {(len(v) - 1) // 2} points")
    points = np.array([length(value, mm) for value in v[1 : 1 + 2 * count]]).reshape(-1, 2)
    gap = float(np.hypot(*(points[-1] - points[0])))
    if gap > CLOSED_MM:
        raise Malformed(
            f"a macro's outline is open: its last point is {gap:.4g} mm from its first, {CLOSED_MM:g} mm is allowed"
        )
    return valid(shapely.Polygon(points[:-1])), _last(v, 1 + 2 * count)


def _polygon(v: list[float], mm: float) -> tuple[Area, float]:
    x, y, diameter = (length(value, mm) for value in v[1:4])
    return shapely.transform(regular(int(v[0]), diameter), lambda xy: xy + np.array([x, y])), _last(
        v, 4
    )


def regular(corners: int, diameter_mm: float) -> shapely.Polygon:
    """A regular polygon about the origin, its first corner on the x axis."""
    if not 3 <= corners <= 1000:
        raise Malformed(f"a regular polygon of {corners} corners: 3 to 12 are allowed")
    angle = 2.0 * np.pi * np.arange(corners) / corners
    return shapely.Polygon(diameter_mm / 2 * np.column_stack([np.cos(angle), np.sin(angle)]))


def _moire(v: list[float], mm: float) -> Area:
    """Concentric rings and a cross hair; deprecated."""
    x, y, outer, thickness, gap = (length(value, mm) for value in v[:5])
    cross, reach = length(v[6], mm), length(v[7], mm)
    if not 0 <= v[5] <= MAX_RINGS:
        raise Malformed(f"a moire pattern of {v[5]:g} rings")
    pieces: list[Area] = [rectangle(x, y, reach, cross), rectangle(x, y, cross, reach)]
    for _ in range(int(v[5])):
        if outer <= 0.0:
            break
        pieces.append(_ring(x, y, outer, max(outer - 2 * thickness, 0.0)))
        outer -= 2 * (thickness + gap)
    return shapely.union_all(pieces)


def _thermal(v: list[float], mm: float) -> Area:
    """A ring with four gaps."""
    x, y, outer, inner, gap = (length(value, mm) for value in v[:5])
    if not 0.0 <= inner < outer or not 0.0 <= gap < outer / np.sqrt(2.0):
        raise Malformed(
            f"a thermal of diameters {outer:g} and {inner:g} mm with a gap of {gap:g} mm"
        )
    cross = rectangle(x, y, 2 * outer, gap).union(rectangle(x, y, gap, 2 * outer))
    return _ring(x, y, outer, inner).difference(cross)


def _ring(x: float, y: float, outer: float, inner: float) -> Area:
    whole = disk(x, y, outer / 2)
    return whole if inner <= 0.0 else whole.difference(disk(x, y, inner / 2))


def _turned(shape: Area, degrees: float) -> Area:
    """Turned about the macro's origin, which the primitive need not be centred on."""
    if degrees % 360.0 == 0.0:
        return shape
    angle = np.deg2rad(degrees)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return shapely.transform(shape, lambda xy: xy @ turn)


def _last(v: list[float], at: int) -> float:
    """A rotation, which old files leave out."""
    return v[at] if len(v) > at else 0.0


def _value(text: str, variables: dict[int, float]) -> float:
    """Value of an expression of numbers, ``$n``, ``+ - x /`` and parentheses; variables never set are 0."""
    tokens = _TOKEN.findall(text)
    if not tokens or "".join(tokens) != text:
        raise Malformed(f"'{text[:40]}' is not an expression")
    tokens.reverse()
    value = _sum(tokens, variables, 0)
    if tokens or not np.isfinite(value):
        raise Malformed(f"'{text[:40]}' has no value")
    return value


def _sum(tokens: list[str], variables: dict[int, float], depth: int) -> float:
    value = _product(tokens, variables, depth)
    while tokens and tokens[-1] in "+-":
        sign = 1.0 if tokens.pop() == "+" else -1.0
        value += sign * _product(tokens, variables, depth)
    return value


def _product(tokens: list[str], variables: dict[int, float], depth: int) -> float:
    value = _factor(tokens, variables, depth)
    while tokens and tokens[-1] in "xX/":
        operator, right = tokens.pop(), _factor(tokens, variables, depth)
        if operator == "/" and right == 0.0:
            raise Malformed("a macro divides by 0")
        value = value / right if operator == "/" else value * right
    return value


def _factor(tokens: list[str], variables: dict[int, float], depth: int) -> float:
    if not tokens or depth > 50:
        raise Malformed("a macro's expression ends early or is nested too deeply")
    token = tokens.pop()
    if token in "+-":
        return (1.0 if token == "+" else -1.0) * _factor(tokens, variables, depth + 1)
    if token == "(":
        value = _sum(tokens, variables, depth + 1)
        if not tokens or tokens.pop() != ")":
            raise Malformed("a macro's expression lacks a closing parenthesis")
        return value
    if token.startswith("$"):
        return variables.get(int(token[1:]), 0.0)
    return number(token)
