"""A board made of standard parts, without Gerber files: chip resistors, QFP, QFN and BGA land patterns.

Land patterns are IPC-7351B's nominal density, as KiCad 6's footprint generator gives them, with rectangular pads.
Stencil openings are the pads, less `aperture_inset_mm` on every side; a QFN's thermal pad gets window panes.
"""

from dataclasses import dataclass
from string import digits
from typing import Annotated, Literal, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.board.pad_layout import (
    Area,
    Bounds,
    Layout,
    Pad,
    cut_layout,
    disk,
    moved,
    rectangle,
    rounded,
)
from scenes.support.frozen import Frozen

Place = tuple[float, float]

# Width of the legend's lines, and their distance from a part's pads, as KiCad's library draws them.
LEGEND_LINE_MM = 0.12
LEGEND_CLEAR_MM = 0.26

# Pad length along the part, width across, and distance between the pads' centres, mm.
CHIPS: dict[str, tuple[float, float, float]] = {
    "0201": (0.46, 0.40, 0.64),
    "0402": (0.54, 0.64, 1.02),
    "0603": (0.80, 0.95, 1.65),
    "0805": (1.025, 1.40, 1.825),
    "1206": (1.125, 1.75, 2.925),
}


@dataclass(frozen=True, eq=False)
class Land:
    """One copper pad and the openings printed on it, in the part's frame."""

    name: str
    pad: shapely.Polygon
    openings: tuple[shapely.Polygon, ...]


class PartBase(Frozen):
    """Position and turn of a part."""

    name: str = "U"
    position_mm: Place
    """Of its centre, board coordinates."""
    rotation_deg: float = 0.0
    """Counter-clockwise."""

    @property
    def names(self) -> tuple[str, ...]:
        """Name, its letters, size and package: under any of them `paste.packages` may have it."""
        kinds = (getattr(self, key, None) for key in ("size", "package"))
        return (self.name, self.name.rstrip(digits), *(kind for kind in kinds if kind))


class Chip(PartBase):
    """A two-terminal chip, its pads along x."""

    package: Literal["chip"] = "chip"
    size: Literal["0201", "0402", "0603", "0805", "1206"]
    """Inch code."""

    def lands(self, inset_mm: float) -> list[Land]:
        """Pads and openings, in the part's frame."""
        length, width, apart = CHIPS[self.size]
        return [
            _land(str(i), rectangle(x * apart / 2, 0.0, length, width), inset_mm)
            for i, x in ((1, -1), (2, 1))
        ]


