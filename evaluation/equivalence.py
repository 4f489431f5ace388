"""Is it worse than before? Answered by how sure one can be, not by eye.

A figure measured in repeats has a standard error; so has the one it is held against. Their difference is then known to an
interval, and the question is where that interval lies against a margin that is fixed beforehand: non-inferiority is shown
when its upper end is below the margin, equivalence when both ends are within it. That is the two one-sided tests procedure
(D. J. Schuirmann, J. Pharmacokinet. Biopharm. 15, 657 (1987)), with Welch's degrees of freedom, or on the differences of
pairs where both were measured with the same noise. Absence of evidence does not pass: few or noisy repeats leave an
interval too wide, and the verdict says so.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from scenes.errors import ScoreError

Floats = NDArray[np.float64]
Verdict = Literal["worse", "undecided", "same", "better"]


@dataclass(frozen=True)
class Estimate:
    """A figure and how well it is known."""

    mean: float
    standard_error: float
    repeats: int
    values: tuple[float, ...] | None = None
    """One a repeat, whose standard error is that of the figure: for comparison in pairs."""

    @classmethod
    def of(cls, values: ArrayLike) -> "Estimate":
        """From one value a repeat. Raises `ScoreError` for fewer than two."""
        sample = np.asarray(values, dtype=np.float64)
        if sample.size < 2:
            raise ScoreError(
                f"{sample.size} repeat: a standard error needs at least 2; give more seeds"
            )
        return cls(
            float(sample.mean()),
            float(sample.std(ddof=1) / np.sqrt(sample.size)),
            sample.size,
            tuple(sample.tolist()),
        )

    @classmethod
    def jackknife(cls, statistic: Callable[[NDArray[np.intp]], float], repeats: int) -> "Estimate":
        """Of a statistic that takes all repeats at once, given as a function of the indices of those used.

        Left-one-out values give its standard error (M. H. Quenouille 1956, J. W. Tukey 1958); `values` are Tukey's
        pseudo-values. Raises `ScoreError` for fewer than three repeats, of which a statistic of two would be left.
        """
        if repeats < 3:
            raise ScoreError(f"{repeats} repeats: a jackknife needs at least 3; give more seeds")
        every = np.arange(repeats)
        left = np.array([statistic(np.delete(every, i)) for i in every])
        spread = (repeats - 1) / repeats * np.sum((left - left.mean()) ** 2)
        whole = statistic(every)
        pseudo = repeats * whole - (repeats - 1) * left
        return cls(whole, float(np.sqrt(spread)), repeats, tuple(pseudo.tolist()))

    def mirrored(self) -> "Estimate":
        """Of minus the figure."""
        values = None if self.values is None else tuple(-value for value in self.values)
        return Estimate(-self.mean, self.standard_error, self.repeats, values)


@dataclass(frozen=True)
class Comparison:
    """New minus old, for a figure of which less is better."""

    difference: float
    lower: float
    """End of the one-sided confidence interval from below."""
    upper: float
    margin: float
    verdict: Verdict

    @property
    def passed(self) -> bool:
        """Whether it is shown to be no worse than the margin allows."""
        return self.verdict in ("same", "better")


def compare(
    new: Estimate,
    old: Estimate,
    margin: float,
    confidence: float = 0.99,
    paired: bool = False,
) -> Comparison:
    """Whether a figure got worse by more than `margin`, at one-sided `confidence`.

    `paired`: repeat i of both saw the same noise, so that only the scatter of the differences counts; ignored for figures
    without `values`.

    ``same``: shown to be no worse than the margin. ``better``: that, and less by more than the margin. ``worse``: surely
    above the old, and by more than the margin as far as one knows. ``undecided``: the repeats show neither. Raises `ScoreError`
    for a margin that is not above 0 or a confidence not between 0.5 and 1.

    >>> compare(Estimate(1.5, 0.1, 10), Estimate(1.0, 0.1, 10), margin=0.3).verdict
    'worse'
    """
    if not margin > 0 or not 0.5 < confidence < 1:
        raise ScoreError(
            f"margin = {margin}, confidence = {confidence}: the margin must be above 0, the confidence in (0.5, 1)"
        )
    difference = new.mean - old.mean
    error, freedom = _of_pairs(new, old) if paired else (None, 0.0)
    if error is None:
        error, freedom = _of_difference(new, old)
    reach = float(stats.t.ppf(confidence, freedom)) * error if error > 0 else 0.0
    lower, upper = difference - reach, difference + reach
    verdict: Verdict
    if difference > margin and lower > 0:
        verdict = "worse"
    elif upper > margin:
        verdict = "undecided"
    elif difference < -margin and upper < 0:
        verdict = "better"
    else:
        verdict = "same"
    return Comparison(difference, lower, upper, margin, verdict)


def _of_difference(new: Estimate, old: Estimate) -> tuple[float, float]:
    """Standard error of the difference of independent figures, and Welch's degrees of freedom."""
    variances = new.standard_error**2, old.standard_error**2
    if not any(variances):
        return 0.0, 1.0
    freedom = sum(variances) ** 2 / sum(
        v**2 / (e.repeats - 1) for v, e in zip(variances, (new, old), strict=True)
    )
    return float(np.sqrt(sum(variances))), freedom


def _of_pairs(new: Estimate, old: Estimate) -> tuple[float | None, float]:
    """The same from the differences of pairs; None where there are none."""
    if new.values is None or old.values is None or len(new.values) != len(old.values):
        return None, 0.0
    between = Estimate.of(np.subtract(new.values, old.values))
    return between.standard_error, between.repeats - 1.0


def mean_square_bias(errors: Floats, used: Sequence[int] | NDArray[np.intp]) -> float:
    """Mean over pixels of the square of each pixel's bias, noise removed; `errors` is (repeat, pixel), NaN where invalid.

    The product of two repeats' errors has the square of the bias for its mean, for their noise is independent; so has the
    mean over all pairs, ``((sum e)^2 - sum e^2) / (n (n - 1))``. Pixels seen in fewer than two repeats are left out; NaN if
    none is left. Noise may make it negative where there is no bias.
    """
    chosen = errors[np.asarray(used)]
    seen = np.isfinite(chosen)
    n = seen.sum(axis=0)
    e = np.where(seen, chosen, 0.0)
    pairs = e.sum(axis=0) ** 2 - (e**2).sum(axis=0)
    enough = n >= 2
    if not enough.any():
        return float("nan")
    return float(np.mean(pairs[enough] / (n * (n - 1))[enough]))
