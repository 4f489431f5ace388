"""What every kind of board has: region, layers, paste, defects, and its random numbers."""

from collections.abc import Sequence
from typing import Annotated, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from scenes.board.defects import Defects
from scenes.board.extras.board_panel import BoardPanel, on_copy
from scenes.board.extras.fiducials import Fiducials
from scenes.board.extras.holes import Holes
from scenes.board.layers import Layers, Legend, Stackup
from scenes.board.pad_layout import Area, Bounds, Layout, Pad
from scenes.board.paste import Paste
from scenes.board.warp import Warp, WarpedPlane
from scenes.support.distribution import draw
from scenes.support.errors import SceneError
from scenes.support.frozen import Frozen

# Labels of a board's surfaces, in order; the others only where they may occur.
LABELS = ("base", "mask", "pad", "paste")
CONTAMINATION = "contamination"
LEGEND = "legend"
HOLE = "hole"
FIDUCIAL = "fiducial"
SCRATCH = "scratch"
RESIDUE = "residue"

# Streams of random numbers of a drawn region and of the warp; 0 is the layers, 1 to 3 and 5 are the print.
REGION, WARP = 4, 6


class BoardRegion(Frozen):
    """A rectangle of the board, in board coordinates."""

    centre_mm: tuple[float, float] | None = None
    """Absent: drawn from the board's seed, so that each sample shows another part of the board."""
    size_mm: tuple[PositiveFloat, PositiveFloat]

    def box(self, pads: Sequence[Pad], board: Bounds, rng: np.random.Generator) -> Bounds:
        """x and y from, x and y to; a drawn one contains one or more pads and stays on the board where it fits."""
        if self.centre_mm is not None:
            return _box_about(self.centre_mm, self.size_mm)
        for i in rng.permutation(len(pads)):
            pad, centre = pads[i].outline.bounds, list[float]()
            for k, size in enumerate(self.size_mm):
                # Both the pad and, unless the board is smaller, the board's edge bound the centre.
                low, high = pad[k + 2] - size / 2, pad[k] + size / 2
                if size < board[k + 2] - board[k]:
                    low, high = max(low, board[k] + size / 2), min(high, board[k + 2] - size / 2)
                if low <= high:
                    centre.append(float(rng.uniform(low, high)))
            if len(centre) == len(self.size_mm):
                return _box_about((centre[0], centre[1]), self.size_mm)
        raise SceneError(
            f"board.region of {list(self.size_mm)} mm holds none of the {len(pads)} pads: make it larger"
        )


class BoardBase(Frozen):
    """Settings of every kind of board. The middle of the region is at the world's origin, the laminate at z = 0."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Decides every draw; `scenes.realise` sets it for a sample."""
    region: BoardRegion | None = None
    """Part of the board to build; absent: the whole, or the surroundings of `pads`."""
    pads: tuple[PositiveInt, ...] = ()
    """Numbers of pads whose surroundings are the region."""
    margin_mm: NonNegativeFloat = 1.0
    """Board left around `pads`."""
    layers: Layers = Layers()
    legend: Legend | None = None
    """Absent: none is printed."""
    holes: Holes | None = None
    """Absent: the board has none, whatever its drill files say."""
    fiducials: Fiducials | None = None
    """Absent: fiducials have the label `pad`."""
    panel: BoardPanel | None = None
    """Absent: the board is alone."""
    warp: Warp = Warp()
    paste: Paste = Paste()
    defects: Defects = Defects()

    @model_validator(mode="after")
    def _one_region(self) -> Self:
        if self.region is not None and self.pads:
            raise ValueError("give either region or pads")
        return self

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of its surfaces."""
        contaminated = self.defects.contamination.probability > 0
        others = (
            (LEGEND, self.legend is not None),
            (CONTAMINATION, contaminated),
            (HOLE, self.through is not None),
            (FIDUCIAL, self.fiducials is not None or (self.panel and self.panel.fiducial_mm)),
            (SCRATCH, self.defects.scratch.probability > 0),
            (RESIDUE, self.defects.residue.probability > 0),
        )
        return (*LABELS, *(label for label, there in others if there))

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of the materials it is made of."""
        layers = self.layers
        return (
            layers.laminate_material,
            layers.mask_material,
            layers.pad_material,
            *self.paste.materials,
            self.defects.contamination.material,
            self.defects.residue.material,
            *(part.material for part in (self.legend, self.through) if part),
        )

    @property
    def through(self) -> Holes | None:
        """What shows where the board is cut through; None where it is nowhere."""
        return self.holes or (Holes() if self.panel else None)

    def generator(self, *key: int) -> np.random.Generator:
        """Independent random numbers of one item of the board, the same in any order of drawing."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def stackup(self) -> Stackup:
        """The drawn layer heights."""
        rng, layers = self.generator(0), self.layers
        copper, finish, mask = (
            draw(q, rng) for q in (layers.copper_mm, layers.finish_mm, layers.mask_mm)
        )
        legend = draw(self.legend.height_mm, rng) if self.legend else 0.0
        dip = draw(self.holes.dip_mm, rng) if self.holes else 0.0
        depth = self.through.depth_mm if self.through else 0.0
        shift = draw(layers.mask_shift_x_mm, rng), draw(layers.mask_shift_y_mm, rng)
        film = draw(self.defects.residue.height_mm, rng)
        return Stackup(copper, copper + finish, mask, legend, dip, depth, shift, film)

    def warped_plane(self) -> WarpedPlane:
        """The drawn tilt and bow, world coordinates."""
        return self.warp.drawn(self.generator(WARP))

    def whole(self) -> tuple[Sequence[Pad], Area]:
        """All pads of one board, and its outline."""
        raise NotImplementedError

    def part(self, pads: Sequence[Pad], outline: Area, box: Bounds) -> Layout:
        """The artwork of one board cut to a box."""
        raise NotImplementedError

    def layout(self) -> Layout:
        """The artwork, cut to the region; raises `FileError` or `SceneError` for what cannot be read or is missing."""
        pads, outline = self.whole()
        if self.panel is None:
            return self.part(pads, outline, self._box(pads, outline))
        places = enumerate(self.panel.places(outline.bounds))
        all_pads = [p for k, place in places for p in on_copy(pads, k, len(pads), place)]
        box = self._box(all_pads, self.panel.outline(outline.bounds))
        return self.panel.layout(
            lambda window: self.part(pads, outline, window), outline, len(pads), box
        )

    def _box(self, pads: Sequence[Pad], outline: Area) -> Bounds:
        """The region's box; `SceneError` for one off the board, and for a pad the board lacks."""
        box: Bounds = outline.bounds
        if self.region is not None:
            box = self.region.box(pads, box, self.generator(REGION))
        elif self.pads:
            known = {pad.id: pad for pad in pads}
            for number in self.pads:
                if number not in known:
                    raise SceneError(
                        f"board.pads: pad {number} does not exist; the board has 1 to {len(pads)}"
                    )
            around = shapely.union_all([known[number].outline for number in self.pads])
            box = around.buffer(self.margin_mm, join_style="mitre").bounds
        if outline.intersects(shapely.box(*box)):
            return box
        raise SceneError(
            f"board.region {tuple(round(v, 3) for v in box)} mm is outside the board, which spans "
            f"{tuple(round(v, 3) for v in outline.bounds)} mm"
        )


def _box_about(centre_mm: tuple[float, float], size_mm: tuple[float, float]) -> Bounds:
    (x, y), (width, height) = centre_mm, size_mm
    return x - width / 2, y - height / 2, x + width / 2, y + height / 2
