"""Projectors: geometry plus emission (brightness, contrast, gamma, bit depth, bit planes)."""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from scenes.rig.devices import Pinhole, Telecentric
from scenes.support.frozen import Frozen


class Emission(Frozen):
    """A projector's tone response and brightness."""

    irradiance_w_m2: PositiveFloat = 100.0
    """Irradiance of white on a plane perpendicular to the axis at `reference_mm` (telecentric: at any depth)."""
    contrast: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Michelson contrast (white - black) / (white + black) of what leaves the projector."""
    gamma: Annotated[float, Field(ge=0.2, le=5.0)] = 1.0
    """Emitted = commanded ** gamma, above the black level."""
    bits: Annotated[int, Field(ge=0, le=16)] = 0
    """Bits of the commanded value; 0: not quantised."""
    fluctuation: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Relative standard deviation of its light from one picture to the next."""
    speckle_contrast: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Contrast of its speckle on the camera's chip before pixels average it: 0 for incoherent light, 1 for a laser."""
    fill_factor: Annotated[float, Field(ge=0.01, le=1.0)] | None = None
    """Open share of a projector pixel's area, a square in its middle; white keeps its mean irradiance. Absent: 1."""
    psf_sigma_px: Annotated[float, Field(ge=0.0, le=64.0)] = 0.0
    """Standard deviation of a Gaussian blur of the projector's pixels."""
    pixels: bool | None = None
    """Whether patterns leave as pixels (false: smoothly interpolated, without gaps and blur); absent: if gamma, bits,
    fill_factor or psf_sigma_px is set."""

    frame_ms: Annotated[float, Field(ge=1e-3, le=1e6)] | None = None
    """Frame period of a micromirror device: within it the `bits` are shown as binary planes one after the other, the most
    significant first, each for a time of its weight. Absent: light is steady within an exposure."""
    triggered: bool = True
    """With `frame_ms`: exposures start with a frame; false: anywhere in it."""

    @model_validator(mode="after")
    def _planes_are_linear(self) -> Self:
        if self.frame_ms is not None and (self.gamma != 1.0 or not self.bits):
            raise ValueError(
                f"frame_ms is for a micromirror device, whose bit planes are linear, but bits = {self.bits} and gamma = "
                f"{self.gamma:g}: set bits to 1 or more (8, say) and gamma to 1, or leave frame_ms out"
            )
        return self

    @property
    def pixelated(self) -> bool:
        """Whether patterns reach the scene as projector pixels, not as a continuous function."""
        if self.pixels is not None:
            return self.pixels
        return not self.linear or self.fill_factor is not None or self.psf_sigma_px > 0.0

    @property
    def linear(self) -> bool:
        """Whether emitted values are those commanded, but for the black level."""
        return self.bits == 0 and self.gamma == 1.0

    @property
    def open_width(self) -> float:
        """Side of a pixel's open square in px."""
        return 1.0 if self.fill_factor is None else float(np.sqrt(self.fill_factor))

    @property
    def black(self) -> float:
        """Emitted value of commanded black, as a fraction of white."""
        return (1.0 - self.contrast) / (1.0 + self.contrast)

    @property
    def plane_shares(self) -> NDArray[np.float64]:
        """Share of a frame's time (plane,) that each bit plane is shown for, the most significant first."""
        weights = 2.0 ** np.arange(self.bits)[::-1]
        shares: NDArray[np.float64] = weights / weights.sum()
        return shares

    def planes(self, commanded: NDArray[np.float64]) -> NDArray[np.float64]:
        """Emitted values (plane, ...) of each bit plane; their mean weighted by `plane_shares` is what `emit` gives."""
        level = np.rint(commanded * (2**self.bits - 1)).astype(np.int64)
        bit = np.stack([level >> k & 1 for k in range(self.bits)[::-1]])
        return self.black + (1.0 - self.black) * bit

    def emit(self, commanded: NDArray[np.float64]) -> NDArray[np.float64]:
        """Emitted values (...), 0 to 1: commanded values are quantised, then get gamma, then the black level."""
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
