"""The Cramer-Rao bound of the phase from the frames taken, and the efficiency of a decoder."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.special import log_ndtr, ndtr

from decode.phase import wrap
from scenes.acquisition.fringe_fit import fringe_solution
from scenes.acquisition.patterns import Axis, Frame
from scenes.acquisition.sensor import Sensor
from scenes.support.errors import ScoreError

Image = NDArray[np.float64]

# Two-sided confidence of every interval.
CONFIDENCE = 0.95
# A sample this many sigma beyond a limit is clipped for certain, to 1e-15; likewise not clipped.
CLIPPING_CERTAIN_SIGMAS = 8.0
# Variance of a phase that is uniform over a turn.
UNKNOWN_RAD2 = np.pi**2 / 3.0


@dataclass(frozen=True, eq=False)
class FringeLight:
    """The noise-free light of one fringe set, W/(m^2 sr): ``offset + cosine cos(delta) - sine sin(delta)`` of each pixel.

    Images (row, col). With light linear this is exact for any phase shift, interreflections included.
    """

    offset: Image
    """(row, col) mean over all phase shifts, W/(m^2 sr)."""
    cosine: Image
    """(row, col) factor of ``cos(delta)``, W/(m^2 sr)."""
    sine: Image
    """(row, col) factor of ``-sin(delta)``, W/(m^2 sr)."""

    @classmethod
    def of(
        cls, radiance: NDArray[np.floating], frames: Sequence[Frame], axis: Axis, period_px: float
    ) -> "FringeLight":
        """Fit one fringe set to the radiance of a projector's frames.

        Parameters
        ----------
        radiance
            (frame, row, col) noise-free light, W/(m^2 sr).
        frames
            The frames, in the same order.
        axis, period_px
            Which fringe set: its axis and its period in projector pixels.

        Returns
        -------
        FringeLight
            Images (row, col).

        Raises
        ------
        ScoreError
            If the frames lack that fringe with three different phase shifts.
        """
        mine = [i for i, f in enumerate(frames) if f.axis == axis and f.period_px == period_px]
        shifts = np.array([frames[i].phase_shift_rad for i in mine])
        rows = fringe_solution(shifts)
        if rows is None:
            raise ScoreError(
                f"no {axis} fringe of {period_px:g} px with three different phase shifts among the frames"
            )
        return cls(*np.tensordot(rows, np.asarray(radiance, np.float64)[mine], axes=1))

    def at(self, shift_rad: float) -> Image:
        """Radiance under a phase shift.

        Parameters
        ----------
        shift_rad
            Phase shift, rad.

        Returns
        -------
        ndarray of float64, (row, col)
            Radiance, W/(m^2 sr).
        """
        wave = self.cosine * np.cos(shift_rad) - self.sine * np.sin(shift_rad)
        return np.asarray(self.offset + wave)

    @property
    def phase_rad(self) -> Image:
        """Phase (row, col) of the noise-free light, in [-pi, pi]."""
        return np.arctan2(self.sine, self.cosine)


def phase_bound_rad2(
    light: FringeLight,
    shifts_rad: Sequence[float],
    exposure_ms: Sequence[float],
    sensor: Sensor,
    levels: Sequence[float] = (),
    censored: bool = True,
) -> Image:
    """Minimum variance of an unbiased phase estimate from these frames, with offset and modulation unknown.

    Parameters
    ----------
    light
        The noise-free fringe of each pixel.
    shifts_rad
        Phase shifts; each is taken at every exposure time.
    exposure_ms
        Exposure times.
    sensor
        The camera's sensor.
    levels
        What dims the light of each exposure, factors in (0, 1]; empty: 1.
    censored
        Whether the estimate uses the knowledge that a clipped sample is clipped; otherwise clipped samples are discarded.

    Returns
    -------
    ndarray of float64, (row, col)
        Variance in rad^2; inf where the frames do not determine a phase.

    Notes
    -----
    A sample of mean mu and variance v carries the Fisher information ``1/v`` about mu while it cannot be clipped, and
    ``(phi^2/(1 - Phi) - z phi + Phi) / v`` as a censored Gaussian sample, z being the distance to the limit in sigma. The
    information in the dependence of v on mu (half an electron's worth per sample) is neglected: for pure shot noise ``1/v``
    is exact.
    """
    moments = np.zeros((3, 3, *light.offset.shape))
    taken = Counter(zip(exposure_ms, levels or [1.0] * len(exposure_ms), strict=True))
    for shift in shifts_rad:
        radiance = light.at(shift)
        wave = np.array([1.0, np.cos(shift), -np.sin(shift)])
        known = np.zeros_like(light.offset)
        for (time_ms, level), count in taken.items():
            slope = level * float(sensor.mean_dn(1.0, time_ms) - sensor.mean_dn(0.0, time_ms))
            known += count * slope**2 * _information(sensor, radiance * level, time_ms, censored)
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
    """Fisher information of one sample about its mean, 1/DN^2."""
    mean = sensor.mean_dn(radiance, time_ms)
    variance = sensor.variance_dn2(mean, time_ms)
    rounding = 0.5 if sensor.bits else 0.0
    sigma = np.sqrt(variance)
    upper = np.clip(
        (sensor.saturation_dn - rounding - mean) / sigma,
        -CLIPPING_CERTAIN_SIGMAS,
        CLIPPING_CERTAIN_SIGMAS,
    )
    inside, edges = ndtr(upper), np.zeros_like(mean)
    edges += _edge(upper)
    if sensor.bits:
        lower = np.clip(
            (rounding - mean) / sigma, -CLIPPING_CERTAIN_SIGMAS, CLIPPING_CERTAIN_SIGMAS
        )
        inside = inside - ndtr(lower)
        edges += _edge(-lower)
    information = inside + edges if censored else inside
    return np.asarray(np.maximum(information, 0.0) / variance)


def _edge(z: Image) -> Image:
    """Information gained at a limit z sigma away: the clipped samples' minus the lost tail's."""
    gained = np.zeros_like(z)
    near = np.abs(z) < CLIPPING_CERTAIN_SIGMAS
    x = z[near]
    log_density = -0.5 * x**2 - 0.5 * np.log(2.0 * np.pi)
    gained[near] = np.exp(log_density) * (np.exp(log_density - log_ndtr(-x)) - x)
    return gained


@dataclass(frozen=True)
class Efficiency:
    """Efficiency over some pixels (bound over variance), and the bias that remains after averaging repeats."""

    pixels: int
    """Pixels with a phase in every repeat and a bound that says something."""
    value: float
    """1 / mean over pixels of (variance / bound); 1 is the optimum; NaN without pixels."""
    half_width: float
    """Of its confidence interval, from the scatter over pixels."""
    bias_rad: float
    """Root mean square over pixels of the mean error, corrected for the remaining noise, rad."""
    variance_ratio: NDArray[np.float64]
    """Variance over bound of each pixel."""


def efficiency(
    error_rad: NDArray[np.floating], bound_rad2: NDArray[np.floating]
) -> Efficiency | None:
    """Efficiency of a decoder: Cramer-Rao bound over the variance reached.

    Parameters
    ----------
    error_rad
        (repeat, pixel) errors of the wrapped phase, at least two repeats, NaN where there is no phase. Wrapped, so that a
        wrong fringe order, which is no noise, has no effect.
    bound_rad2
        (pixel,) bound on the variance, see `phase_bound_rad2`.

    Returns
    -------
    Efficiency or None
        None where no pixel has a phase in every repeat and a finite bound. Pixels whose bound is above pi^2 / 3, the variance of
        a phase of which nothing is known, count for the bias alone: a fringe that clips in all steps does not scatter.

    Raises
    ------
    ScoreError
        For fewer than two repeats.
    """
    repeats = len(error_rad)
    if repeats < 2:
        raise ScoreError(f"{repeats} repeats: a variance needs at least 2")
    turned = wrap(error_rad)
    good = np.isfinite(turned).all(axis=0) & np.isfinite(bound_rad2)
    if not good.any():
        return None
    turned, bound = turned[:, good], np.asarray(bound_rad2, np.float64)[good]
    variance = turned.var(axis=0, ddof=1)
    ratio = (variance / bound)[bound < UNKNOWN_RAD2]
    n = ratio.size
    mean = float(ratio.mean()) if n else float("nan")
    spread = float(ratio.std(ddof=1) / np.sqrt(n)) if n > 1 else float("inf")
    quantile = float(stats.norm.ppf(0.5 + CONFIDENCE / 2.0))
    bias2 = np.mean(turned.mean(axis=0) ** 2 - variance / repeats)
    value = float("inf") if mean == 0.0 else 1.0 / mean
    return Efficiency(
        n, value, quantile * spread * value**2, float(np.sqrt(max(bias2, 0.0))), ratio
    )
