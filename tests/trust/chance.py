"""Statistics of the suite: the rate of false alarms, seeds, and p-values of families of tests."""

import os
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

# A correct program fails each test once in ten thousand runs with fresh seeds: the suite one night in a hundred.
ALPHA = 1e-4
# A fault counts as found by a test if it finds it nine times in ten.
POWER = 0.9
# Sums of tens of float32 terms, and factors that are themselves rounded: two equal radiances differ by about this much.
ROUNDING = 1e-5

# Fresh random numbers every night: FRINGEBENCH_TRUST_SEED=$(date +%Y%m%d). A failure is repeated with its number.
SEED_VARIABLE = "FRINGEBENCH_TRUST_SEED"


def generator(*names: object) -> np.random.Generator:
    """An independent random stream for these names."""
    key = [int(os.environ.get(SEED_VARIABLE, "0")), *(zlib.crc32(str(n).encode()) for n in names)]
    return np.random.default_rng(key)


def seeds(count: int, *names: object) -> list[int]:
    """Seeds drawn at random, because neighbouring ones give Mitsuba correlated streams."""
    return [int(s) for s in generator(*names).integers(0, 2**31, count)]


def family(p_values: ArrayLike) -> float:
    """Chance that the minimum of as many independent p-values is this small (Sidak; a bound for dependent ones)."""
    p = np.asarray(p_values)
    return float(-np.expm1(p.size * np.log1p(-min(p.min(), 1 - 1e-16))))


def two_sided(z: ArrayLike) -> NDArray[np.float64]:
    """P-values of normal deviates."""
    return np.asarray(2.0 * stats.norm.sf(np.abs(z)))


def deviates(p: ArrayLike, sign: ArrayLike) -> NDArray[np.float64]:
    """Normal deviates that have these two-sided p-values."""
    return np.asarray(np.sign(sign) * stats.norm.isf(np.maximum(p, 1e-300) / 2.0))


def smallest_found(standard_error: float) -> float:
    """The smallest deviation that a two-sided test finds at `ALPHA` with probability `POWER`."""
    return float(standard_error * (stats.norm.isf(ALPHA / 2.0) + stats.norm.ppf(POWER)))


def binomial_p(hits: int, trials: int, low: float, high: float) -> float:
    """Two-sided p-value of a count whose chance is somewhere in [low, high]."""
    above = stats.binom.sf(hits - 1, trials, min(high, 1.0))
    below = stats.binom.cdf(hits, trials, max(low, 0.0))
    return float(min(1.0, 2.0 * min(above, below)))
