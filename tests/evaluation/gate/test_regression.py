"""Figures of the gate from heights whose errors are known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation.gate.equivalence import Estimate
from evaluation.gate.regression import (
    GAUSSIAN_BEYOND,
    UNLIT,
    Figures,
    Margins,
    compare_with_baseline,
    measure,
)

SHAPE = (40, 50)
SIGMA_MM = 0.01
MM_PER_RAD = 1.0
REPEATS = 8
EVERYWHERE = {"base": np.ones(SHAPE, bool)}
NOWHERE = np.zeros(SHAPE, bool)


def noise(seed: int = 0) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(0.0, SIGMA_MM, (REPEATS, *SHAPE))


def figures(
    error_mm: NDArray[np.float64],
    sigma_mm: float | NDArray[np.float64] = SIGMA_MM,
    unlit: NDArray[np.bool_] = NOWHERE,
) -> Figures:
    sigma = np.broadcast_to(sigma_mm, error_mm.shape)
    regions = {"base": EVERYWHERE["base"] & ~unlit}
    return measure(error_mm + 5.0, sigma, np.full(SHAPE, 5.0), regions, unlit, MM_PER_RAD)


def mean(found: Figures, metric: str, region: str = "base") -> float:
    return found[region][metric].mean


def test_gaussian_noise_with_its_own_sigma_has_gaussian_coverage() -> None:
    found = figures(noise())
    count = REPEATS * SHAPE[0] * SHAPE[1]
    for metric, share in GAUSSIAN_BEYOND.items():
        # Four standard deviations of a binomial share.
        allowed = 4.0 * np.sqrt(share * (1.0 - share) / count)
        assert mean(found, metric) == pytest.approx(share, abs=allowed)
    # The relative error of a root mean square of n values is 1 / sqrt(2 n); four of them.
    assert mean(found, "excess_sigma_mm") < 4.0 * SIGMA_MM / np.sqrt(2.0 * SHAPE[0] * SHAPE[1])
    assert mean(found, "sharpness_mm") == pytest.approx(SIGMA_MM)


@pytest.mark.parametrize(
    ("factor", "metric"), [(0.5, "beyond_1_sigma_fraction"), (3.0, "excess_sigma_mm")]
)
def test_wrong_sigma_is_worse_than_the_right_one(factor: float, metric: str) -> None:
    found = figures(noise(1), factor * SIGMA_MM)
    rows = compare_with_baseline("c", found, figures(noise()), MM_PER_RAD, Margins(), 0.95)
    assert metric in {row.metric for row in rows if row.comparison.verdict == "worse"}


@pytest.mark.parametrize("claimed", [1e9, np.inf, np.nan])
def test_enormous_or_unknown_sigma_counts_as_a_quarter_fringe(claimed: float) -> None:
    found = figures(noise(), claimed)
    assert mean(found, "sharpness_mm") == pytest.approx(np.pi / 2 * MM_PER_RAD)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("claimed", [SIGMA_MM, 1e9])
def test_wrong_orders_are_counted_on_both_sides_whatever_sigma_claims(
    sign: float, claimed: float
) -> None:
    error = noise()
    error[:, :4] += sign * 2.0 * np.pi * MM_PER_RAD
    found = figures(error, claimed)
    assert mean(found, "wrong_order_fraction") == pytest.approx(4 / SHAPE[0])
    # They take no part in the mean error: 0.1 of them would shift it by 0.6 mm.
    assert mean(found, "bias_mm") < 4.0 * SIGMA_MM / np.sqrt(REPEATS * error[0].size)
    assert mean(found, "silent_fraction") == pytest.approx(0.0 if claimed > 1 else 4 / SHAPE[0])


def test_order_is_wrong_from_a_quarter_fringe_on() -> None:
    limit = np.pi / 2 * MM_PER_RAD  # A fringe is 2 pi.
    for error, share in ((0.999 * limit, 0.0), (1.001 * limit, 1.0), (-1.001 * limit, 1.0)):
        found = figures(np.full((3, *SHAPE), error))
        assert mean(found, "wrong_order_fraction") == share


def test_silent_error_is_beyond_five_sigmas_on_either_side() -> None:
    for factor, share in ((4.99, 0.0), (5.01, 1.0), (-4.99, 0.0), (-5.01, 1.0)):
        found = figures(np.full((3, *SHAPE), factor * SIGMA_MM))
        assert mean(found, "silent_fraction") == share


def test_rejected_pixels_are_missing_and_unlit_heights_invented() -> None:
    unlit = NOWHERE.copy()
    unlit[:10] = True
    error = noise()
    error[:, 10:16] = np.nan
    error[:, :5] = np.nan
    found = figures(error, unlit=unlit)
    assert mean(found, "missing_fraction") == pytest.approx(6 / 30)
    assert mean(found, "invented_fraction", UNLIT) == pytest.approx(0.5)
    assert mean(found, "silent_fraction", UNLIT) == 0.0


def test_bias_is_absolute_and_ripple_is_systematic() -> None:
    down = figures(noise() - 0.5)
    assert mean(down, "bias_mm") == pytest.approx(0.5, abs=1e-3)
    assert all(value > 0.4 for value in down["base"]["bias_mm"].values or ())
    ripple = 0.1 * np.where(np.arange(SHAPE[1]) % 2, 1.0, -1.0)
    found = figures(noise() + ripple)
    assert mean(found, "bias_mm") < 1e-3
    assert mean(found, "systematic_mm") == pytest.approx(0.1, rel=0.01)
    assert mean(found, "noise_mm") == pytest.approx(SIGMA_MM, rel=0.02)


@pytest.mark.parametrize(("pixels", "judged"), [(29, False), (31, False), (100, True)])
def test_errors_are_judged_from_five_percent_and_thirty_pixels_on(
    pixels: int, judged: bool
) -> None:
    """5 % of 2000 pixels are 100; a region of 500 needs 30."""
    error = np.full((3, *SHAPE), np.nan)
    error.reshape(3, -1)[:, :pixels] = 0.01
    assert ("bias_mm" in figures(error)["base"]) == judged
    small = {"base": np.arange(SHAPE[0] * SHAPE[1]).reshape(SHAPE) < 500}
    found = measure(error, np.ones_like(error), np.zeros(SHAPE), small, NOWHERE, MM_PER_RAD)
    assert ("bias_mm" in found["base"]) == (pixels >= 30)
    # The repeat with the fewest pixels decides.
    error[1].reshape(-1)[20:] = np.nan
    assert "bias_mm" not in figures(error)["base"]


def test_margins_are_the_larger_of_phase_and_noise() -> None:
    margins = Margins()
    assert margins.of("bias_mm", 2.0, 0.0) == pytest.approx(0.02)
    assert margins.of("bias_mm", 2.0, 1.0) == pytest.approx(0.1)
    assert margins.of("systematic_mm", 2.0, 0.0) == pytest.approx(0.02)
    assert margins.of("systematic_mm", 2.0, 1.0) == pytest.approx(0.5)
    assert margins.of("excess_sigma_mm", 2.0, 0.0) == pytest.approx(0.002)
    assert margins.of("excess_sigma_mm", 2.0, 1.0) == pytest.approx(0.1)
    assert margins.of("silent_fraction", 2.0, 1.0) == 0.02
    assert margins.of("beyond_2_sigma_fraction", 2.0, 1.0) == 0.03


def test_smaller_noise_of_the_two_sets_the_margin() -> None:
    """A decoder that makes its heights noisy must not widen its own margin."""
    quiet = figures(noise())
    loud = figures(20.0 * noise(), 20.0 * SIGMA_MM)
    rows = compare_with_baseline("c", loud, quiet, MM_PER_RAD, Margins(), 0.95)
    margin = {row.metric: row.comparison.margin for row in rows}["systematic_mm"]
    assert margin == pytest.approx(max(0.01, 0.5 * SIGMA_MM), rel=0.02)


def test_figures_without_a_baseline_are_compared_with_a_perfect_decoder() -> None:
    rows = compare_with_baseline("c", figures(noise()), {}, MM_PER_RAD, Margins(), 0.95)
    old = {row.metric: row.old for row in rows}
    assert old["bias_mm"] == Estimate(0.0, 0.0, REPEATS)
    assert old["beyond_1_sigma_fraction"].mean == pytest.approx(0.3173, abs=1e-4)
    assert not {"noise_mm", "sharpness_mm"} & old.keys()
