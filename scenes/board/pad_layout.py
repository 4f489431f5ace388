"""A board's artwork as polygons in board coordinates (mm, y up), from Gerber files or a list of parts."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import shapely
from numpy.typing import NDArray

Area: TypeAlias = shapely.Geometry
Bounds = tuple[float, float, float, float]

# Corners of a circle. The polygon of equal area deviates by 0.08 % of the radius: 0.2 um for a 0.5 mm pad.
CIRCLE = 64

DamageClass = Literal["scratch", "residue", "mask-shift"]


@dataclass(frozen=True, eq=False)
class Pad:
    """One opening of the stencil, and so one deposit."""

    id: int
    """1 and up, in the order of the artwork, board after board of a panel; the same in every region."""
    name: str
    centre_mm: tuple[float, float]
    """Where the artwork places it, board coordinates."""
    aperture: shapely.Polygon
    """The opening, relative to `centre_mm`."""
    part: tuple[str, ...] = ()
    """Name, its letters, size and package of its part, where known."""
    board: int = 1
    """Which of a panel's boards it is on."""
    number: int = 0
    """Its id if that board were alone; 0: the id itself."""

    @property
    def outline(self) -> shapely.Polygon:
        """The opening in board coordinates."""
        return moved(self.aperture, self.centre_mm)


@dataclass(frozen=True, eq=False)
class ThroughHole:
    """A hole or slot through the board."""

    outline: shapely.Polygon
    plated: bool
    tented: bool
    """Closed by solder mask."""


@dataclass(frozen=True, eq=False)
class Damage:
    """A fault of the bare board."""

    name: DamageClass
    pad: int
    """Near which it was drawn, or whose copper the mask covers; 0 for none."""
    outline: Area
    """As far as it shows: a scratch in the mask, residue on the board, copper under mask that should be bare."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Everything printed or etched that the board's surface needs, cut to a box."""

    pads: tuple[Pad, ...]
    """Those whose aperture is wholly inside the box."""
    copper: Area
    openings: Area
    """Where there is no solder mask."""
    board: Area
    """The laminate."""
    box: Bounds
    """x and y from, x and y to."""
    cut: tuple[Pad, ...] = ()
    """Those that the box's edge cuts: not printed."""
    legend: Area = field(default_factory=shapely.Polygon)
    """What the legend's print covers, mask openings not yet left out."""
    holes: tuple[ThroughHole, ...] = ()
    """Open ones are left out of copper and legend."""
    fiducials: tuple[shapely.Polygon, ...] = ()
    """Copper of those wholly inside the box."""
    damage: tuple[Damage, ...] = ()

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Board coordinates of the world's origin."""
        return (self.box[0] + self.box[2]) / 2, (self.box[1] + self.box[3]) / 2

    @property
    def cut_copper(self) -> tuple[tuple[Pad, shapely.Geometry], ...]:
        """Each cut pad with the bare copper it belongs to, board coordinates: it looks like a missing deposit."""
        bare = shapely.get_parts(self.copper.intersection(self.openings))
        printed = shapely.union_all([pad.outline for pad in self.pads])
        found = []
        taken = np.zeros(len(bare), np.bool_)
        for pad in self.cut:
            own = ~taken & shapely.intersects(bare, pad.outline)
            taken |= own
            area = shapely.union_all(bare[own]).difference(printed)
            if not area.is_empty:
                found.append((pad, area))
        return tuple(found)


def cut_layout(
    pads: Sequence[Pad], copper: Area, openings: Area, board: Area, legend: Area, box: Bounds
) -> Layout:
    """The artwork of a whole board, cut to a box."""
    frame = shapely.box(*box)
    inside = board.intersection(frame)
    over = [pad for pad in pads if not within_box(pad.outline, box)]
    return Layout(
        tuple(pad for pad in pads if within_box(pad.outline, box)),
        copper.intersection(inside),
        openings.intersection(inside),
        inside,
        box,
        tuple(pad for pad in over if pad.outline.intersection(frame).area > 0.0),
        legend.intersection(inside),
    )


def circle(radius_mm: float, corners: int = CIRCLE) -> NDArray[np.float64]:
    """Corners of the regular polygon that has a circle's area: (corner, 2), mm, about the origin."""
    step = 2.0 * np.pi / corners
    angle = step * (np.arange(corners) + 0.5)
    reach = radius_mm * np.sqrt(step / np.sin(step))
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


def disk(x: float, y: float, radius_mm: float) -> shapely.Polygon:
    """A round opening."""
    return shapely.Polygon(circle(radius_mm) + np.array([x, y]))


def rectangle(
    x: float, y: float, width: float, height: float, rotation_rad: float = 0.0
) -> shapely.Polygon:
    """A rectangle about its centre, turned counter-clockwise."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * [width / 2, height / 2]
    cos, sin = np.cos(rotation_rad), np.sin(rotation_rad)
    return shapely.Polygon(corners @ np.array([[cos, sin], [-sin, cos]]) + [x, y])


def moved(shape: shapely.Polygon, by: tuple[float, float]) -> shapely.Polygon:
    """The shape, shifted."""
    shifted: shapely.Polygon = shapely.transform(shape, lambda xy: xy + np.asarray(by))
    return shifted


def rounded(shape: shapely.Polygon) -> shapely.Polygon:
    """Coordinates to a nanometre, so that equal apertures compare equal at any place."""
    tidy: shapely.Polygon = shapely.transform(shape, lambda xy: np.round(xy, 6))
    return tidy


def area_ratio(aperture: shapely.Polygon, stencil_mm: float) -> float:
    """IPC-7525's area ratio: area of the opening over area of its walls; ``L W / (2 (L + W) T)`` for a rectangle.

    >>> round(area_ratio(shapely.box(0.0, 0.0, 0.6, 0.4), 0.12), 3)
    1.0
    """
    return float(aperture.area / (aperture.length * stencil_mm))


def within_box(area: Area, box: Bounds) -> bool:
    """Whether a shape is wholly inside a box."""
    x0, y0, x1, y1 = area.bounds
    return bool(box[0] <= x0 and box[1] <= y0 and x1 <= box[2] and y1 <= box[3])
