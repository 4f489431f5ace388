"""Panels: copies of a board, routed apart but for tabs, between rails with tooling holes and fiducials."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Annotated, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.board import pad_layout
from scenes.board.pad_layout import Area, Bounds, Layout, Pad, ThroughHole, moved
from scenes.support.errors import SceneError
from scenes.support.frozen import Frozen

Count = Annotated[int, Field(ge=1, le=50)]

# Less is not a gap but the last digit of a sum.
SMALLEST_MM2 = 1e-6


class BoardPanel(Frozen):
    """Copies of a board: the first is where the board alone would be, the others to its right, then above."""

    rows: Count = 1
    columns: Count = 1
    pitch_mm: tuple[PositiveFloat, PositiveFloat] | None = None
    """From a board to the next one, along x and y. Absent: the board's size and `gap_mm`."""
    gap_mm: NonNegativeFloat = 2.0
    """Between boards, and between them and the rails; 0: scored, not routed."""
    tab_mm: NonNegativeFloat = 2.0
    """Width of the bars of laminate that hold each board, in the middle of its sides; 0: none."""
    rail_mm: NonNegativeFloat = 0.0
    """Width of the two rails along x, below and above the boards; 0: none."""
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

    def places(self, board: Bounds) -> list[tuple[float, float]]:
        """Shift of each copy, row by row, for a board's bounds; `SceneError` where copies overlap."""
        size = board[2] - board[0], board[3] - board[1]
        x, y = self.pitch_mm or (size[0] + self.gap_mm, size[1] + self.gap_mm)
        if x < size[0] - 1e-6 or y < size[1] - 1e-6:
            raise SceneError(
                f"board.panel.pitch_mm {[x, y]}: boards of {size[0]:.3f} x {size[1]:.3f} mm overlap; make it larger"
            )
        return [(i * x, j * y) for j in range(self.rows) for i in range(self.columns)]

    def outline(self, board: Bounds) -> shapely.Polygon:
        """The panel's own, rails included."""
        far_x, far_y = self.places(board)[-1]
        rail = self.rail_mm and self.rail_mm + self.gap_mm
        return shapely.box(board[0], board[1] - rail, board[2] + far_x, board[3] + far_y + rail)

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
            low = np.maximum(np.subtract(box[:2], place), board[:2])
            high = np.minimum(np.subtract(box[2:], place), board[2:])
            if np.all(low < high):
                one = part((*low.tolist(), *high.tolist()))
                pads += on_copy(one.pads, copy, count, place)
                cut += on_copy(one.cut, copy, count, place)
                for layer, area in zip(layers, (one.copper, one.openings, one.legend), strict=True):
                    layer.append(moved(area, place))
                holes += [replace(hole, outline=moved(hole.outline, place)) for hole in one.holes]
                fiducials += [moved(mark, place) for mark in one.fiducials]
        copper, openings, legend = (shapely.union_all(layer) & laminate for layer in layers)
        whole = tuple(mark for mark in fiducials if pad_layout.within_box(mark, box))
        return Layout(
            *(tuple(pads), copper, openings, laminate, box, tuple(cut), legend, tuple(holes), whole)
        )

    def _gaps(self, outline: Area, panel: shapely.Polygon) -> list[Area]:
        """What is routed away: the panel without boards, rails and tabs."""
        (x0, y0, x1, y1), half = panel.bounds, self.tab_mm / 2
        places, frame = self.places(outline.bounds), shapely.box(*outline.bounds)
        bars = []
        for x, y in (moved(frame, place).centroid.coords[0] for place in places):
            bars += [
                shapely.box(x0, y - half, x1, y + half),
                shapely.box(x - half, y0, x + half, y1),
            ]
        # A board's own cut-outs stay open.
        tabs = shapely.union_all(bars) - shapely.union_all([moved(frame, p) for p in places])
        solid = [*(moved(outline, place) for place in places), tabs]
        solid += [
            shapely.box(x0, y0, x1, y0 + self.rail_mm),
            shapely.box(x0, y1 - self.rail_mm, x1, y1),
        ]
        gaps = shapely.get_parts(panel - shapely.union_all(solid))
        return [gap for gap in gaps if gap.area > SMALLEST_MM2]

    def _on_rails(self, panel: shapely.Polygon, diameter_mm: float, away: float) -> list[Area]:
        """Disks in the middle of the rails, `away` rail widths from their ends; none without rails or of diameter 0."""
        (x0, y0, x1, y1), rail = panel.bounds, self.rail_mm
        ends, middles = (x0 + away * rail, x1 - away * rail), (y0 + rail / 2, y1 - rail / 2)
        places = [(x, y) for y in middles for x in ends] if rail * diameter_mm else []
        return [pad_layout.disk(*place, diameter_mm / 2) for place in places]


def on_copy(pads: Sequence[Pad], copy: int, count: int, place: tuple[float, float]) -> list[Pad]:
    """The board's pads on one of its copies, with ids that no other has: `count` is the number of all the board's."""
    return [
        replace(
            pad,
            id=pad.id + copy * count,
            centre_mm=(pad.centre_mm[0] + place[0], pad.centre_mm[1] + place[1]),
            board=copy + 1,
            number=pad.id,
        )
        for pad in pads
    ]
