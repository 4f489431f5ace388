"""Fiducials: round bare copper by which a machine finds the board."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import shapely
from pydantic import PositiveFloat, model_validator

from scenes.board.pad_layout import Area, Layout, disk, within_box
from scenes.support.errors import SceneError
from scenes.support.frozen import Frozen


class Fiducials(Frozen):
    """Fiducials of the board, never printed on."""

    positions_mm: tuple[tuple[float, float], ...] = ()
    """Board coordinates. Absent: those that the copper layer of a Gerber board names (X2 attribute `FiducialPad`)."""
    diameter_mm: PositiveFloat = 1.0
    """Of the copper; that of a Gerber board is in its layer."""
    opening_mm: PositiveFloat = 2.0
    """Diameter of the mask opening; that of a Gerber board is in its layer."""

    @model_validator(mode="after")
    def _copper_bare(self) -> Self:
        if self.opening_mm < self.diameter_mm:
            raise ValueError(
                f"opening_mm {self.opening_mm} is smaller than diameter_mm {self.diameter_mm}: make it larger"
            )
        return self


def with_drawn(layout: Layout, settings: Fiducials) -> Layout:
    """The artwork with fiducials added to its copper and openings."""
    if not settings.positions_mm:
        raise SceneError("board.fiducials needs positions_mm = [[x, y], ...] on a parametric board")

    def added(area: Area, diameter_mm: float) -> Area:
        disks = [disk(*place, diameter_mm / 2.0) for place in settings.positions_mm]
        return area | shapely.union_all(disks).intersection(layout.board)

    layout = replace(
        layout,
        copper=added(layout.copper, settings.diameter_mm),
        openings=added(layout.openings, settings.opening_mm),
    )
    return with_found(
        layout, [disk(*place, settings.diameter_mm / 2.0) for place in settings.positions_mm]
    )


def at_positions(layout: Layout, settings: Fiducials) -> list[shapely.Polygon]:
    """The bare copper at each position that is in the region; `SceneError` where there is none."""
    bare = shapely.get_parts(layout.copper.intersection(layout.openings))
    found = []
    for place in settings.positions_mm:
        point = shapely.Point(place)
        there = bare[shapely.contains(bare, point)]
        if layout.board.contains(point) and not len(there):
            raise SceneError(
                f"board.fiducials: there is no bare copper at {list(place)} mm: give the middle of a fiducial"
            )
        found += list(there)
    return found


def with_found(layout: Layout, outlines: Sequence[shapely.Polygon]) -> Layout:
    """The artwork with those fiducials named that are whole."""
    return replace(
        layout, fiducials=tuple(outline for outline in outlines if within_box(outline, layout.box))
    )
