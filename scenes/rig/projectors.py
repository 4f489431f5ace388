"""Projectors and screens: geometry plus emission (brightness, contrast, gamma, bit depth, bit planes)."""

from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from scenes.rig.devices import Pinhole, RigDevice, Telecentric
from scenes.rig.projection import Projection
from scenes.support.frozen import Frozen

# Two positions closer than this are no second look: directions would be noise.
MIN_APART_MM = 0.1
# Points of a camera's image along each side at which its view is checked.
GRID = 33


class Emission(Frozen):
    """A projector's or a screen's tone response."""

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


class Beam(Emission):
    """A projector's tone response and brightness."""

    irradiance_w_m2: PositiveFloat = 100.0
    """Irradiance of white on a plane perpendicular to the axis at `reference_mm` (telecentric: at any depth)."""


class TelecentricProjector(Telecentric, Beam):
    """A projector with parallel rays."""


class PinholeProjector(Pinhole, Beam):
    """A projector with one centre of projection."""

    reference_mm: PositiveFloat
    """Depth at which `irradiance_w_m2` holds; elsewhere it falls as (reference_mm / depth) ** 2."""


class Screen(RigDevice, Emission):
    """A flat screen that shows the patterns, for deflectometry: the camera sees it by way of a mirroring surface.

    Its frame has its origin in the middle of the screen and z along the normal, towards what it lights (``pose.target_mm``).
    Pixel (0, 0) is the upper left corner for a viewer in front of it. It is thin, absorbs what falls on it and casts no
    shadow; of two positions only one shows a pattern at a time, so neither hides the other.
    """

    model: Literal["screen"] = "screen"
    size_mm: tuple[PositiveFloat, PositiveFloat]
    """Width and height of the area of pixels."""
    radiance_w_m2_sr: PositiveFloat = 100.0
    """Radiance of white along the normal."""
    falloff: Annotated[float, Field(ge=0.0, le=64.0)] = 0.0
    """Exponent n of its radiance over the angle to the normal, ``cos(angle) ** n``; 0: the same in all directions."""
    lens: ClassVar[None] = None

    def projection(self) -> Projection:
        """Pixels of points on the screen; its `rays` start at the pixels, along the normal."""
        rotation, translation = self.pose.matrix()
        width, height = self.resolution
        per_mm = width / self.size_mm[0], height / self.size_mm[1]
        none = (0.0, 0.0, 0.0, 0.0, 0.0)
        # Columns run against the frame's x, which points to the left of a viewer.
        return Projection(
            True,
            width,
            height,
            -per_mm[0],
            per_mm[1],
            width / 2,
            height / 2,
            none,
            rotation,
            translation,
            np.inf,
        )

    def hidden_share(self, camera: Projection, floor_mm: float) -> float:
        """Share of a camera's rays, of a grid over its image, that end on the screen before they reach z = `floor_mm`."""
        along = (np.linspace(0.0, size, GRID) for size in (camera.width, camera.height))
        start, way = camera.rays(np.stack(np.meshgrid(*along), axis=-1))
        rotation, translation = self.pose.matrix()
        local, ahead = start @ rotation.T + translation, way @ rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -local[..., 2] / ahead[..., 2]
            floor = (floor_mm - start[..., 2]) / way[..., 2]
            place = np.abs(local + distance[..., None] * ahead)[..., :2]
        hidden = (distance > 0.0) & (distance < floor)
        return float((hidden & (place < np.array(self.size_mm) / 2.0).all(axis=-1)).mean())


def require_one_kind(projectors: Sequence[object]) -> None:
    """Raise `ValueError` for screens among projectors, more than two, or two in one plane."""
    screens = [p for p in projectors if isinstance(p, Screen)]
    if screens and len(screens) < len(projectors):
        raise ValueError(
            "projectors and screens are mixed: a rig has either projectors, whose light a surface scatters, or one or "
            'two positions of a screen (model = "screen"), which it mirrors'
        )
    if len(screens) > 2:
        raise ValueError(f"there are {len(screens)} screens: give one or two positions")
    if len(screens) == 2:
        one, two = (screen.projection() for screen in screens)
        apart = abs(float((two.origin_mm - one.origin_mm) @ one.axis))
        if apart < MIN_APART_MM:
            raise ValueError(
                f"the two positions of the screen are {apart:.3g} mm apart along its normal: move one of them along it, by "
                f"{MIN_APART_MM:g} mm or more"
            )


Camera = Annotated[Telecentric | Pinhole, Field(discriminator="model")]
Projector = Annotated[
    TelecentricProjector | PinholeProjector | Screen, Field(discriminator="model")
]
