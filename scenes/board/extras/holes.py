"""Vias, drill holes and slots: settings, and the artwork they are punched into."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.board.gerber.excellon import DrilledOutline, DrillFormat
from scenes.board.gerber.strokes import Segment, stroke_of_disk
from scenes.board.pad_layout import Area, Layout, ThroughHole, disk
from scenes.support.distribution import Quantity, within
from scenes.support.frozen import Frozen

# A hole whose plating is not stated is plated where copper follows this share of its rim, this far outside.
RINGED, RING_MM = 0.9, 0.02


class DrilledHole(Frozen):
    """A hole, or a slot, that is not in a file."""

    position_mm: tuple[float, float]
    end_mm: tuple[float, float] | None = None
    """Other end of a slot's centre line."""
    diameter_mm: PositiveFloat = 0.3
    ring_mm: NonNegativeFloat = 0.0
    """Diameter of the copper around it; 0: neither copper nor plating."""
    tented: bool = False
    """Closed by solder mask."""

    @model_validator(mode="after")
    def _ring_around(self) -> Self:
        if 0.0 < self.ring_mm <= self.diameter_mm:
            raise ValueError(
                f"ring_mm {self.ring_mm} is not larger than diameter_mm {self.diameter_mm}: make it larger, or 0"
            )
        return self

    def outline(self, diameter_mm: float) -> shapely.Polygon:
        """The hole at another diameter."""
        end = self.end_mm or self.position_mm
        if end == self.position_mm:
            return disk(*self.position_mm, diameter_mm / 2.0)
        return stroke_of_disk(Segment(self.position_mm, end), diameter_mm / 2.0)


class Holes(Frozen):
    """Holes of the board's drill files, and those listed here."""

    drilled: tuple[DrilledHole, ...] = ()
    """In addition to those of a Gerber board's drill files."""
    depth_mm: Annotated[float, Field(gt=0.0, le=10.0)] = 1.6
    """Of the dark support below, which closes them."""
    material: str = "black-ink"
    """Of the support."""
    tented_mm: NonNegativeFloat = 0.5
    """Plated holes of drill files up to this diameter are tented where the mask layer has no opening."""
    dip_mm: Annotated[Quantity, within(0.0, 0.2)] = 0.01
    """How much lower the mask is over a tented hole; assumed, not measured. Drawn once per board."""
    number_format: DrillFormat = DrillFormat()
    """What drill files leave unsaid."""


def with_holes(
    layout: Layout,
    filed: Sequence[DrilledOutline],
    settings: Holes,
    clearance_mm: float,
    outline: Area,
) -> Layout:
    """The artwork with the holes of drill files and settings; `outline` is the whole board's."""
    listed = [h for h in settings.drilled if h.outline(h.diameter_mm).intersects(layout.board)]
    cleared = [
        h.outline(max(h.ring_mm, h.diameter_mm)).buffer(clearance_mm)
        for h in listed
        if not h.tented
    ]
    rings = [h.outline(h.ring_mm) for h in listed if h.ring_mm]
    copper = shapely.union_all([layout.copper, *rings]).intersection(layout.board)
    openings = shapely.union_all([layout.openings, *cleared]).intersection(layout.board)
    found = [ThroughHole(h.outline(h.diameter_mm), h.ring_mm > 0.0, h.tented) for h in listed]
    for area in (layout.board, copper, openings):
        shapely.prepare(area)
    for hole in filed:
        if not layout.board.intersects(hole.outline):
            continue
        # What a path goes around falls out; a path around the board leaves the board.
        whole = shapely.Polygon(hole.outline.exterior)
        shape = whole if whole.intersection(outline).area < outline.area / 2 else hole.outline
        plated = _ringed(shape, copper) if hole.plated is None else hole.plated
        small = shape.area <= np.pi / 4.0 * settings.tented_mm**2 * 1.001
        found.append(
            ThroughHole(shape, plated, plated and small and not openings.intersects(shape))
        )
    drilled = shapely.union_all([hole.outline for hole in found if not hole.tented])
    return replace(
        layout,
        copper=copper.difference(drilled),
        openings=openings,
        legend=layout.legend.difference(drilled),
        holes=tuple(found),
    )


def _ringed(hole: shapely.Polygon, copper: Area) -> bool:
    rim = hole.buffer(RING_MM).exterior
    return bool(rim.intersection(copper).length >= RINGED * rim.length)
