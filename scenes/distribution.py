"""Distributions that stand in a scene file where a number may: every quantity that varies from sample to sample.

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

from scenes.frozen import Frozen

Range = tuple[float, float]


class Constant(Frozen):
    """Always the same value."""

    kind: Literal["constant"] = "constant"
    value: float

    @property
    def support(self) -> Range:
        """Least and greatest value it can give."""
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
    def support(self) -> Range:
        """Least and greatest value it can give."""
        return self.low, self.high

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return float(rng.uniform(self.low, self.high))


class Normal(Frozen):
    """Gaussian; it reaches everywhere, so quantities with a bound need truncated-normal instead."""

    kind: Literal["normal"] = "normal"
    mean: float
    sd: PositiveFloat

    @property
    def support(self) -> Range:
        """Least and greatest value it can give."""
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
        # Further out than 6 sd the distribution function is 1 to its ninth digit, and inverting it gives steps.
        if self.low > self.mean + 6 * self.sd or self.high < self.mean - 6 * self.sd:
            raise ValueError(
                f"low..high = {self.low}..{self.high} lies beyond 6 sd of mean {self.mean}: move one of them"
            )
        return self

    @property
    def support(self) -> Range:
        """Least and greatest value it can give."""
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
    def support(self) -> Range:
        """Least and greatest value it can give."""
        return 0.0, np.inf

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        return float(self.median * np.exp(rng.normal(0.0, self.sigma)))


class Choice(Frozen):
    """One of the listed values, of any TOML type, by weight."""

    kind: Literal["choice"] = "choice"
    values: Annotated[tuple[JsonValue, ...], Field(min_length=1)]
    weights: tuple[float, ...] | None = None
    """Relative; absent: all alike."""

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
    def support(self) -> Range:
        """Least and greatest value it can give; NaN where a value is no number."""
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


def support(quantity: Quantity) -> Range:
    """Least and greatest value a quantity can take."""
    return (quantity, quantity) if isinstance(quantity, (int, float)) else quantity.support


def draw(quantity: Quantity, rng: np.random.Generator) -> float:
    """The number itself, or one drawn value."""
    return float(quantity) if isinstance(quantity, (int, float)) else float(quantity.draw(rng))


def within(low: float = -np.inf, high: float = np.inf) -> AfterValidator:
    """Refuse, when the scene is read, a quantity that could fall outside low..high when it is drawn."""

    def check(quantity: Any) -> Any:
        least, most = support(quantity)
        if not (low <= least and most <= high):
            raise ValueError(
                f"can take values from {least:g} to {most:g}, but {low:g} to {high:g} is allowed: "
                "move its bounds, or use truncated-normal"
            )
        return quantity

    return AfterValidator(check)


NonNegative = Annotated[Quantity, within(0.0)]
Fraction = Annotated[Quantity, within(0.0, 1.0)]
Draw = Callable[[Quantity], float]
