"""What a projector emits: brightness, contrast, gamma, bit depth, on top of its geometry."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat

from scenes.frozen import Frozen
from scenes.rig import Pinhole, Telecentric


class Emission(Frozen):
    """A projector's tone response and brightness."""

    irradiance_w_m2: PositiveFloat = 100.0
    """Irradiance of white on a plane perpendicular to the axis at `reference_mm` (telecentric: at any depth)."""
    contrast: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Michelson contrast (white - black) / (white + black) of what leaves the projector."""
    gamma: Annotated[float, Field(ge=0.2, le=5.0)] = 1.0
    """Emitted = commanded ** gamma, above the black level."""
    bits: Annotated[int, Field(ge=0, le=16)] = 0
    """Bits of the commanded value; 0: an ideal projector, continuous in value and in space."""

    @property
    def pixelated(self) -> bool:
        """Whether patterns reach the scene as projector pixels; a linear, unquantised projector is continuous."""
        return self.bits > 0 or self.gamma != 1.0

    @property
    def black(self) -> float:
        """Emitted value of commanded black, as a fraction of white."""
        return (1.0 - self.contrast) / (1.0 + self.contrast)

    def emit(self, commanded: NDArray[np.float64]) -> NDArray[np.float64]:
        """Emitted value in [0, 1] of commanded values in [0, 1]: quantised, then gamma, then black level."""
        if self.bits:
            levels = 2**self.bits - 1
            commanded = np.round(commanded * levels) / levels
        return self.black + (1.0 - self.black) * commanded**self.gamma


class TelecentricProjector(Telecentric, Emission):
    """A projector with parallel rays."""


class PinholeProjector(Pinhole, Emission):
    """A projector with one centre of projection."""

    reference_mm: PositiveFloat
    """Depth at which `irradiance_w_m2` holds; elsewhere it falls as (reference_mm / depth) ** 2."""


Camera = Annotated[Telecentric | Pinhole, Field(discriminator="model")]
Projector = Annotated[TelecentricProjector | PinholeProjector, Field(discriminator="model")]
