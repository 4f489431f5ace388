"""What a decoder did to a case over repeats, in figures that a later run can be held against.

All are such that less is better, per region:

- ``bias_mm``: absolute value of the mean error;
- ``systematic_mm``: root mean square over pixels of each pixel's own bias, noise removed. A ripple has no mean, but has this;
- ``silent_fraction``: pixels declared valid whose error exceeds `SILENT_SIGMAS` times their claimed sigma;
- ``missing_fraction``: pixels not declared valid, so that rejecting everything is no way out.

Errors beyond a quarter of a fringe are wrong orders: they count as silent errors and take no part in the first two, which
are given where at least 30 pixels and 5 % of the region are valid in every repeat. ``noise_mm``, the standard deviation of
a pixel over repeats, comes along: it says how small an error is worth finding.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.equivalence import Comparison, Estimate, compare, mean_square_bias

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Figures = dict[str, dict[str, Estimate]]
"""Region -> metric -> estimate."""

SILENT_SIGMAS = 5.0
# A quarter of a fringe, in phase.
GROSS_RAD = np.pi / 2
FEWEST_PIXELS, LEAST_SHARE = 30, 0.05
# Pixels of no region: shadow, and where the camera sees nothing. A height there is an invention.
UNLIT = "unlit"


@dataclass(frozen=True)
class Margins:
    """By how much a figure may get worse.

    Phases are turned into heights by each case's geometry: 0.01 rad is what clipping by 8 % does to the four-step phase
    (`evaluation.saturation_bias`). Where single heights scatter much more than that, a bias of a tenth of their noise, or a
    systematic error of half of it, does no harm.
    """

    error_rad: float = 0.01
    bias_noises: float = 0.1
    systematic_noises: float = 0.5
    silent_fraction: float = 0.02
    missing_fraction: float = 0.02

    def of(self, metric: str, mm_per_rad: float, noise_mm: float) -> float:
        """The margin in the metric's own unit."""
        if metric == "bias_mm":
            return max(self.error_rad * mm_per_rad, self.bias_noises * noise_mm)
        if metric == "systematic_mm":
            return max(self.error_rad * mm_per_rad, self.systematic_noises * noise_mm)
        return float(getattr(self, metric))


def measure(
    height_mm: Floats,
    sigma_mm: Floats,
    true_mm: Floats,
    regions: Mapping[str, Mask],
    unlit: Mask,
    mm_per_rad: float,
) -> Figures:
    """Figures of one case from heights and sigmas (repeat, row, col), heights NaN where not valid.

    `true_mm` (row, col) is NaN where there is nothing; `unlit` marks pixels that have no region because no light reaches
    them. Raises `ScoreError` for fewer than three repeats.
    """
    error = height_mm - true_mm
    valid = np.isfinite(height_mm)
    silent = valid & ~(np.abs(error) <= SILENT_SIGMAS * sigma_mm)
    small = np.where(np.abs(error) <= GROSS_RAD * mm_per_rad, error, np.nan)
    found: Figures = {}
    for name, region in regions.items():
        if not region.any():
            continue
        figures = {
            "silent_fraction": Estimate.of(silent[:, region].mean(axis=1)),
            "missing_fraction": Estimate.of(1.0 - valid[:, region].mean(axis=1)),
        }
        figures |= _errors(small[:, region])
        found[name] = figures
    if unlit.any():
        found[UNLIT] = {"silent_fraction": Estimate.of(silent[:, unlit].mean(axis=1))}
    return found


def _errors(error: Floats) -> dict[str, Estimate]:
    """Bias, systematic error and noise from errors (repeat, pixel); nothing where too few pixels are valid to tell."""
    seen = np.isfinite(error)
    often = seen.sum(axis=0) >= 2
    few = seen.sum(axis=1).min() < max(FEWEST_PIXELS, LEAST_SHARE * error.shape[1])
    if few or not often.any():
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


@dataclass(frozen=True)
class Row:
    """One figure held against the baseline's."""

    case: str
    region: str
    metric: str
    new: Estimate
    old: Estimate
    comparison: Comparison


def against(
    case: str,
    new: Figures,
    old: Figures,
    mm_per_rad: float,
    margins: Margins,
    confidence: float,
    paired: bool = False,
) -> list[Row]:
    """Every figure of a case against the baseline's; `paired`: both from the same seeds.

    Heights that the baseline never gave are held against perfect ones; heights no longer given are missing, which is a
    figure of its own.
    """
    rows = []
    for region, figures in new.items():
        noise = min(
            (f["noise_mm"].mean for f in (figures, old.get(region, {})) if "noise_mm" in f),
            default=0.0,
        )
        for metric, estimate in figures.items():
            if metric == "noise_mm":
                continue
            before = old.get(region, {}).get(metric, Estimate(0.0, 0.0, estimate.repeats))
            margin = margins.of(metric, mm_per_rad, noise)
            rows.append(
                Row(
                    case,
                    region,
                    metric,
                    estimate,
                    before,
                    compare(estimate, before, margin, confidence, paired),
                )
            )
    return rows
