"""Layers of a board on its laminate: materials, thicknesses, and the heights drawn from them."""

from dataclasses import dataclass
from typing import Annotated, Literal

from scenes.support.distribution import Quantity, Uniform, within
from scenes.support.frozen import Frozen

FINISHES = {"enig": "gold", "hasl": "solder", "tin": "tin", "osp": "copper"}

Thickness = Annotated[Quantity, within(0.0, 1.0)]
Shift = Annotated[Quantity, within(-0.3, 0.3)]
Positive = Annotated[Quantity, within(1e-4, 1.0)]


class Layers(Frozen):
    """Layers on the laminate, whose surface is z = 0. Thicknesses are drawn once per board."""

    copper_mm: Positive = 0.035
    """One ounce per square foot is 0.035 mm."""
    finish: Literal["enig", "hasl", "tin", "osp"] = "enig"
    """On the pads: gold over nickel, hot-air levelled solder, immersion tin, or bare copper under a preservative."""
    finish_mm: Thickness = 0.005
    dome_mm: Thickness | None = None
    """How much higher than its rim the middle of a bare pad is, drawn for each; absent: 0, with `hasl` up to 0.02, so that the
    solder is 5 to 25 um thick (70 to 1000 microinches: J. Yip, IPC's TechNet, December 1996)."""
    mask_mm: Positive = 0.025
    """Solder mask, the same on laminate and on copper."""
    mask_material: str = "solder-mask-green"
    mask_shift_x_mm: Shift = 0.0
    """How far the mask's openings are off the copper, drawn once per board."""
    mask_shift_y_mm: Shift = 0.0
    laminate_material: str = "laminate"

    @property
    def dome(self) -> Quantity:
        """`dome_mm`, or the finish's."""
        usual: Quantity = Uniform(low=0.0, high=0.02) if self.finish == "hasl" else 0.0
        return usual if self.dome_mm is None else self.dome_mm

    @property
    def pad_material(self) -> str:
        """The finish's material."""
        return FINISHES[self.finish]


class Legend(Frozen):
    """Names and outlines of parts, printed on the mask; mask openings stay free of it."""

    height_mm: Positive = 0.015
    """Above the mask, drawn once per board. The default is assumed, not measured."""
    material: str = "white-paint"


@dataclass(frozen=True)
class Stackup:
    """A board's drawn heights above the laminate."""

    copper_mm: float
    pad_mm: float
    """Surface that paste is printed on."""
    mask_mm: float
    """Of the mask over laminate; over copper it is `copper_mm` higher."""
    legend_mm: float = 0.0
    """Of the legend above the mask; 0 without one."""
    dip_mm: float = 0.0
    """How much lower the mask is over a tented hole."""
    depth_mm: float = 0.0
    """Of what an open hole shows, below the laminate's surface."""
    mask_shift_mm: tuple[float, float] = (0.0, 0.0)
    film_mm: float = 0.0
    """Of residue, above what is below it."""
