from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from evaluation.gate.equivalence import Estimate, compare, mean_square_bias
from scenes.support.errors import ScoreError


def test_figure_worse_by_the_margin_passes_as_rarely_as_promised() -> None:
    """At a true difference of exactly the margin, non-inferiority is shown with probability 1 - confidence at most."""
    rng = np.random.default_rng(5)
    passed = [
        compare(
            Estimate.of(rng.normal(0.3, 1, 8)), Estimate.of(rng.normal(0, 1, 8)), 0.3, 0.95
        ).passed
        for _ in range(2000)
    ]
    # 5 %, with four standard deviations of 2000 draws
    assert np.mean(passed) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 2000)
    assert np.mean(passed) > 0.02


def test_paired_test_keeps_its_error_rate_and_has_more_power() -> None:
    """As above for figures that share most of their noise, of which the jackknife's is one."""
    rng = np.random.default_rng(9)

    def spread(sample: np.ndarray) -> Estimate:
        return Estimate.jackknife(lambda used: float(sample[used].std()), len(sample))

    def passed(of: Callable[[np.ndarray], Estimate], shift: float, paired: bool) -> float:
        verdicts = []
        for _ in range(1000):
            shared, own = rng.normal(0, 1, 12), rng.normal(0, 0.1, (2, 12))
            new, old = of(shared + shift + own[0]), of(shared + own[1])
            verdicts.append(compare(new, old, 0.3, 0.95, paired=paired).passed)
        return float(np.mean(verdicts))

    # 5 %, with four standard deviations of 1000 draws
    assert 0.02 < passed(Estimate.of, 0.3, paired=True) < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 1000)
    # The difference scatters by 0.04, a seventh of the margin; unpaired by 0.41.
    for of in (Estimate.of, spread):
        assert passed(of, 0.0, paired=True) > 0.99
        assert passed(of, 0.0, paired=False) < 0.5


def test_figures_without_values_are_compared_unpaired() -> None:
    new, old = Estimate(0.1, 0.1, 9), Estimate.of([0.0, 0.1, 0.2])
    for margin in (0.05, 0.5):
        assert compare(new, old, margin, paired=True) == compare(new, old, margin)


@pytest.mark.parametrize("paired", [False, True])
def test_interval_is_that_of_the_t_test_of_scipy(paired: bool) -> None:
    """Welch's, of samples that differ in size and scatter, or of pairs. One-sided at 95 % is two-sided at 90 %."""
    rng = np.random.default_rng(3)
    new, old = rng.normal(0.3, 2.0, 6), rng.normal(0.0, 1.0, 6 if paired else 11)
    found = compare(Estimate.of(new), Estimate.of(old), 1.0, 0.95, paired)
    test = stats.ttest_rel(new, old) if paired else stats.ttest_ind(new, old, equal_var=False)
    assert (found.lower, found.upper) == pytest.approx(tuple(test.confidence_interval(0.9)))


def test_mirrored_figures_give_the_mirrored_interval() -> None:
    one, two = Estimate.of([0.1, 0.3, 0.2]), Estimate.of([0.2, 0.2, 0.5])
    there = compare(one, two, 1.0, paired=True)
    back = compare(one.mirrored(), two.mirrored(), 1.0, paired=True)
    assert (there.lower, there.upper) == pytest.approx((-back.upper, -back.lower))


def test_equal_figures_pass_with_enough_repeats_only() -> None:
    rng = np.random.default_rng(6)
    for repeats, verdict in ((400, "same"), (3, "undecided")):
        new, old = (Estimate.of(rng.normal(0, 1, repeats)) for _ in range(2))
        assert compare(new, old, margin=0.4).verdict == verdict


def test_identical_figures_without_scatter_are_the_same() -> None:
    assert compare(Estimate(0.1, 0, 5), Estimate(0.1, 0, 5), margin=1e-9).verdict == "same"


def test_improvement_needs_more_than_chance() -> None:
    assert compare(Estimate(0.0, 0.01, 9), Estimate(1.0, 0.01, 9), margin=0.5).verdict == "better"
    assert compare(Estimate(0.0, 0.9, 9), Estimate(1.0, 0.9, 9), margin=0.5).verdict == "undecided"


def test_mean_square_bias_leaves_noise_out() -> None:
    rng = np.random.default_rng(7)
    bias = rng.normal(0, 0.3, 20_000)
    errors = bias + rng.normal(0, 1.0, (6, bias.size))
    errors[rng.random(errors.shape) < 0.2] = np.nan
    found = mean_square_bias(errors, range(6))
    # A pair's product scatters by 1; some 10 pairs a pixel, not independent: a pixel by at most 1/2.
    assert found == pytest.approx(np.mean(bias**2), abs=4 * 0.5 / np.sqrt(bias.size))
    assert np.isnan(mean_square_bias(np.full((3, 4), np.nan), range(3)))


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    values = np.random.default_rng(8).normal(size=12)
    ours = Estimate.jackknife(lambda used: float(values[used].mean()), 12)
    assert ours.standard_error == pytest.approx(Estimate.of(values).standard_error, rel=1e-12)


def test_too_few_repeats_and_impossible_margins_are_refused() -> None:
    with pytest.raises(ScoreError, match="at least 2"):
        Estimate.of([1.0])
    with pytest.raises(ScoreError, match="at least 3"):
        Estimate.jackknife(lambda used: 0.0, 2)
    with pytest.raises(ScoreError, match="margin"):
        compare(Estimate(0, 0, 2), Estimate(0, 0, 2), margin=0.0)
