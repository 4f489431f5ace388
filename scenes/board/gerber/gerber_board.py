"""A board from its Gerber and drill files."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import digits
from typing import Literal, Self

import shapely
from pydantic import NonNegativeFloat, model_validator

from scenes.board import gerber
from scenes.board.board_settings import BoardBase
from scenes.board.extras.fiducials import Fiducials, at_positions, with_found
from scenes.board.extras.holes import with_holes
from scenes.board.pad_layout import Area, Bounds, Layout, Pad, cut_layout
from scenes.support.errors import FileError, FringebenchWarning, SceneError
from scenes.support.frozen import Frozen


class Files(Frozen):
    """A board's Gerber files, where names or attributes do not identify them. Only the paste layer is required."""

    paste: Path | None = None
    mask: Path | None = None
    copper: Path | None = None
    outline: Path | None = None
    legend: Path | None = None
    drill: tuple[Path, ...] = ()
    """Read where the board has `holes`."""


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

    def whole(self) -> tuple[Sequence[Pad], Area]:
        paths, mirrored = self.layer_paths(), self.side == "bottom"
        pads = gerber.read_pads(paths["paste"], mirrored)
        everything = shapely.union_all([pad.outline for pad in pads])
        outline = (
            gerber.read_outline(paths["outline"], mirrored)
            if "outline" in paths
            else shapely.box(*everything.buffer(2.0).bounds)
        )
        _report_outside(pads, outline)
        return pads, outline

    def part(self, pads: Sequence[Pad], outline: Area, box: Bounds) -> Layout:
        paths, mirrored = self.layer_paths(), self.side == "bottom"
        board = outline.intersection(shapely.box(*box))
        near = shapely.union_all([pad.outline for pad in pads if pad.outline.intersects(board)])
        openings = (
            gerber.read_area(paths["mask"], box, mirrored)
            if "mask" in paths
            else near.buffer(self.mask_clearance_mm, join_style="mitre")
        )
        copper = gerber.read_area(paths["copper"], box, mirrored) if "copper" in paths else near
        layout = cut_layout(pads, copper, openings, board, self._legend(paths, box), box)
        if self.fiducials is not None:
            layout = with_found(layout, self._fiducials(layout, paths, self.fiducials))
        if self.holes is None:
            return layout
        drilled = [
            hole
            for path in self.drill_paths()
            for hole in gerber.read_drills(path, mirrored, self.holes.number_format)
        ]
        return with_holes(layout, drilled, self.holes, self.mask_clearance_mm, outline)

    def _fiducials(
        self, layout: Layout, paths: Mapping[gerber.Role, Path], settings: Fiducials
    ) -> Sequence[shapely.Polygon]:
        if settings.positions_mm:
            return at_positions(layout, settings)
        copper = paths.get("copper")
        found = gerber.read_fiducials(copper, self.side == "bottom") if copper else ()
        if not found:
            raise FileError(
                "[board.fiducials] asks for fiducials, and no aperture of the board's copper layer has the attribute "
                "FiducialPad: give positions_mm = [[x, y], ...]"
            )
        return found

    def _legend(self, paths: Mapping[gerber.Role, Path], box: Bounds) -> Area:
        if self.legend is None:
            return shapely.Polygon()
        if "legend" not in paths:
            raise FileError(
                "[board.legend] asks for a legend, and the board's files have no legend layer of this side: name it "
                "under [board.files] legend = ..., or leave [board.legend] out"
            )
        return gerber.read_area(paths["legend"], box, self.side == "bottom")

    def drill_paths(self) -> tuple[Path, ...]:
        """The drill files that are used; `FileError` where holes are asked for and there is neither file nor list."""
        if self.holes is None:
            return ()
        if self.files.drill or self.folder is None:
            found = tuple(self.folder / p if self.folder else p for p in self.files.drill)
        else:
            found = gerber.drill_files(self.folder)
        if not found and not self.holes.drilled:
            raise FileError(
                "[board.holes] asks for holes, and the board's files have no drill file: name it under [board.files] "
                "drill = [...], or leave [board.holes] out"
            )
        return found

    def layer_paths(self) -> dict[gerber.Role, Path]:
        """The file of each layer that is used."""
        given = {role: getattr(self.files, role) for role in gerber.ROLES}
        folder = self.folder or Path()
        named = {role: folder / path for role, path in given.items() if path is not None}
        return gerber.layer_files(folder, self.side, named) if self.folder else named


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
