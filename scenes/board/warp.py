"""Tilt and bow of a board: how far its surface is from the plane it would be in on a perfect support."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenes.support.distribution import Quantity, draw, within
from scenes.support.frozen import Frozen

Slope = Annotated[Quantity, within(-0.1, 0.1)]

# Flat faces of a bowed board are cut into squares of this size: they deviate from 0.2 mm over 50 mm by 0.08 um.
FACE_MM = 1.0


class Warp(Frozen):
    """Drawn once per board; the middle of the region stays where it is."""

    slope_x: Slope = 0.0
    """Rise along x, mm per mm."""
    slope_y: Slope = 0.0
    bow_mm: Annotated[Quantity, within(-5.0, 5.0)] = 0.0
    """How much lower the board is `span_mm` / 2 from the middle, the same in all directions."""
    span_mm: Annotated[float, Field(ge=1.0)] = 50.0

    def drawn(self, rng: np.random.Generator) -> "WarpedPlane":
        """One board's."""
        x, y, bow = (draw(q, rng) for q in (self.slope_x, self.slope_y, self.bow_mm))
        return WarpedPlane(x, y, -bow / (self.span_mm / 2.0) ** 2)


@dataclass(frozen=True)
class WarpedPlane:
    """``z = slope_x x + slope_y y + curvature_per_mm (x^2 + y^2)``, mm."""

    slope_x: float = 0.0
    slope_y: float = 0.0
    curvature_per_mm: float = 0.0

    def z_mm(self, xy_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights (...,) at points (..., 2)."""
        x, y = xy_mm[..., 0], xy_mm[..., 1]
        z: NDArray[np.float64] = self.slope_x * x + self.slope_y * y
        return z + self.curvature_per_mm * (x * x + y * y)