class Leaded(PartBase):
    """A part with pads in a row on each of its four sides."""

    pins: Annotated[int, Field(ge=4, le=400, multiple_of=4)]
    pitch_mm: PositiveFloat
    row_mm: PositiveFloat
    """Distance between the pad centres of opposite sides."""
    pad_mm: tuple[PositiveFloat, PositiveFloat]
    """Length outwards, width along the side."""

    @model_validator(mode="after")
    def _clear(self) -> Self:
        side = (self.pins // 4 - 1) * self.pitch_mm + self.pad_mm[1]
        if self.pad_mm[1] >= self.pitch_mm or side > self.row_mm - self.pad_mm[0]:
            raise ValueError(
                f"pads touch: {self.pins} pads of {list(self.pad_mm)} mm at {self.pitch_mm} mm do not fit rows "
                f"{self.row_mm} mm apart; widen row_mm or make the pads smaller"
            )
        return self

    def lands(self, inset_mm: float) -> list[Land]:
        """The pads of the four sides with their openings, counter-clockwise from the left side's top."""
        count, (length, width) = self.pins // 4, self.pad_mm
        lands = []
        for side in range(4):
            turn = np.pi + side * np.pi / 2
            for i in range(count):
                along = (i - (count - 1) / 2) * self.pitch_mm
                x = self.row_mm / 2 * np.cos(turn) - along * np.sin(turn)
                y = self.row_mm / 2 * np.sin(turn) + along * np.cos(turn)
                pad = rectangle(x, y, length, width, turn)
                lands.append(_land(str(side * count + i + 1), pad, inset_mm))
        return lands


class Qfp(Leaded):
    """A quad flat pack of fine pitch; the defaults are a 48-pin one of 7 mm body."""

    package: Literal["qfp"] = "qfp"
    pins: Annotated[int, Field(ge=4, le=400, multiple_of=4)] = 48
    pitch_mm: PositiveFloat = 0.5
    row_mm: PositiveFloat = 8.325
    pad_mm: tuple[PositiveFloat, PositiveFloat] = (1.475, 0.3)


class Qfn(Leaded):
    """A quad flat pack without leads, on a thermal pad; the defaults are a 32-pin one of 5 mm body."""

    package: Literal["qfn"] = "qfn"
    pins: Annotated[int, Field(ge=4, le=400, multiple_of=4)] = 32
    pitch_mm: PositiveFloat = 0.5
    row_mm: PositiveFloat = 4.875
    pad_mm: tuple[PositiveFloat, PositiveFloat] = (0.875, 0.25)
    thermal_mm: PositiveFloat = 3.1
    """Side of the thermal pad."""
    panes: Annotated[int, Field(ge=1, le=6)] = 2
    """Window panes along each side of it."""
    pane_share: Annotated[float, Field(gt=0.1, lt=1.0)] = 0.65
    """Share of the thermal pad's area that is printed."""

    @model_validator(mode="after")
    def _thermal_fits(self) -> Self:
        if self.thermal_mm >= self.row_mm - self.pad_mm[0]:
            raise ValueError(
                f"thermal_mm {self.thermal_mm} reaches the pads: make it less than {self.row_mm - self.pad_mm[0]:g}"
            )
        return self

    def lands(self, inset_mm: float) -> list[Land]:
        """Pads and openings, in the part's frame."""
        pitch = self.thermal_mm / self.panes
        size = pitch * np.sqrt(self.pane_share)
        places = (np.arange(self.panes) - (self.panes - 1) / 2) * pitch
        panes = tuple(rectangle(x, y, size, size) for y in places for x in places)
        thermal = Land("EP", rectangle(0.0, 0.0, self.thermal_mm, self.thermal_mm), panes)
        return [*super().lands(inset_mm), thermal]


class Bga(PartBase):
    """A ball grid array; the defaults are an 8 x 8 one of 0.5 mm pitch."""

    package: Literal["bga"] = "bga"
    columns: Annotated[int, Field(ge=1, le=60)] = 8
    rows: Annotated[int, Field(ge=1, le=60)] = 8
    pitch_mm: PositiveFloat = 0.5
    pad_mm: PositiveFloat = 0.3
    """Diameter."""

    @model_validator(mode="after")
    def _clear(self) -> Self:
        if self.pad_mm >= self.pitch_mm:
            raise ValueError(f"pad_mm {self.pad_mm} must be less than pitch_mm {self.pitch_mm}")
        return self

    def lands(self, inset_mm: float) -> list[Land]:
        """Pads and openings, in the part's frame."""
        lands = []
        for row in range(self.rows):
            for column in range(self.columns):
                x = (column - (self.columns - 1) / 2) * self.pitch_mm
                y = ((self.rows - 1) / 2 - row) * self.pitch_mm
                pad = disk(x, y, self.pad_mm / 2)
                opening = disk(x, y, max(self.pad_mm / 2 - inset_mm, 0.02))
                lands.append(Land(f"{row + 1}.{column + 1}", pad, (opening,)))
        return lands


Component = Annotated[Chip | Qfp | Qfn | Bga, Field(discriminator="package")]


def layout(
    parts: tuple[Component, ...],
    size_mm: tuple[float, float],
    inset_mm: float,
    mask_clearance_mm: NonNegativeFloat,
    box: Bounds | None,
) -> Layout:
    """The parts' pads, openings and mask on a board centred on the board's origin, cut to `box` (None: the board)."""
    board = rectangle(0.0, 0.0, *size_mm)
    pads: list[Pad] = []
    copper: list[Area] = []
    for part in parts:
        place, turn = part.position_mm, np.deg2rad(part.rotation_deg)
        for land in part.lands(inset_mm):
            copper.append(_placed(land.pad, place, turn))
            for i, opening in enumerate(land.openings):
                shape = _placed(opening, place, turn)
                centre = (shape.centroid.x, shape.centroid.y)
                suffix = f".{i + 1}" if len(land.openings) > 1 else ""
                aperture = rounded(moved(shape, (-centre[0], -centre[1])))
                name = f"{part.name}-{land.name}{suffix}"
                pads.append(Pad(len(pads) + 1, name, centre, aperture, part.names))
    window = box or board.bounds
    cleared = [shape.buffer(mask_clearance_mm, join_style="mitre") for shape in copper]
    metal, bare, legend = map(shapely.union_all, (copper, cleared, [_frame(p) for p in parts]))
    return cut_layout(pads, metal, bare, board, legend, window)


def _frame(part: Component) -> Area:
    """The line that the legend draws around a part."""
    lands = shapely.union_all([land.pad for land in part.lands(0.0)])
    outline = shapely.envelope(lands).buffer(LEGEND_CLEAR_MM, join_style="mitre").exterior
    line = outline.buffer(LEGEND_LINE_MM / 2, join_style="mitre")
    return _placed(line, part.position_mm, np.deg2rad(part.rotation_deg))


def _land(name: str, pad: shapely.Polygon, inset_mm: float) -> Land:
    opening = pad.buffer(-inset_mm, join_style="mitre") if inset_mm else pad
    return Land(name, pad, () if opening.is_empty else (opening,))


def _placed(shape: shapely.Polygon, place: Place, turn: float) -> shapely.Polygon:
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    put: shapely.Polygon = shapely.transform(shape, lambda xy: xy @ rotation + np.asarray(place))
    return put
