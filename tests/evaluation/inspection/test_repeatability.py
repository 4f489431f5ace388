"""Gauge studies: AIAG's own example, known variance components, and limits."""

import numpy as np
import pytest
from scipy import stats

from evaluation.inspection.repeatability import capability, gauge_study
from scenes.support.errors import ScoreError

# AIAG, Measurement Systems Analysis, 4th edition, figure III-B 15 and table III-B 7: 10 parts, 3 appraisers, 3 trials.
AIAG = np.array(
    [
        [
            [0.29, -0.56, 1.34, 0.47, -0.80, 0.02, 0.59, -0.31, 2.26, -1.36],
            [0.41, -0.68, 1.17, 0.50, -0.92, -0.11, 0.75, -0.20, 1.99, -1.25],
            [0.64, -0.58, 1.27, 0.64, -0.84, -0.21, 0.66, -0.17, 2.01, -1.31],
        ],
        [
            [0.08, -0.47, 1.19, 0.01, -0.56, -0.20, 0.47, -0.63, 1.80, -1.68],
            [0.25, -1.22, 0.94, 1.03, -1.20, 0.22, 0.55, 0.08, 2.12, -1.62],
            [0.07, -0.68, 1.34, 0.20, -1.28, 0.06, 0.83, -0.34, 2.19, -1.50],
        ],
        [
            [0.04, -1.38, 0.88, 0.14, -1.46, -0.29, 0.02, -0.46, 1.77, -1.49],
            [-0.11, -1.13, 1.09, 0.20, -1.07, -0.67, 0.01, -0.56, 1.45, -1.77],
            [-0.15, -0.96, 0.67, 0.11, -1.45, -0.49, 0.21, -0.49, 1.87, -2.16],
        ],
    ]
).transpose(2, 0, 1)


def test_aiag_example_matches_to_its_last_printed_digit() -> None:
    study = gauge_study(AIAG, tolerance=8.0)
    rows = [
        (study.parts, 9, 88.3619, 9.81799, 492.291),
        (study.appraisers, 2, 3.1673, 1.58363, 79.406),
        (study.interaction, 18, 0.3590, 0.01994, 0.434),
        (study.repeatability, 60, 2.7589, 0.04598, None),
    ]
    for row, degrees, squares, mean_square, f in rows:
        assert row.degrees == degrees
        assert row.sum_of_squares == pytest.approx(squares, abs=5e-5)
        assert row.mean_square == pytest.approx(mean_square, abs=5e-6)
        assert row.f is None if f is None else row.f == pytest.approx(f, abs=5e-4)
    assert study.interaction.p == pytest.approx(0.974, abs=5e-4)
    assert study.pooled
    for found, printed in (
        (study.ev, 0.199933),
        (study.av, 0.226838),
        (study.interaction_sd, 0.0),
        (study.grr, 0.302373),
        (study.pv, 1.042327),
        (study.tv, 1.085),
    ):
        # The manual adds up figures it has rounded to six digits.
        assert found == pytest.approx(printed, abs=5e-4 if printed == 1.085 else 2e-6)
    assert study.grr_percent_of_study == pytest.approx(27.9, abs=0.05)
    assert study.distinct_categories == 4
    assert study.grr_percent_of_tolerance == pytest.approx(100 * 6 * 0.302373 / 8.0, abs=1e-3)


def test_known_variances_are_found_within_their_chi_square_bounds() -> None:
    rng = np.random.default_rng(5)
    p, a, r = 200, 40, 5
    sd = {"part": 2.0, "appraiser": 0.5, "both": 0.3, "repeat": 0.2}
    x = (
        rng.normal(0, sd["part"], (p, 1, 1))
        + rng.normal(0, sd["appraiser"], (1, a, 1))
        + rng.normal(0, sd["both"], (p, a, 1))
        + rng.normal(0, sd["repeat"], (p, a, r))
    )
    study = gauge_study(x)
    assert not study.pooled

    expected = {
        "repeatability": sd["repeat"] ** 2,
        "interaction": sd["repeat"] ** 2 + r * sd["both"] ** 2,
    }
    expected["appraisers"] = expected["interaction"] + p * r * sd["appraiser"] ** 2
    expected["parts"] = expected["interaction"] + a * r * sd["part"] ** 2
    for name, mean_square in expected.items():
        row = getattr(study, name)
        # A mean square is its expectation times chi-square over its degrees of freedom; 1e-6 of chance to lie outside.
        low, high = stats.chi2.ppf([5e-7, 1 - 5e-7], row.degrees) / row.degrees
        assert low < row.mean_square / mean_square < high
    # The components are those mean squares' differences.
    for found, name, below, count in (
        (study.interaction_sd, "interaction", "repeatability", r),
        (study.av, "appraisers", "interaction", p * r),
        (study.pv, "parts", "interaction", a * r),
    ):
        apart = getattr(study, name).mean_square - getattr(study, below).mean_square
        assert found == pytest.approx(np.sqrt(apart / count))


def test_significant_interaction_is_not_pooled() -> None:
    rng = np.random.default_rng(6)
    x = rng.normal(0, 1, (10, 3, 1)) + rng.normal(0, 0.1, (10, 3, 3))
    study = gauge_study(x)
    assert not study.pooled
    assert study.interaction_sd > 5 * study.ev
    assert study.reproducibility >= study.interaction_sd


def test_ideal_gauge_has_no_error_and_no_nan() -> None:
    study = gauge_study(np.broadcast_to(np.arange(5.0)[:, None, None], (5, 3, 2)), tolerance=1.0)
    assert study.grr == 0.0
    assert study.grr_percent_of_tolerance == 0.0
    assert study.pv == pytest.approx(np.std(np.arange(5.0), ddof=1))
    assert not any(isinstance(v, float) and np.isnan(v) for v in study.to_dict().values())


def test_cg_counts_spread_and_cgk_bias_too() -> None:
    values = np.array([9.0, 11.0] * 10)
    sd = values.std(ddof=1)
    found = capability(values, reference=10.5, tolerance=100.0)
    assert found.cg == pytest.approx(0.2 * 100 / (6 * sd))
    assert found.cgk == pytest.approx((10.0 - 0.5) / (3 * sd))
    assert found.bias == pytest.approx(-0.5)
    # Nothing but bias: at a tenth of the tolerance there is no room left.
    assert capability(values, 20.0, 100.0).cgk == pytest.approx(0.0, abs=1e-12)
    assert capability(np.full(3, 1.0), 1.0, 1.0).cgk == np.inf


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((5, 3)), "shape"),
        (np.zeros((5, 1, 3)), "2 or more"),
        (np.full((5, 2, 2), np.nan), "20 of 20 measurements are missing"),
    ],
)
def test_impossible_studies_are_refused(values: np.ndarray, message: str) -> None:
    with pytest.raises(ScoreError, match=message):
        gauge_study(values)


@pytest.mark.parametrize("values", [[1.0], [1.0, np.nan, 2.0], [[1.0, 2.0], [1.0, 2.0]]])
def test_capability_needs_finite_measurements_of_one_part(values: list[float]) -> None:
    with pytest.raises(ScoreError, match="give 2 or more finite ones of one part"):
        capability(values, 1.0, 1.0)


def test_capability_needs_a_tolerance() -> None:
    with pytest.raises(ScoreError, match="tolerance = 0"):
        capability([1.0, 2.0], 1.0, 0.0)
    with pytest.raises(ScoreError, match="tolerance = -1"):
        gauge_study(AIAG, tolerance=-1.0)
