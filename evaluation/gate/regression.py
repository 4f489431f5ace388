"""Figures of a decoder on one case over repeats, and their comparison with a baseline's.

Less is better for all of them. Per region:

- ``bias_mm``: absolute value of the mean error;
- ``systematic_mm``: root mean square over pixels of each pixel's own bias, noise removed. The mean of a ripple is 0, this is not;
- ``wrong_order_fraction``: valid pixels whose error exceeds a quarter of a fringe, whatever sigma they claim;
- ``silent_fraction``: valid pixels whose error exceeds `SILENT_SIGMAS` times their claimed sigma;
- ``missing_fraction``: pixels not declared valid, so that rejecting everything does not help;
- ``beyond_1_sigma_fraction``, ``beyond_2_``, ``beyond_3_``: valid pixels of right order whose error exceeds that many claimed
  sigmas, which a sigma claimed too small raises;
- ``excess_sigma_mm``: by how much the root mean square of the claimed sigmas exceeds that of the errors, which a sigma claimed
  too large raises; each counts as a quarter of a fringe at most, an unknown one as just that.

Wrong orders are left out of bias, systematic error and the figures of sigma, which are given where at least 30 pixels
(200 for sigma) and 5 % of the region are valid in every repeat. Two figures are stored with them and not judged: ``noise_mm``,
the standard deviation of a pixel over repeats, says how small an error matters; ``sharpness_mm`` is the root mean square of the
claimed sigmas. Unlit pixels, where a height is an invention, have
``silent_fraction`` and ``invented_fraction``, the share declared valid.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from evaluation.gate.equivalence import EquivalenceTest, Estimate, compare, mean_square_bias

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Figures = dict[str, dict[str, Estimate]]
"""Region -> metric -> estimate."""

SILENT_SIGMAS = 5.0
# A quarter of a fringe, in phase.
GROSS_RAD = np.pi / 2
MINIMUM_PIXELS, MINIMUM_SHARE = 30, 0.05
# With fewer pixels the share beyond one sigma scatters by more than its margin.
MINIMUM_PIXELS_SIGMA = 200
# Shares of a Gaussian beyond 1, 2 and 3 standard deviations.
GAUSSIAN_BEYOND = {f"beyond_{k}_sigma_fraction": float(2.0 * norm.sf(k)) for k in (1, 2, 3)}
NOT_JUDGED = frozenset({"noise_mm", "sharpness_mm"})
# Pixels of no region: shadow, and where the camera sees nothing. A height there is an invention.
UNLIT = "unlit"


@dataclass(frozen=True)
class Margins:
    """By how much a figure may get worse.

    Parameters
    ----------
    error_rad
        Margin of bias and systematic error, as a phase; each case's geometry turns it into a height. 0.01 rad is what
        clipping by 8 % does to the four-step phase (`evaluation.saturation_bias`).
    bias_noises, systematic_noises
        The same as multiples of a pixel's noise; the larger margin applies. Where single heights scatter by more than
        `error_rad`, a bias of a tenth of their noise or a systematic error of half of it is harmless.
    wrong_order_fraction, silent_fraction, missing_fraction, invented_fraction
        Margins of the shares of pixels, 0 to 1.
    beyond_sigma_fractions
        Margins of the shares beyond 1, 2 and 3 claimed sigmas. 5 % beyond one sigma is what a sigma 10 % too small does.
    excess_sigma_noises
        Margin of a sigma claimed too large, as a multiple of a pixel's noise.
    """

    error_rad: float = 0.01
    bias_noises: float = 0.1
    systematic_noises: float = 0.5
    wrong_order_fraction: float = 0.005
    silent_fraction: float = 0.02
    missing_fraction: float = 0.02
    invented_fraction: float = 0.02
    beyond_sigma_fractions: tuple[float, float, float] = (0.05, 0.03, 0.02)
    excess_sigma_noises: float = 0.1

    def of(self, metric: str, mm_per_rad: float, noise_mm: float) -> float:
        """Margin of a metric in its own unit; `mm_per_rad` is the case's height per phase, `noise_mm` a pixel's noise."""
        if metric == "bias_mm":
            return max(self.error_rad * mm_per_rad, self.bias_noises * noise_mm)
        if metric == "systematic_mm":
            return max(self.error_rad * mm_per_rad, self.systematic_noises * noise_mm)
        if metric == "excess_sigma_mm":
            return max(0.1 * self.error_rad * mm_per_rad, self.excess_sigma_noises * noise_mm)
        if metric in GAUSSIAN_BEYOND:
            return self.beyond_sigma_fractions[list(GAUSSIAN_BEYOND).index(metric)]
        return float(getattr(self, metric))


def measure(
    height_mm: Floats,
    sigma_mm: Floats,
    true_mm: Floats,
    regions: Mapping[str, Mask],
    unlit: Mask,
    mm_per_rad: float,
) -> Figures:
    """Figures of a case by region, from heights and claimed sigmas (repeat, row, col), heights NaN where not valid.

    `unlit` are the pixels (row, col) without a region because no light reaches them. Raises `ScoreError` for fewer than
    three repeats.
    """
    error = height_mm - true_mm
    valid = np.isfinite(height_mm)
    silent = valid & ~(np.abs(error) <= SILENT_SIGMAS * sigma_mm)
    gross_mm = GROSS_RAD * mm_per_rad
    wrong_order = valid & ~(np.abs(error) <= gross_mm)
    small = np.where(wrong_order, np.nan, error)
    claimed = np.where(sigma_mm <= gross_mm, sigma_mm, gross_mm)
    found: Figures = {}
    for name, region in regions.items():
        if not region.any():
            continue
        figures = {
            "wrong_order_fraction": Estimate.of(wrong_order[:, region].mean(axis=1)),
            "silent_fraction": Estimate.of(silent[:, region].mean(axis=1)),
            "missing_fraction": Estimate.of(1.0 - valid[:, region].mean(axis=1)),
        }
        figures |= _errors(small[:, region])
        figures |= _sigmas(small[:, region], claimed[:, region])
        found[name] = figures
    if unlit.any():
        found[UNLIT] = {
            "silent_fraction": Estimate.of(silent[:, unlit].mean(axis=1)),
            "invented_fraction": Estimate.of(valid[:, unlit].mean(axis=1)),
        }
    return found


def _errors(error: Floats) -> dict[str, Estimate]:
    """Bias, systematic error and noise from errors (repeat, pixel); empty where too few pixels are valid."""
    seen = np.isfinite(error)
    often = seen.sum(axis=0) >= 2
    if _too_few(seen, MINIMUM_PIXELS) or not often.any():
        return {}
    bias = Estimate.of(np.nanmean(error, axis=1))
    noise = np.sqrt(np.mean(np.nanvar(error[:, often], axis=0, ddof=1)))

    def systematic(used: NDArray[np.intp]) -> float:
        return float(np.sqrt(np.nan_to_num(np.maximum(mean_square_bias(error, used), 0.0))))

    return {
        "bias_mm": bias.mirrored() if bias.mean < 0 else bias,
        "systematic_mm": Estimate.jackknife(systematic, len(error)),
        "noise_mm": Estimate(float(noise), 0.0, len(error)),
    }


def _sigmas(error: Floats, claimed: Floats) -> dict[str, Estimate]:
    """Coverage and sharpness of claimed sigmas (repeat, pixel); empty where too few pixels are valid."""
    seen = np.isfinite(error)
    if _too_few(seen, MINIMUM_PIXELS_SIGMA):
        return {}
    count = seen.sum(axis=1)
    found = {
        name: Estimate.of((seen & (np.abs(error) > k * claimed)).sum(axis=1) / count)
        for k, name in enumerate(GAUSSIAN_BEYOND, 1)
    }
    sharpness, actual = (
        np.sqrt(np.where(seen, values**2, 0.0).sum(axis=1) / count) for values in (claimed, error)
    )
    excess = np.maximum(sharpness - actual, 0.0)
    return {**found, "excess_sigma_mm": Estimate.of(excess), "sharpness_mm": Estimate.of(sharpness)}


def _too_few(seen: Mask, pixels: int) -> bool:
    """Whether a repeat has fewer valid pixels (repeat, pixel) than statistics need."""
    return bool(seen.sum(axis=1).min() < max(pixels, MINIMUM_SHARE * seen.shape[1]))


@dataclass(frozen=True)
class JudgedFigure:
    """One figure compared with the baseline's."""

    case: str
    region: str
    metric: str
    new: Estimate
    old: Estimate
    comparison: EquivalenceTest


def compare_with_baseline(
    case: str,
    new: Figures,
    old: Figures,
    mm_per_rad: float,
    margins: Margins,
    confidence: float,
    paired: bool = False,
) -> list[JudgedFigure]:
    """Compare every figure of a case with the baseline's; `paired`: both come from the same seeds.

    Figures that the baseline lacks are compared with those of a perfect decoder: 0, or a Gaussian's shares. Heights no
    longer given show in ``missing_fraction``.
    """
    rows = []
    for region, figures in new.items():
        noise = min(
            (f["noise_mm"].mean for f in (figures, old.get(region, {})) if "noise_mm" in f),
            default=0.0,
        )
        for metric, estimate in figures.items():
            if metric in NOT_JUDGED:
                continue
            known = old.get(region, {})
            perfect = Estimate(GAUSSIAN_BEYOND.get(metric, 0.0), 0.0, estimate.repeats)
            before = known.get(metric, perfect)
            margin = margins.of(metric, mm_per_rad, noise)
            rows.append(
                JudgedFigure(
                    case,
                    region,
                    metric,
                    estimate,
                    before,
                    compare(estimate, before, margin, confidence, paired),
                )
            )
    return rows
