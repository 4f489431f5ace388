"""Panels: copies of a board, perhaps turned, routed apart but for tabs, between rails with tooling holes and fiducials."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from typing import Annotated, Literal, Self

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.board import pad_layout
from scenes.board.pad_layout import Area, Bounds, Layout, Pad, ThroughHole
from scenes.support.errors import SceneError
from scenes.support.frozen import Frozen

Count = Annotated[int, Field(ge=1, le=50)]

# Less is not a gap but the last digit of a sum.
SMALLEST_MM2 = 1e-6


@dataclass(frozen=True)
class Place:
    """Where a copy is on the panel: turned by a quarter turn's multiple about the board's middle, then shifted."""

    turn_deg: int
    middle_mm: tuple[float, float]
    shift_mm: tuple[float, float]

    def turned(self, xy: NDArray[np.float64]) -> NDArray[np.float64]:
        """Directions (..., 2), counter-clockwise; exact."""
        cos, sin = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[self.turn_deg]
        return xy @ np.array([[cos, sin], [-sin, cos]], np.float64)

    def __call__(self, area: Area) -> Area:
        """Something of the board, on the panel."""
        middle = np.asarray(self.middle_mm)
        # Without a turn this is the shift to the last bit.
        offset = middle - self.turned(middle) + self.shift_mm
        return shapely.transform(area, lambda xy: self.turned(xy) + offset)

    def window(self, box: Bounds) -> Bounds:
        """The board's own box that is this one of the panel."""
        back = Place(-self.turn_deg % 360, self.middle_mm, (0.0, 0.0))
        x, y = self.shift_mm
        shifted = shapely.box(box[0] - x, box[1] - y, box[2] - x, box[3] - y)
        bounds: Bounds = back(shifted).bounds
        return bounds


