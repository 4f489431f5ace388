"""Sensor models as data: their parameters, and the mean and variance they give.

`Emva` follows EMVA Standard 1288 (release 4.0, linear model, eqs. 3-10): photons, electrons, digital numbers.
`SimpleSensor` is the textbook's: digital numbers proportional to light, plus Gaussian noise.
"""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat

from scenes.frozen import Frozen

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0
# Rounding to whole numbers is uniform noise of one DN width (EMVA 1288, eq. 8).
QUANTISATION_VARIANCE_DN2 = 1.0 / 12.0
# One full well in 3.5 million reads lower than this many standard deviations below the mean.
WELL_MARGIN = 5.0

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]


class Digitiser(Frozen):
    """What both sensors share: black level and bits of the digital number."""

    bits: Annotated[int, Field(ge=0, le=16)] = 8
    """Bits of a digital number; 0: no rounding and no clipping at the converter (float32 frames)."""
    black_level_dn: NonNegativeFloat = 0.0
    """Digital number of no light."""

    @property
    def dtype(self) -> DTypeLike:
        """Type of a frame's digital numbers."""
        if self.bits == 0:
            return np.float32
        return np.uint8 if self.bits <= 8 else np.uint16

    @property
    def full_scale_dn(self) -> float:
        """Largest digital number the converter gives; infinite without one."""
        return float(2**self.bits - 1) if self.bits else float("inf")

    @property
    def rounding_variance_dn2(self) -> float:
        """Variance added by rounding."""
        return QUANTISATION_VARIANCE_DN2 if self.bits else 0.0


class SimpleSensor(Digitiser):
    """Digital number = black level + responsivity x radiance x time + Gaussian noise."""

    kind: Literal["simple"] = "simple"
    responsivity_dn: PositiveFloat = 1.0
    """DN per (W/(m^2 sr) x ms)."""
    sigma_dn: NonNegativeFloat = 3.0
    """Standard deviation of the noise."""
    saturated_from_dn: PositiveFloat | None = None
    """From this digital number up samples are not to be trusted, where a real camera bends before its converter's end."""

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated."""
        return min(self.full_scale_dn, self.saturated_from_dn or float("inf"))

    def mean_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """Mean digital number, before clipping and rounding, of radiance in W/(m^2 sr)."""
        signal = np.asarray(radiance, dtype=np.float64) * (self.responsivity_dn * exposure_ms)
        return self.black_level_dn + signal

    def variance_dn2(self, mean_dn: ArrayLike, exposure_ms: float = 0.0) -> NDArray[np.float64]:
        """Variance of an unsaturated digital number of that mean."""
        return np.full_like(
            np.asarray(mean_dn, dtype=np.float64), self.sigma_dn**2 + self.rounding_variance_dn2
        )

    def noise_model(self, exposure_ms: float = 0.0) -> tuple[float, float]:
        """(constant, slope) of ``variance_dn2 = constant + slope (DN - black level)``."""
        return self.sigma_dn**2 + self.rounding_variance_dn2, 0.0


class Emva(Digitiser):
    """An image sensor behind a lens, after EMVA 1288."""

    kind: Literal["emva1288"] = "emva1288"
    bits: Annotated[int, Field(ge=0, le=16)] = 12
    black_level_dn: NonNegativeFloat = 64.0
    pixel_um: PositiveFloat = 3.45
    """Pixel pitch on the chip; the fill factor is in the quantum efficiency."""
    f_number: PositiveFloat = 8.0
    """Working f-number of the lens."""
    transmission: Fraction = 0.9
    """Of the lens and filters."""
    wavelength_nm: PositiveFloat = 589.0
    quantum_efficiency: Fraction = 0.6
    """Electrons per photon on the pixel."""
    full_well_e: PositiveFloat = 10500.0
    """Electrons at saturation."""
    gain_dn_per_e: PositiveFloat = 0.38
    """Overall system gain K."""
    read_noise_e: NonNegativeFloat = 2.5
    """Temporal dark noise at zero exposure."""
    dark_current_e_per_s: NonNegativeFloat = 1.0
    dsnu_e: NonNegativeFloat = 0.0
    """Standard deviation over pixels of the offset (fixed for a seed)."""
    prnu: Annotated[float, Field(ge=0.0, lt=0.2)] = 0.0
    """Relative standard deviation over pixels of the responsivity (fixed for a seed)."""

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated: the converter's end or the full well's, whichever is less.

        Read-out noise comes after the full well, so full wells scatter about its digital number: the limit lies below
        it by `WELL_MARGIN` of their standard deviation, else half of them would pass for good samples.
        """
        scatter_e = float(np.hypot(self.read_noise_e, self.dsnu_e))
        full_e = self.full_well_e - WELL_MARGIN * scatter_e
        well = self.black_level_dn + self.gain_dn_per_e * full_e
        return min(self.full_scale_dn, float(np.floor(well)) if self.bits else well)

    @property
    def photons_per_radiance_ms(self) -> float:
        """Photons on a pixel per W/(m^2 sr) and ms: irradiance pi L T / (4 N^2) times area times wavelength / (h c)."""
        area_m2 = (self.pixel_um * 1e-6) ** 2
        per_joule = self.wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S)
        return float(
            np.pi * self.transmission / (4.0 * self.f_number**2) * area_m2 * per_joule * 1e-3
        )

    def mean_electrons(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """Mean electrons collected, dark current included, before the full well clips."""
        # Far past any full well, and finite: no light stays none however long the exposure.
        light = min(self.quantum_efficiency * self.photons_per_radiance_ms * exposure_ms, 1e200)
        dark = self.dark_current_e_per_s * exposure_ms * 1e-3
        return np.asarray(radiance, dtype=np.float64) * light + dark

    def mean_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """Mean digital number, before clipping and rounding, of radiance in W/(m^2 sr)."""
        return self.black_level_dn + self.gain_dn_per_e * self.mean_electrons(radiance, exposure_ms)

    def variance_dn2(self, mean_dn: ArrayLike, exposure_ms: float = 0.0) -> NDArray[np.float64]:
        """Temporal variance of an unsaturated digital number of that mean (photon transfer, eq. 10)."""
        constant, slope = self.noise_model(exposure_ms)
        above_black = np.asarray(mean_dn, dtype=np.float64) - self.black_level_dn
        return constant + slope * np.maximum(above_black, 0.0)

    def noise_model(self, exposure_ms: float = 0.0) -> tuple[float, float]:
        """(constant, slope) of ``variance_dn2 = constant + slope (DN - black level)``."""
        constant = (self.gain_dn_per_e * self.read_noise_e) ** 2 + self.rounding_variance_dn2
        return constant, self.gain_dn_per_e


Sensor = Annotated[SimpleSensor | Emva, Field(discriminator="kind")]
