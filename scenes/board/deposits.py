"""What was printed on a board: deposits, bridges between them, and where the board is."""

from dataclasses import dataclass

import shapely

from scenes.board.defects import PadDefects
from scenes.board.layers import Stackup
from scenes.board.pad_layout import Layout, Pad
from scenes.board.warp import WarpedPlane
from scenes.shapes.heightfield import Heightfield


@dataclass(frozen=True, eq=False)
class Deposit:
    """What was printed on one pad, world coordinates; heights count from the pad's surface."""

    pad: Pad
    aperture: shapely.Polygon
    """The nominal opening in the world."""
    defects: PadDefects
    area_ratio: float
    efficiency: float
    """Transfer efficiency by the area ratio."""
    field: Heightfield | None
    """None: no paste left the aperture."""
    tail: Heightfield | None = None
    tail_volume_mm3: float = 0.0
    """Of the part of the smear beyond the deposit."""
    speck: Heightfield | None = None

    @property
    def footprint(self) -> shapely.Polygon:
        """Outline of the deposit in the world; empty where none is."""
        if self.field is None:
            return shapely.Polygon()
        outer, *holes = (self.field.xy_mm[rim] for rim in self.field.rims)
        return shapely.Polygon(outer, holes)


@dataclass(frozen=True, eq=False)
class PasteBridge:
    """Paste between two deposits."""

    pads: tuple[int, int]
    field: Heightfield | None
    """None: the deposits themselves touch."""
    ends_mm: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    """Where it leaves the first pad's deposit and meets the second's."""
    volume_mm3: float = 0.0
    """Of the part between the deposits."""


@dataclass(frozen=True, eq=False)
class Print:
    """A printed board; world coordinates put the region's middle at the origin and the laminate at z = 0."""

    layout: Layout
    stackup: Stackup
    stencil_mm: float
    deposits: tuple[Deposit, ...]
    bridges: tuple[PasteBridge, ...]
    warp: WarpedPlane
    """Added to all heights of the board and its paste."""
