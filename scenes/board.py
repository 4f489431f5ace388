"""A printed circuit board in a scene: its artwork, its layers, how paste was printed on it and what went wrong."""

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from scenes import gerber, parametric_board
from scenes.defects import Defects
from scenes.distribution import Quantity, draw, within
from scenes.errors import SceneError
from scenes.frozen import Frozen
from scenes.layout import Box, Layout, Pad, within_box
from scenes.parametric_board import Component
from scenes.paste import Paste

# Labels a board brings into its scene, in order; ``contamination`` only where it may occur.
LABELS = ("base", "mask", "pad", "paste")
SOIL = "contamination"

FINISHES = {"enig": "gold", "hasl": "solder", "tin": "tin", "osp": "copper"}

Thickness = Annotated[Quantity, within(0.0, 1.0)]
Positive = Annotated[Quantity, within(1e-4, 1.0)]


class Layers(Frozen):
    """What lies on the laminate, whose surface is z = 0; thicknesses are drawn once a board."""

    copper_mm: Positive = 0.035
    """One ounce per square foot is 0.035 mm."""
    finish: Literal["enig", "hasl", "tin", "osp"] = "enig"
    """On the pads: gold over nickel, hot-air levelled solder, immersion tin, or bare copper under a preservative."""
    finish_mm: Thickness = 0.005
    mask_mm: Positive = 0.025
    """Solder mask, the same on laminate and on copper."""
    mask_material: str = "solder-mask-green"
    laminate_material: str = "laminate"

    @property
    def pad_material(self) -> str:
        """The finish's material."""
        return FINISHES[self.finish]


class Stackup(Frozen):
    """A board's drawn heights above the laminate."""

    copper_mm: float
    pad_mm: float
    """Surface that paste is printed on."""
    mask_mm: float
    """Of the mask over laminate; over copper it stands `copper_mm` higher."""


class Region(Frozen):
    """A rectangle of the board, in board coordinates."""

    centre_mm: tuple[float, float]
    size_mm: tuple[PositiveFloat, PositiveFloat]

    @property
    def box(self) -> Box:
        """x and y from, x and y to."""
        (x, y), (width, height) = self.centre_mm, self.size_mm
        return x - width / 2, y - height / 2, x + width / 2, y + height / 2


class BoardBase(Frozen):
    """What boards of every kind share. The middle of the region lies at the world's origin, the laminate at z = 0."""

    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    """Decides every draw; `scenes.realise` sets it for a sample."""
    region: Region | None = None
    """Part of the board to build; absent: the whole, or the surroundings of `pads`."""
    pads: tuple[PositiveInt, ...] = ()
    """Numbers of pads whose surroundings are the region."""
    margin_mm: NonNegativeFloat = 1.0
    """Board left around `pads`."""
    layers: Layers = Layers()
    paste: Paste = Paste()
    defects: Defects = Defects()

    @model_validator(mode="after")
    def _one_region(self) -> Self:
        if self.region is not None and self.pads:
            raise ValueError("give either region or pads")
        return self

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels its surfaces go under."""
        soiled = self.defects.contamination.probability > 0
        return (*LABELS, SOIL) if soiled else LABELS

    @property
    def materials(self) -> tuple[str, ...]:
        """Names of the materials it is made of."""
        layers = self.layers
        return (
            layers.laminate_material,
            layers.mask_material,
            layers.pad_material,
            self.paste.material,
            self.defects.contamination.material,
        )

    def generator(self, *key: int) -> np.random.Generator:
        """Random numbers of one thing on the board, whatever else is drawn and in which order."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    def stackup(self) -> Stackup:
        """The drawn layer heights."""
        rng, layers = self.generator(0), self.layers
        copper, finish, mask = (
            draw(q, rng) for q in (layers.copper_mm, layers.finish_mm, layers.mask_mm)
        )
        return Stackup(copper_mm=copper, pad_mm=copper + finish, mask_mm=mask)

    def box_around(self, pads: tuple[Pad, ...]) -> Box | None:
        """The region's box, None for the whole board; `SceneError` for a pad the board lacks."""
        if self.region is not None:
            return self.region.box
        if not self.pads:
            return None
        known = {pad.id: pad for pad in pads}
        for number in self.pads:
            if number not in known:
                raise SceneError(
                    f"board.pads: pad {number} does not exist; the board has 1 to {len(pads)}"
                )
        around = shapely.union_all([known[number].outline for number in self.pads])
        x0, y0, x1, y1 = around.buffer(self.margin_mm, join_style="mitre").bounds
        return x0, y0, x1, y1


