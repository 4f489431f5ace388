"""Is a figure worse than before? A statistical test of non-inferiority.

A figure measured in repeats has a standard error, and so has the one it is compared with. Their difference is known to a
confidence interval, which is compared with a margin fixed beforehand: non-inferiority is shown when the upper end is below
the margin, equivalence when both ends are within it. This is the two one-sided tests procedure (D. J. Schuirmann,
J. Pharmacokinet. Biopharm. 15, 657 (1987)), with Welch's degrees of freedom, or on the differences of pairs where both were
measured with the same noise. Absence of evidence does not pass: too few or too noisy repeats give a wide interval, and the
verdict is ``undecided``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from scenes.support.errors import ScoreError

Floats = NDArray[np.float64]
Verdict = Literal["worse", "undecided", "same", "better"]


@dataclass(frozen=True)
class Estimate:
    """A figure and its standard error.

    Parameters
    ----------
    mean
        The figure, in its own unit.
    standard_error
        Standard error of `mean`, same unit.
    repeats
        Number of repeats it was measured in.
    values
        One value a repeat, for paired comparisons; None where they are not known.
    """

    mean: float
    standard_error: float
    repeats: int
    values: tuple[float, ...] | None = None

    @classmethod
    def of(cls, values: ArrayLike) -> "Estimate":
        """Mean and standard error of one value a repeat, at least two.

        >>> Estimate.of([1.0, 2.0, 3.0]).mean
        2.0
        """
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
        """Estimate of a statistic, a function of the indices of the repeats to use, of which there are at least three.

        Leave-one-out values give the standard error (M. H. Quenouille 1956, J. W. Tukey 1958); `values` are Tukey's
        pseudo-values.
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
        """Estimate of minus the figure."""
        values = None if self.values is None else tuple(-value for value in self.values)
        return Estimate(-self.mean, self.standard_error, self.repeats, values)


@dataclass(frozen=True)
class EquivalenceTest:
    """Result of `compare`: new minus old, for a figure of which less is better.

    Parameters
    ----------
    difference
        New minus old, in the figure's unit.
    lower, upper
        Ends of the two one-sided confidence intervals of the difference.
    margin
        Largest increase that is accepted.
    verdict
        ``worse``, ``undecided``, ``same`` or ``better``, see `compare`.
    """

    difference: float
    lower: float
    upper: float
    margin: float
    verdict: Verdict

    @property
    def passed(self) -> bool:
        """Whether the figure is shown to be no worse than the margin allows."""
        return self.verdict in ("same", "better")


def compare(
    new: Estimate, old: Estimate, margin: float, confidence: float = 0.99, paired: bool = False
) -> EquivalenceTest:
    """Test whether a figure got worse by more than a margin.

    Parameters
    ----------
    new, old
        The figure now and before; less is better.
    margin
        Largest increase that is accepted, above 0, in the figure's unit.
    confidence
        One-sided confidence, between 0.5 and 1.
    paired
        Repeat i of both saw the same noise, so only the scatter of the differences counts. Ignored for estimates without
        `values`.

    Returns
    -------
    EquivalenceTest
        Its verdict is ``same`` if the figure is shown to be no worse than the margin; ``better`` if it also decreased by
        more than the margin; ``worse`` if it increased significantly and the increase found exceeds the margin;
        ``undecided`` if the repeats show neither.

    Raises
    ------
    ScoreError
        For a margin that is not above 0 or a confidence outside (0.5, 1).

    Examples
    --------
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
    return EquivalenceTest(difference, lower, upper, margin, verdict)


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
    """Mean over pixels of the squared bias in mm^2, noise removed, of errors (repeat, pixel); may be negative; NaN if
    no pixel is valid twice.

    The noise of two repeats is independent, so the product of their errors has the squared bias as its mean; so has the
    mean over all pairs, ``((sum e)^2 - sum e^2) / (n (n - 1))``.
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
