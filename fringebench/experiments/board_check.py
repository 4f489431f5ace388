"""A board's Gerber files read by two programs, and a picture of what was read."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import shapely
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline

from scenes.board import gerber
from scenes.board.gerber.interpreter import read
from scenes.board.gerber.openings import painted
from scenes.board.gerber.second_reader import second_area
from scenes.board.pad_layout import Area
from scenes.support.errors import FileError

# Areas of two readers may differ by this share; what is left is the corners that replace circles.
AGREE = 0.002
COLOURS = {
    "outline": "#d8e3d0",
    "copper": "#c98f4d",
    "mask": "#f0d9a8",
    "paste": "#5a5f66",
    "legend": "#ffffff",
    "drill": "#202020",
}


@dataclass(frozen=True, eq=False)
class LayerCheck:
    """One layer read twice."""

    role: str
    file: str
    area_mm2: float
    second_mm2: float | None
    """None: the second reader cannot read the file."""
    apart_mm2: float | None
    """Area that only one of the two paints."""
    note: str = ""

    @property
    def agrees(self) -> bool:
        """Whether both read the same."""
        return self.apart_mm2 is not None and self.apart_mm2 <= AGREE * max(self.area_mm2, 1e-9)


@dataclass(frozen=True, eq=False)
class BoardCheck:
    """A board as read."""

    layers: tuple[LayerCheck, ...]
    pads: int
    outside: tuple[str, ...]
    """Pads outside the outline: they are not printed."""
    picture: Figure


def check_board(folder: Path, side: gerber.Side = "top") -> BoardCheck:
    """Read the layers of one side of a board with two readers.

    Parameters
    ----------
    folder
        Folder of the Gerber files.
    side
        The board's side.

    Returns
    -------
    BoardCheck
        Areas in mm2 of both readers, pads outside the outline, and a picture of paste over copper over outline.

    Raises
    ------
    FileError
        For a folder without a paste layer, and a file that cannot be read.
    """
    paths = gerber.layer_files(folder, side, {})
    pads = gerber.read_pads(paths["paste"])
    areas: dict[str, Area] = {}
    layers = []
    for role in ("copper", "mask", "paste", "legend"):
        if role in paths:
            areas[role] = painted([(item.shape(), item.dark) for item in read(paths[role]).objects])
            layers.append(_compared(role, paths[role], areas[role]))
    drilled = {path: gerber.read_drills(path) for path in gerber.drill_files(folder)}
    for path, holes in drilled.items():
        area = shapely.union_all([hole.outline for hole in holes])
        areas["drill"] = areas.get("drill", shapely.Polygon()) | area
        layers.append(_compared("drill", path, area))
    outside: tuple[str, ...] = ()
    if "outline" in paths:
        areas["outline"] = gerber.read_outline(paths["outline"])
        outside = tuple(p.name for p in pads if not p.outline.intersects(areas["outline"]))
    return BoardCheck(tuple(layers), len(pads), outside, _picture(areas))


def _compared(role: str, path: Path, area: Area) -> LayerCheck:
    try:
        second = second_area(path, role == "drill")
    except FileError as error:
        return LayerCheck(role, path.name, area.area, None, None, str(error))
    apart = shapely.symmetric_difference(area, second, grid_size=1e-6).area
    return LayerCheck(role, path.name, area.area, second.area, apart)


def _picture(areas: Mapping[str, Area]) -> Figure:
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.subplots()
    for role in ("outline", "copper", "mask", "legend", "drill", "paste"):
        if role in areas:
            parts = [p for p in shapely.get_parts(areas[role]) if p.geom_type == "Polygon"]
            rings = [r for p in parts for r in (p.exterior, *p.interiors)]
            path = Outline.make_compound_path(*(Outline(r.coords, closed=True) for r in rings))
            axes.add_patch(PathPatch(path, facecolor=COLOURS[role], edgecolor="none", label=role))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set(xlabel="x, mm", ylabel="y, mm")
    axes.legend(loc="upper right", fontsize="small")
    return figure