class BoardPanel(Frozen):
    """Copies of a board: the first is where the board alone would be, the others to its right, then above."""

    rows: Count = 1
    columns: Count = 1
    turns_deg: Annotated[tuple[Literal[0, 90, 180, 270], ...], Field(min_length=1)] = (0,)
    """Turn of each copy about its own middle, counter-clockwise, in the copies' order and repeated: (0, 180) turns every other one."""
    pitch_mm: tuple[PositiveFloat, PositiveFloat] | None = None
    """From a board to the next one, along x and y. Absent: the board's size, turned ones included, and `gap_mm`."""
    gap_mm: NonNegativeFloat = 2.0
    """Between boards, and between them and the rails; 0: scored, not routed."""
    tab_mm: NonNegativeFloat = 2.0
    """Width of the bars of laminate that hold each board, in the middle of its sides; 0: none."""
    rail_mm: NonNegativeFloat = 0.0
    """Width of the rails; 0: none."""
    rails: Literal["x", "y", "xy"] = "x"
    """Two along x, below and above the boards, two along y beside them, or a frame of all four."""
    tooling_mm: NonNegativeFloat = 3.0
    """Diameter of the holes at the rails' ends, half of `rail_mm` from three sides; 0: none."""
    fiducial_mm: NonNegativeFloat = 0.0
    """Diameter of three fiducials on the rails, in mask openings twice as large, 1.5 `rail_mm` from the ends; 0: none."""

    @model_validator(mode="after")
    def _fit_rails(self) -> Self:
        if self.rail_mm < max(self.tooling_mm if self.rail_mm else 0.0, 2.0 * self.fiducial_mm):
            raise ValueError(
                f"rail_mm {self.rail_mm} is too narrow for tooling_mm {self.tooling_mm} and for fiducial_mm "
                f"{self.fiducial_mm} in an opening of twice that: make it larger"
            )
        return self

    def places(self, board: Bounds) -> list[Place]:
        """Of each copy, row by row, for a board's bounds; `SceneError` where copies overlap."""
        middle = (board[0] + board[2]) / 2, (board[1] + board[3]) / 2
        wide, high = board[2] - board[0], board[3] - board[1]
        sizes = [(wide, high) if turn % 180 == 0 else (high, wide) for turn in self.turns_deg]
        size = max(w for w, _ in sizes), max(h for _, h in sizes)
        x, y = self.pitch_mm or (size[0] + self.gap_mm, size[1] + self.gap_mm)
        if x < size[0] - 1e-6 or y < size[1] - 1e-6:
            raise SceneError(
                f"board.panel.pitch_mm {[x, y]}: boards of {size[0]:.3f} x {size[1]:.3f} mm overlap; make it larger"
            )
        steps = [(i * x, j * y) for j in range(self.rows) for i in range(self.columns)]
        return [Place(turn, middle, s) for turn, s in zip(cycle(self.turns_deg), steps)]

    def outline(self, board: Bounds) -> shapely.Polygon:
        """The panel's own, rails included."""
        frames = [place(shapely.box(*board)) for place in self.places(board)]
        low, high = shapely.total_bounds(frames).reshape(2, 2)
        rail = (self.rail_mm and self.rail_mm + self.gap_mm) * np.array(
            [d in self.rails for d in "yx"]
        )
        return shapely.box(*(low - rail), *(high + rail))

    def layout(
        self, part: Callable[[Bounds], Layout], outline: Area, count: int, box: Bounds
    ) -> Layout:
        """The artwork in a box: from what makes the board's own in a box, the board's outline and its number of pads."""
        board, panel = outline.bounds, self.outline(outline.bounds)
        laminate = panel.intersection(shapely.box(*box))
        through = self._gaps(outline, panel) + self._on_rails(panel, self.tooling_mm, 0.5)
        holes = [ThroughHole(o, False, False) for o in through if o.intersects(laminate)]
        fiducials = self._on_rails(panel, self.fiducial_mm, 1.5)[:3]
        cleared = self._on_rails(panel, 2.0 * self.fiducial_mm, 1.5)[:3]
        layers: list[list[Area]] = [[*fiducials], [*cleared], []]
        pads, cut = list[Pad](), list[Pad]()
        for copy, place in enumerate(self.places(board)):
            window = place.window(box)
            low, high = np.maximum(window[:2], board[:2]), np.minimum(window[2:], board[2:])
            if np.all(low < high):
                one = part((*low.tolist(), *high.tolist()))
                pads += on_copy(one.pads, copy, count, place)
                cut += on_copy(one.cut, copy, count, place)
                for layer, area in zip(layers, (one.copper, one.openings, one.legend), strict=True):
                    layer.append(place(area))
                holes += [replace(hole, outline=place(hole.outline)) for hole in one.holes]
                fiducials += [place(mark) for mark in one.fiducials]
        copper, openings, legend = (shapely.union_all(layer) & laminate for layer in layers)
        whole = tuple(mark for mark in fiducials if pad_layout.within_box(mark, box))
        return Layout(
            *(tuple(pads), copper, openings, laminate, box, tuple(cut), legend, tuple(holes), whole)
        )

    def _gaps(self, outline: Area, panel: shapely.Polygon) -> list[Area]:
        """What is routed away: the panel without boards, rails and tabs."""
        (x0, y0, x1, y1), half, rail = panel.bounds, self.tab_mm / 2, self.rail_mm
        places = self.places(outline.bounds)
        frames = [place(shapely.box(*outline.bounds)) for place in places]
        bars = []
        for x, y in (frame.centroid.coords[0] for frame in frames):
            bars += [
                shapely.box(x0, y - half, x1, y + half),
                shapely.box(x - half, y0, x + half, y1),
            ]
        # A board's own cut-outs stay open.
        solid = [
            *(place(outline) for place in places),
            shapely.union_all(bars) - shapely.union_all(frames),
        ]
        if "x" in self.rails:
            solid += [shapely.box(x0, y0, x1, y0 + rail), shapely.box(x0, y1 - rail, x1, y1)]
        if "y" in self.rails:
            solid += [shapely.box(x0, y0, x0 + rail, y1), shapely.box(x1 - rail, y0, x1, y1)]
        gaps = shapely.get_parts(panel - shapely.union_all(solid))
        return [gap for gap in gaps if gap.area > SMALLEST_MM2]

    def _on_rails(self, panel: shapely.Polygon, diameter_mm: float, away: float) -> list[Area]:
        """Disks in the middle of the rails, `away` rail widths from their ends; none without rails or of diameter 0."""
        (x0, y0, x1, y1), along = panel.bounds, away * self.rail_mm
        dx, dy = (0.5 * self.rail_mm, along) if self.rails == "y" else (along, 0.5 * self.rail_mm)
        places = [(x, y) for y in (y0 + dy, y1 - dy) for x in (x0 + dx, x1 - dx)]
        return [pad_layout.disk(*p, diameter_mm / 2) for p in places if self.rail_mm * diameter_mm]


def on_copy(pads: Sequence[Pad], copy: int, count: int, place: Place) -> list[Pad]:
    """The board's pads on one of its copies, with ids that no other has: `count` is the number of all the board's."""
    return [
        replace(
            pad,
            id=pad.id + copy * count,
            centre_mm=place(shapely.Point(pad.centre_mm)).coords[0],
            aperture=shapely.transform(pad.aperture, place.turned),
            board=copy + 1,
            number=pad.id,
        )
        for pad in pads
    ]
