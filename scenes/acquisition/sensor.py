"""Sensor models as data: their parameters, and the mean and variance of their digital numbers.

`Emva` follows EMVA Standard 1288 (release 4.0, linear model, eqs. 3-10): photons, electrons, digital numbers.
`SimpleSensor` is the textbook's: digital numbers proportional to light, plus Gaussian noise.
"""

from abc import abstractmethod
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator

from scenes.support.frozen import Frozen

PLANCK_J_S = 6.62607015e-34
LIGHT_M_S = 299792458.0
# Rounding to whole numbers is uniform noise of one DN width (EMVA 1288, eq. 8).
QUANTISATION_VARIANCE_DN2 = 1.0 / 12.0
# One full well in 3.5 million reads more than this many standard deviations below the mean.
WELL_MARGIN = 5.0

Fraction = Annotated[float, Field(gt=0.0, le=1.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class Digitiser(Frozen):
    """Black level and bits of the digital number, common to both sensors."""

    bits: Annotated[int, Field(ge=0, le=16)] = 8
    """Bits of a digital number; 0: the converter neither rounds nor clips (float32 frames)."""
    black_level_dn: NonNegativeFloat = 0.0
    """Digital number of no light."""
    clip_dn: Annotated[float, Field(ge=1.0, le=65535.0)] | None = None
    """Digital number at which the converter clips, where it ends below its bits (235, 4080); absent: ``2 ** bits - 1``."""

    @property
    def dtype(self) -> DTypeLike:
        """Type of a frame's digital numbers."""
        if self.bits == 0:
            return np.float32
        return np.uint8 if self.bits <= 8 else np.uint16

    @property
    def full_scale_dn(self) -> float:
        """Largest digital number of the converter; infinite for 0 bits."""
        if not self.bits:
            return float("inf")
        end = float(2**self.bits - 1)
        return end if self.clip_dn is None else min(end, self.clip_dn)

    @property
    def rounding_variance_dn2(self) -> float:
        """Variance added by rounding."""
        return QUANTISATION_VARIANCE_DN2 if self.bits else 0.0

    @abstractmethod
    def signal_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """Mean digital number above black, before clipping and rounding.

        Parameters
        ----------
        radiance
            Radiance (...), W/(m^2 sr).
        exposure_ms
            Exposure time, ms.

        Returns
        -------
        ndarray of float64, (...)
            Mean above black, DN.
        """

    @abstractmethod
    def noise_model(self, exposure_ms: float = 0.0) -> tuple[float, float]:
        """(constant, slope) of ``variance_dn2 = constant + slope (DN - black level)``."""

    def mean_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """Mean digital number before clipping and rounding.

        Parameters
        ----------
        radiance, exposure_ms
            As of `signal_dn`.

        Returns
        -------
        ndarray of float64, (...)
            Mean, DN.
        """
        return self.black_level_dn + self.signal_dn(radiance, exposure_ms)

    def variance_dn2(self, mean_dn: ArrayLike, exposure_ms: float = 0.0) -> NDArray[np.float64]:
        """Temporal variance of unsaturated digital numbers (photon transfer, EMVA 1288 eq. 10).

        Parameters
        ----------
        mean_dn
            Mean digital numbers (...), DN.
        exposure_ms
            Exposure time, ms.

        Returns
        -------
        ndarray of float64, (...)
            Variance, DN^2.
        """
        constant, slope = self.noise_model(exposure_ms)
        mean = np.asarray(mean_dn, dtype=np.float64)
        if not slope:
            return np.full_like(mean, constant)
        return constant + slope * np.maximum(mean - self.black_level_dn, 0.0)


class SimpleSensor(Digitiser):
    """Digital number = black level + responsivity x radiance x time + Gaussian noise."""

    kind: Literal["simple"] = "simple"
    responsivity_dn: PositiveFloat = 1.0
    """DN per (W/(m^2 sr) x ms)."""
    sigma_dn: NonNegativeFloat = 3.0
    """Standard deviation of the noise."""
    saturated_from_dn: PositiveFloat | None = None
    """Samples from this digital number up count as saturated, for cameras that bend below the converter's end."""

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated."""
        return min(self.full_scale_dn, self.saturated_from_dn or float("inf"))

    def signal_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """As of every sensor."""
        return np.asarray(radiance, dtype=np.float64) * (self.responsivity_dn * exposure_ms)

    def noise_model(self, exposure_ms: float = 0.0) -> tuple[float, float]:
        """As of every sensor."""
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
    dsnu_row_e: NonNegativeFloat = 0.0
    """Standard deviation over rows of an offset that a row shares, on top of `dsnu_e` (fixed for a seed)."""
    dsnu_column_e: NonNegativeFloat = 0.0
    """Likewise over columns."""
    row_noise_e: NonNegativeFloat = 0.0
    """Standard deviation of an offset that a row shares in one frame, independent between frames."""
    column_noise_e: NonNegativeFloat = 0.0
    """Likewise of a column."""
    hot_pixels: Share = 0.0
    """Share of pixels whose dark current is raised, by `hot_current_e_per_s` on average, exponentially distributed."""
    hot_current_e_per_s: NonNegativeFloat = 1000.0
    dead_pixels: Share = 0.0
    """Share of pixels that see no light."""
    nonlinearity: Annotated[tuple[float, ...], Field(max_length=4)] = ()
    """c1, c2, ...: a charge that fills a share x of the well is read as ``1 + c1 x + c2 x^2 ...`` times itself."""
    psf: Literal["diffraction", "none"] = "diffraction"
    """Blur of the lens: that of a perfect lens of `f_number` at `wavelength_nm`, or none. In whole pixels, those next to a
    sharp edge are off by up to 3.5 % of it; `subpixels` of `render.expose` are exact to 1 %."""
    psf_sigma_um: NonNegativeFloat = 0.0
    """Standard deviation on the chip of a Gaussian blur on top of `psf`: aberrations, cross-talk between pixels."""
    row_time_us: NonNegativeFloat = 0.0
    """Rolling shutter: each row's exposure begins so much later than that of the row above; 0: all begin together."""

    @model_validator(mode="after")
    def _curve_rises(self) -> Self:
        x = np.linspace(0.0, 1.0, 65)
        read = self.read_charge(x * self.full_well_e) / self.full_well_e
        if not (np.isfinite(read).all() and (np.diff(read) > 0.0).all()):
            raise ValueError(
                f"nonlinearity {list(self.nonlinearity)} makes the response fall or flat below the full well: use "
                "smaller coefficients, e.g. [-0.02]"
            )
        return self

    def read_charge(self, electrons: NDArray[np.float64]) -> NDArray[np.float64]:
        """Electrons as read, by the curve of `nonlinearity`.

        Parameters
        ----------
        electrons
            Electrons collected, (...).

        Returns
        -------
        ndarray of float64, (...)
            Electrons as read.
        """
        if not self.nonlinearity:
            return electrons
        share = electrons / self.full_well_e
        return electrons * np.polynomial.polynomial.polyval(share, (1.0, *self.nonlinearity))

    @property
    def blurs(self) -> bool:
        """Whether light of a point reaches more than one pixel."""
        return self.psf != "none" or self.psf_sigma_um > 0.0

    @property
    def saturation_dn(self) -> float:
        """From this digital number up a sample is saturated: the converter's end or the full well's, whichever is less.

        Read noise comes after the full well, so full wells scatter around its digital number. The limit is `WELL_MARGIN`
        standard deviations lower, otherwise half of them would pass as good samples.
        """
        offsets = (self.dsnu_row_e, self.dsnu_column_e, self.row_noise_e, self.column_noise_e)
        scatter_e = float(np.linalg.norm([self.read_noise_e, self.dsnu_e, *offsets]))
        full_e = float(self.read_charge(np.array(self.full_well_e))) - WELL_MARGIN * scatter_e
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
        """Mean electrons collected, dark current included, before the full well clips.

        Parameters
        ----------
        radiance
            Radiance (...), W/(m^2 sr).
        exposure_ms
            Exposure time, ms.

        Returns
        -------
        ndarray of float64, (...)
            Mean number of electrons.
        """
        # Far beyond any full well, but finite, so that 0 times it is 0 for any exposure.
        light = min(self.quantum_efficiency * self.photons_per_radiance_ms * exposure_ms, 1e200)
        dark = self.dark_current_e_per_s * exposure_ms * 1e-3
        return np.asarray(radiance, dtype=np.float64) * light + dark

    def signal_dn(self, radiance: ArrayLike, exposure_ms: float) -> NDArray[np.float64]:
        """As of every sensor."""
        return self.gain_dn_per_e * self.mean_electrons(radiance, exposure_ms)

    def noise_model(self, exposure_ms: float = 0.0) -> tuple[float, float]:
        """As of every sensor."""
        constant = (self.gain_dn_per_e * self.read_noise_e) ** 2 + self.rounding_variance_dn2
        return constant, self.gain_dn_per_e


Sensor = Annotated[SimpleSensor | Emva, Field(discriminator="kind")]


def without_blur(sensor: Sensor) -> Sensor:
    """The sensor behind a lens that does not blur."""
    if not isinstance(sensor, Emva) or not sensor.blurs:
        return sensor
    return sensor.model_copy(update={"psf": "none", "psf_sigma_um": 0.0})