class Files(Frozen):
    """A board's Gerber files, each where naming or attributes do not tell; the paste layer is the one that must be."""

    paste: Path | None = None
    mask: Path | None = None
    copper: Path | None = None
    outline: Path | None = None


class GerberBoard(BoardBase):
    """A real board from its Gerber files; board coordinates are the files', in mm."""

    kind: Literal["gerber"] = "gerber"
    folder: Path | None = None
    """Folder of the files; relative paths are resolved against the scene file's folder."""
    files: Files = Files()
    """Names inside `folder`, or paths where there is none; they override what `folder` is found to hold."""
    side: gerber.Side = "top"
    """The bottom is seen from below: its x is mirrored."""
    mask_clearance_mm: NonNegativeFloat = 0.05
    """Growth of mask openings around paste openings where there is no mask layer."""

    @model_validator(mode="after")
    def _has_files(self) -> Self:
        if self.folder is None and self.files.paste is None:
            raise ValueError("give folder, or files.paste")
        return self

    def layout(self) -> Layout:
        """The artwork, cut to the region; raises `FileError` or `SceneError` for what cannot be read or is not there."""
        paths = self._paths()
        mirrored = self.side == "bottom"
        pads = gerber.read_pads(paths["paste"], mirrored)
        everything = shapely.union_all([pad.outline for pad in pads])
        outline = (
            gerber.read_outline(paths["outline"], mirrored)
            if "outline" in paths
            else shapely.box(*everything.buffer(2.0).bounds)
        )
        x0, y0, x1, y1 = outline.bounds
        box = self.box_around(pads) or (x0, y0, x1, y1)
        board = outline.intersection(shapely.box(*box))
        if board.is_empty:
            raise SceneError(
                f"board.region {tuple(round(v, 3) for v in box)} mm lies off the board, which spans "
                f"{tuple(round(v, 3) for v in outline.bounds)} mm"
            )
        near = shapely.union_all([pad.outline for pad in pads if pad.outline.intersects(board)])
        openings = (
            gerber.read_area(paths["mask"], box, mirrored)
            if "mask" in paths
            else near.buffer(self.mask_clearance_mm, join_style="mitre")
        )
        copper = gerber.read_area(paths["copper"], box, mirrored) if "copper" in paths else near
        inside = tuple(pad for pad in pads if within_box(pad.outline, box))
        return Layout(inside, copper.intersection(board), openings.intersection(board), board, box)

    def _paths(self) -> dict[gerber.Role, Path]:
        given = {role: getattr(self.files, role) for role in gerber.ROLES}
        named = {
            role: path if self.folder is None else self.folder / path
            for role, path in given.items()
            if path is not None
        }
        if self.folder is None:
            return named
        return gerber.layer_files(self.folder, self.side, named)


class ParametricBoard(BoardBase):
    """A board of standard parts; board coordinates have their origin in its middle."""

    kind: Literal["parametric"] = "parametric"
    size_mm: tuple[PositiveFloat, PositiveFloat]
    parts: Annotated[tuple[Component, ...], Field(min_length=1)]
    aperture_inset_mm: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Stencil openings are smaller than pads by this on every side."""
    mask_clearance_mm: Annotated[float, Field(gt=0.0, le=0.5)] = 0.05
    """Mask openings are larger than pads by this on every side."""

    def layout(self) -> Layout:
        """The artwork, cut to the region."""
        arguments = (self.parts, self.size_mm, self.aperture_inset_mm, self.mask_clearance_mm)
        whole = parametric_board.layout(*arguments, None)
        box = self.box_around(whole.pads)
        return whole if box is None else parametric_board.layout(*arguments, box)


Board = Annotated[GerberBoard | ParametricBoard, Field(discriminator="kind")]
