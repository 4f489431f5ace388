"""Distributions, which a scene file may have in place of a number: quantities that vary from sample to sample.

A quantity is a plain number, or a table: ``volume = 1.0`` or ``volume = { kind = "normal", mean = 1.0, sd = 0.1 }``.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    JsonValue,
    PositiveFloat,
    Tag,
    model_validator,
)
from scipy.special import ndtr, ndtri

from scenes.support.frozen import Frozen

Range = tuple[float, float]


class Constant(Frozen):
    """Always the same value."""

    kind: Literal["constant"] = "constant"
    value: float

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give."""
        return self.value, self.value

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return self.value


class Uniform(Frozen):
    """Equally likely anywhere from low to high."""

    kind: Literal["uniform"] = "uniform"
    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low {self.low} must be below high {self.high}")
        return self

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give."""
        return self.low, self.high

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return float(rng.uniform(self.low, self.high))


class Normal(Frozen):
    """Gaussian, without bounds: quantities that have bounds need truncated-normal instead."""

    kind: Literal["normal"] = "normal"
    mean: float
    sd: PositiveFloat

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give."""
        return -np.inf, np.inf

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return float(rng.normal(self.mean, self.sd))


class TruncatedNormal(Frozen):
    """Gaussian of that mean and sd before it is cut to low..high; drawn by inverting its distribution function."""

    kind: Literal["truncated-normal"] = "truncated-normal"
    mean: float
    sd: PositiveFloat
    low: float
    high: float

    @model_validator(mode="after")
    def _holds_probability(self) -> Self:
        if not self.low < self.high:
            raise ValueError(f"low {self.low} must be below high {self.high}")
        # Beyond 6 sd the distribution function is 1 to its ninth digit, and inverting it gives steps.
        if self.low > self.mean + 6 * self.sd or self.high < self.mean - 6 * self.sd:
            raise ValueError(
                f"low..high = {self.low}..{self.high} is beyond 6 sd of mean {self.mean}: move one of them"
            )
        return self

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give."""
        return self.low, self.high

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        below, above = ndtr((np.array([self.low, self.high]) - self.mean) / self.sd)
        value = self.mean + self.sd * ndtri(rng.uniform(below, above))
        return float(np.clip(value, self.low, self.high))


class LogNormal(Frozen):
    """exp of a Gaussian: positive and skewed."""

    kind: Literal["lognormal"] = "lognormal"
    median: PositiveFloat
    sigma: PositiveFloat
    """Standard deviation of the value's natural logarithm."""

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give."""
        return 0.0, np.inf

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return float(self.median * np.exp(rng.normal(0.0, self.sigma)))


class Choice(Frozen):
    """One of the listed values, of any TOML type, by weight."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[JsonValue, ...], Field(min_length=1)]
    weights: tuple[float, ...] | None = None
    """Relative; absent: all equal."""

    @model_validator(mode="after")
    def _weighted(self) -> Self:
        weights = self.weights
        if weights is not None and (
            len(weights) != len(self.values) or min(weights) < 0 or sum(weights) <= 0
        ):
            raise ValueError(
                f"weights {list(weights)}: give {len(self.values)} numbers, none negative, not all 0"
            )
        return self

    @property
    def value_range(self) -> Range:
        """Minimum and maximum value it can give; NaN where a value is not a number."""
        numbers = [
            float(v) if isinstance(v, (int, float)) and not isinstance(v, bool) else np.nan
            for v in self.values
        ]
        return float(np.min(numbers)), float(np.max(numbers))

    def draw(self, rng: np.random.Generator) -> Any:
        """One value."""
        weights = None if self.weights is None else np.divide(self.weights, sum(self.weights))
        return self.values[int(rng.choice(len(self.values), p=weights))]


KINDS = "constant, uniform, normal, truncated-normal, lognormal or choice"

Distribution = Annotated[
    Constant | Uniform | Normal | TruncatedNormal | LogNormal | Choice, Field(discriminator="kind")
]


def _kind(value: Any) -> Any:
    if isinstance(value, dict):
        return value.get("kind")
    return getattr(value, "kind", "number")


Quantity = Annotated[
    Annotated[float, Tag("number")]
    | Annotated[Constant, Tag("constant")]
    | Annotated[Uniform, Tag("uniform")]
    | Annotated[Normal, Tag("normal")]
    | Annotated[TruncatedNormal, Tag("truncated-normal")]
    | Annotated[LogNormal, Tag("lognormal")]
    | Annotated[Choice, Tag("choice")],
    Discriminator(
        _kind,
        custom_error_type="quantity",
        custom_error_message=f"give a number, or a table with kind = {KINDS}",
    ),
]
"""A number, or a distribution it is drawn from."""


def value_range(quantity: Quantity) -> Range:
    """Minimum and maximum value of a quantity."""
    return (quantity, quantity) if isinstance(quantity, (int, float)) else quantity.value_range


def draw(quantity: Quantity, rng: np.random.Generator) -> float:
    """The number itself, or one drawn value.

    >>> draw(2.5, np.random.default_rng(0))
    2.5
    """
    return float(quantity) if isinstance(quantity, (int, float)) else float(quantity.draw(rng))


def within(low: float = -np.inf, high: float = np.inf) -> AfterValidator:
    """A validator that refuses a quantity which could be drawn outside low..high."""

    def check(quantity: Any) -> Any:
        minimum, maximum = value_range(quantity)
        if not (low <= minimum and maximum <= high):
            raise ValueError(
                f"can take values from {minimum:g} to {maximum:g}, but {low:g} to {high:g} is allowed: "
                "move its bounds, or use truncated-normal"
            )
        return quantity

    return AfterValidator(check)


NonNegative = Annotated[Quantity, within(0.0)]
Fraction = Annotated[Quantity, within(0.0, 1.0)]
Draw = Callable[[Quantity], float]
