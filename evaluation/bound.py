"""How well a phase could be known: the Cramer-Rao bound of the frames taken, and how near a decoder comes to it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import log_ndtr, ndtr

from scenes.errors import ScoreError
from scenes.patterns import Axis, Frame
from scenes.sensor import Sensor

Image = NDArray[np.float64]

# Two-sided confidence of every interval.
CONFIDENCE = 0.95
# Beyond this many sigma from its limit a sample is sure to be clipped, or sure not to be, to 1e-15.
SURE = 8.0


@dataclass(frozen=True, eq=False)
class FringeLight:
    """The noise-free light of one fringe set, W/(m^2 sr): ``offset + cosine cos(delta) - sine sin(delta)`` of each pixel.

    Images (row, col). With light linear this is exact for any phase shift, interreflections included.
    """

    offset: Image
    cosine: Image
    sine: Image

    @classmethod
    def of(
        cls, radiance: NDArray[np.floating], frames: Sequence[Frame], axis: Axis, period_px: float
    ) -> "FringeLight":
        """From the radiance (frame, row, col) of a projector's frames. Raises `ScoreError` if they lack that fringe."""
        mine = [i for i, f in enumerate(frames) if f.axis == axis and f.period_px == period_px]
        shifts = np.array([frames[i].phase_shift_rad for i in mine])
        design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
        if np.linalg.matrix_rank(design, tol=1e-6) < 3:
            raise ScoreError(
                f"no {axis} fringe of {period_px:g} px with three different phase shifts among the frames"
            )
        rows = np.linalg.pinv(design)
        return cls(*np.tensordot(rows, np.asarray(radiance, np.float64)[mine], axes=1))

    def at(self, shift_rad: float) -> Image:
        """Radiance under a phase shift."""
        wave = self.cosine * np.cos(shift_rad) - self.sine * np.sin(shift_rad)
        return np.asarray(self.offset + wave)

    @property
    def phase_rad(self) -> Image:
        """The phase that noise-free light has, in [-pi, pi]."""
        return np.arctan2(self.sine, self.cosine)


def phase_bound_rad2(
    light: FringeLight,
    shifts_rad: Sequence[float],
    exposure_ms: Sequence[float],
    sensor: Sensor,
    level: float | Image = 1.0,
    censored: bool = True,
) -> Image:
    """Least variance (row, col) of an unbiased phase from these frames, offset and modulation unknown; inf where none.

    Every phase shift is taken at every exposure time; `level` dims the light. A sample of mean mu and variance v tells
    ``1/v`` about mu while it cannot be clipped. Clipped ones are, with `censored`, known to be so, and tell what a
    censored Gaussian sample tells, ``(phi^2/(1 - Phi) - z phi + Phi) / v`` with z the limit's distance in sigma; without,
    nothing. That v depends on mu tells next to nothing more (``1/2`` an electron's worth per sample) and is left out:
    for pure shot noise ``1/v`` is exact.
    """
    moments = np.zeros((3, 3, *light.offset.shape))
    for shift in shifts_rad:
        radiance = light.at(shift) * level
        wave = np.array([1.0, np.cos(shift), -np.sin(shift)])
        known = np.zeros_like(light.offset)
        for time_ms, count in Counter(exposure_ms).items():
            dn_per_light = float(sensor.mean_dn(1.0, time_ms) - sensor.mean_dn(0.0, time_ms))
            slope = dn_per_light * np.asarray(level)
            known += count * slope**2 * _information(sensor, radiance, time_ms, censored)
        moments += np.multiply.outer(np.outer(wave, wave), known)
    # The offset is eliminated; the phase moves across the phasor.
    with np.errstate(divide="ignore", invalid="ignore"):
        xx = moments[1, 1] - moments[0, 1] ** 2 / moments[0, 0]
        xy = moments[1, 2] - moments[0, 1] * moments[0, 2] / moments[0, 0]
        yy = moments[2, 2] - moments[0, 2] ** 2 / moments[0, 0]
        c, s = light.cosine, light.sine
        across = s**2 * yy + 2.0 * c * s * xy + c**2 * xx
        bound = across / ((xx * yy - xy**2) * (c**2 + s**2) ** 2)
    return np.where(np.isfinite(bound) & (bound > 0.0), bound, np.inf)


def _information(sensor: Sensor, radiance: Image, time_ms: float, censored: bool) -> Image:
    """What one sample tells about its mean, 1/DN^2."""
    mean = sensor.mean_dn(radiance, time_ms)
    variance = sensor.variance_dn2(mean, time_ms)
    rounding = 0.5 if sensor.bits else 0.0
    sigma = np.sqrt(variance)
    upper = np.clip((sensor.saturation_dn - rounding - mean) / sigma, -SURE, SURE)
    inside, edges = ndtr(upper), np.zeros_like(mean)
    edges += _edge(upper)
    if sensor.bits:
        lower = np.clip((rounding - mean) / sigma, -SURE, SURE)
        inside = inside - ndtr(lower)
        edges += _edge(-lower)
    told = inside + edges if censored else inside
    return np.asarray(np.maximum(told, 0.0) / variance)


def _edge(z: Image) -> Image:
    """What is added at a limit z sigma away: the clipped samples' knowledge less the lost tail's."""
    told = np.zeros_like(z)
    near = np.abs(z) < SURE
    x = z[near]
    log_density = -0.5 * x**2 - 0.5 * np.log(2.0 * np.pi)
    told[near] = np.exp(log_density) * (np.exp(log_density - log_ndtr(-x)) - x)
    return told


@dataclass(frozen=True)
class Efficiency:
    """Over some pixels: bound over variance, and the bias that repeats leave."""

    pixels: int
    """Pixels with a phase in every repeat and a finite bound."""
    value: float
    """1 / mean over pixels of (variance / bound); 1 is as good as can be."""
    half_width: float
    """Of its confidence interval, from the scatter over pixels."""
    bias_rad: float
    """Root mean square over pixels of the mean error, with what noise leaves in it taken off."""
    variance_ratio: NDArray[np.float64]
    """Variance over bound of each pixel."""


def efficiency(
    error_rad: NDArray[np.floating], bound_rad2: NDArray[np.floating]
) -> Efficiency | None:
    """Bound over variance reached, from phase errors (repeat, pixel) of at least two repeats and the pixels' bounds.

    Errors are those of the wrapped phase, so that a wrong fringe order, which is no noise, does not enter. NaN marks a
    pixel without a phase. None where no pixel can be judged.
    """
    repeats = len(error_rad)
    if repeats < 2:
        raise ScoreError(f"{repeats} repeats: a variance needs at least 2")
    turned = np.angle(np.exp(1j * np.asarray(error_rad, np.float64)))
    good = np.isfinite(turned).all(axis=0) & np.isfinite(bound_rad2)
    if not good.any():
        return None
    turned, bound = turned[:, good], np.asarray(bound_rad2, np.float64)[good]
    variance = turned.var(axis=0, ddof=1)
    ratio = variance / bound
    n = ratio.size
    mean = float(ratio.mean())
    spread = float(ratio.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    quantile = float(stats.norm.ppf(0.5 + CONFIDENCE / 2.0))
    bias2 = np.mean(turned.mean(axis=0) ** 2 - variance / repeats)
    value = 1.0 / mean if mean > 0.0 else float("inf")
    return Efficiency(
        n, value, quantile * spread * value**2, float(np.sqrt(max(bias2, 0.0))), ratio
    )
