"""A printed circuit board in a scene: artwork, layers, printed paste and defects."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import digits
from typing import Annotated, Literal, Self

import numpy as np
import shapely
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from scenes.board import component_packages, gerber
from scenes.board.component_packages import Component
from scenes.board.defects import Defects
from scenes.board.layers import Layers, Legend, Stackup
from scenes.board.pad_layout import Area, Bounds, Layout, Pad, cut_pads, within_box
from scenes.board.paste import Paste
from scenes.board.warp import Warp, WarpedPlane
from scenes.support.distribution import draw
from scenes.support.errors import FileError, FringebenchWarning, SceneError, nearest
from scenes.support.frozen import Frozen

# Labels of a board's surfaces, in order; the others only where they may occur.
LABELS = ("base", "mask", "pad", "paste")
CONTAMINATION = "contamination"
LEGEND = "legend"

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
            x0, y0, x1, y1 = pads[i].outline.bounds
            centre = []
            for pad, ends, size in (
                ((x0, x1), (board[0], board[2]), self.size_mm[0]),
                ((y0, y1), (board[1], board[3]), self.size_mm[1]),
            ):
                # Both the pad and, unless the board is smaller, the board's edge bound the centre.
                low, high = pad[1] - size / 2, pad[0] + size / 2
                if size < ends[1] - ends[0]:
                    low, high = max(low, ends[0] + size / 2), min(high, ends[1] - size / 2)
                centre.append(float(rng.uniform(low, high)) if low <= high else None)
            x, y = centre
            if x is not None and y is not None:
                return _box_about((x, y), self.size_mm)
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
        others = ((LEGEND, self.legend is not None), (CONTAMINATION, contaminated))
        return (*LABELS, *(label for label, there in others if there))

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
            *((self.legend.material,) if self.legend else ()),
        )

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
        return Stackup(copper_mm=copper, pad_mm=copper + finish, mask_mm=mask, legend_mm=legend)

    def warped_plane(self) -> WarpedPlane:
        """The drawn tilt and bow, world coordinates."""
        return self.warp.drawn(self.generator(WARP))

    def box_around(self, pads: tuple[Pad, ...], board: Bounds) -> Bounds | None:
        """The region's box, None for the whole board; `SceneError` for a pad the board lacks."""
        if self.region is not None:
            return self.region.box(pads, board, self.generator(REGION))
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
    """A board's Gerber files, where names or attributes do not identify them. Only the paste layer is required."""

    paste: Path | None = None
    mask: Path | None = None
    copper: Path | None = None
    outline: Path | None = None
    legend: Path | None = None


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
        for name in self.paste.packages:
            if name.rstrip(digits) != "P":
                raise ValueError(
                    f"paste.packages: '{name}' is not known, as a paste layer names no parts: use P12 for pad 12, P for all"
                )
        return self

    def layout(self) -> Layout:
        """The artwork, cut to the region; raises `FileError` or `SceneError` for what cannot be read or is missing."""
        paths = self.layer_paths()
        mirrored = self.side == "bottom"
        pads = gerber.read_pads(paths["paste"], mirrored)
        everything = shapely.union_all([pad.outline for pad in pads])
        outline = (
            gerber.read_outline(paths["outline"], mirrored)
            if "outline" in paths
            else shapely.box(*everything.buffer(2.0).bounds)
        )
        _report_outside(pads, outline)
        x0, y0, x1, y1 = outline.bounds
        whole = (x0, y0, x1, y1)
        box = self.box_around(pads, whole) or whole
        board = outline.intersection(shapely.box(*box))
        if board.is_empty:
            raise SceneError(
                f"board.region {tuple(round(v, 3) for v in box)} mm is outside the board, which spans "
                f"{tuple(round(v, 3) for v in outline.bounds)} mm"
            )
        near = shapely.union_all([pad.outline for pad in pads if pad.outline.intersects(board)])
        openings = (
            gerber.read_area(paths["mask"], box, mirrored)
            if "mask" in paths
            else near.buffer(self.mask_clearance_mm, join_style="mitre")
        )
        copper = gerber.read_area(paths["copper"], box, mirrored) if "copper" in paths else near
        return Layout(
            tuple(pad for pad in pads if within_box(pad.outline, box)),
            copper.intersection(board),
            openings.intersection(board),
            board,
            box,
            cut_pads(pads, box),
            self._legend(paths, box).intersection(board),
        )

    def _legend(self, paths: Mapping[gerber.Role, Path], box: Bounds) -> Area:
        if self.legend is None:
            return shapely.Polygon()
        if "legend" not in paths:
            raise FileError(
                "[board.legend] asks for a legend, and the board's files have no legend layer of this side: name it "
                "under [board.files] legend = ..., or leave [board.legend] out"
            )
        return gerber.read_area(paths["legend"], box, self.side == "bottom")

    def layer_paths(self) -> dict[gerber.Role, Path]:
        """The file of each layer that is used."""
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

    @model_validator(mode="after")
    def _packages_known(self) -> Self:
        known = {name for part in self.parts for name in part.names}
        for name in self.paste.packages:
            if name not in known:
                raise ValueError(f"paste.packages: no part is '{name}': {nearest(name, known)}")
        return self

    def layout(self) -> Layout:
        """The artwork, cut to the region."""
        arguments = (self.parts, self.size_mm, self.aperture_inset_mm, self.mask_clearance_mm)
        whole = component_packages.layout(*arguments, None)
        box = self.box_around(whole.pads, whole.box)
        return whole if box is None else component_packages.layout(*arguments, box)


def _box_about(centre_mm: tuple[float, float], size_mm: tuple[float, float]) -> Bounds:
    (x, y), (width, height) = centre_mm, size_mm
    return x - width / 2, y - height / 2, x + width / 2, y + height / 2


def _report_outside(pads: tuple[Pad, ...], outline: Area) -> None:
    """Warn of pads outside the board's outline; `SceneError` if all are: files of two boards, or two origins."""
    shapely.prepare(outline)
    outside = [pad for pad in pads if not shapely.intersects(outline, pad.outline)]
    if not outside:
        return
    names = ", ".join(pad.name for pad in outside[:5]) + (", ..." if len(outside) > 5 else "")
    bounds = tuple(round(v, 3) for v in outline.bounds)
    if len(outside) == len(pads):
        raise SceneError(
            f"all {len(pads)} paste openings are outside the board's outline, which spans {bounds} mm: use paste and "
            "outline files of one board"
        )
    warnings.warn(
        f"{len(outside)} of {len(pads)} paste openings are outside the board's outline {bounds} mm and not printed: "
        f"{names}",
        FringebenchWarning,
        stacklevel=2,
    )


Board = Annotated[GerberBoard | ParametricBoard, Field(discriminator="kind")]
