"""Distributions in a scene file: what they draw, what is refused."""

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy import stats

from scenes.support.distribution import (
    Choice,
    Fraction,
    LogNormal,
    NonNegative,
    Normal,
    Quantity,
    TruncatedNormal,
    Uniform,
    draw,
    value_range,
)

DRAWS = 4000
# A correct sampler fails a Kolmogorov-Smirnov test at this level once in a million runs; seeds are fixed anyway.
LEVEL = 1e-6


@pytest.mark.parametrize(
    ("quantity", "law"),
    [
        (Uniform(low=-1.0, high=3.0), stats.uniform(-1.0, 4.0)),
        (Normal(mean=2.0, sd=0.5), stats.norm(2.0, 0.5)),
        (
            TruncatedNormal(mean=1.0, sd=0.5, low=0.8, high=2.5),
            stats.truncnorm(-0.4, 3.0, loc=1.0, scale=0.5),
        ),
        (LogNormal(median=0.3, sigma=0.4), stats.lognorm(0.4, scale=0.3)),
    ],
)
def test_draws_follow_the_stated_law(quantity: Quantity, law: stats.rv_continuous) -> None:
    rng = np.random.default_rng(5)
    values = [draw(quantity, rng) for _ in range(DRAWS)]
    assert stats.kstest(values, law.cdf).pvalue > LEVEL
    low, high = value_range(quantity)
    assert low <= min(values) <= max(values) <= high


def test_range_of_choices_is_that_of_their_numbers() -> None:
    assert value_range(Choice(values=(3, -1.5, 2.0))) == (-1.5, 3.0)
    assert np.isnan(value_range(Choice(values=(3, "a")))).all()


def test_choices_are_drawn_by_weight() -> None:
    choice = Choice(values=("a", [1, 2], 3.0), weights=(1.0, 2.0, 5.0))
    rng = np.random.default_rng(1)
    drawn = [choice.draw(rng) for _ in range(DRAWS)]
    observed = [sum(d == value for d in drawn) for value in choice.values]
    expected = np.array([1.0, 2.0, 5.0]) / 8 * DRAWS
    assert stats.chisquare(observed, expected).pvalue > LEVEL


def test_numbers_and_tables_survive_validation() -> None:
    adapter: TypeAdapter[Quantity] = TypeAdapter(Quantity)
    assert adapter.validate_python(0.25) == 0.25
    assert adapter.dump_python(adapter.validate_python(1), mode="json") == 1.0
    table = {"kind": "uniform", "low": 0.0, "high": 1.0}
    assert adapter.dump_python(adapter.validate_python(table), mode="json") == table


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"kind": "normal", "mean": 1.0, "sd": 0.1}, "use truncated-normal"),
        (-0.1, "0 to inf is allowed"),
        ({"kind": "uniform", "low": 2.0, "high": 1.0}, "must be below"),
        ({"kind": "gauss", "mean": 1.0}, "truncated-normal, lognormal or choice"),
        ({"low": 0.0, "high": 1.0}, "give a number, or a table with kind"),
        (
            {"kind": "truncated-normal", "mean": 0.0, "sd": 0.1, "low": 5.0, "high": 6.0},
            "beyond 6 sd",
        ),
        ({"kind": "choice", "values": [1.0, "x"]}, "can take values from nan"),
        ({"kind": "choice", "values": [1.0], "weights": [0.0]}, "not all 0"),
    ],
)
def test_quantity_that_could_leave_its_range_is_refused(value: object, message: str) -> None:
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(NonNegative).validate_python(value)
    assert message in str(caught.value)


def test_fraction_may_be_from_zero_to_one_and_no_more() -> None:
    whole = Uniform(low=0.0, high=1.0)
    assert TypeAdapter(Fraction).validate_python(whole) == whole
    with pytest.raises(ValidationError, match="0 to 1 is allowed"):
        TypeAdapter(Fraction).validate_python(1.2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_interval_of_a_truncated_normal_may_begin_six_deviations_off_and_no_farther(
    side: float,
) -> None:
    for near, allowed in ((6.0, True), (6.01, False)):
        low, high = sorted((side * near, side * 9.0))
        keys = {"kind": "truncated-normal", "mean": 0.0, "sd": 1.0, "low": low, "high": high}
        if allowed:
            TruncatedNormal.model_validate(keys)
            continue
        with pytest.raises(ValidationError, match="beyond 6 sd"):
            TruncatedNormal.model_validate(keys)
