"""Is a measuring system fit for its tolerance? Repeatability and reproducibility, Cg and Cgk.

Crossed analysis of variance as in AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III, and its
appendix A. "Parts" are pads; "appraisers" are conditions that should not matter: sensors of one type, positions in the
field, boards turned round.

The sums of squares are ours: `statsmodels` gives the same to 6e-15, but by a regression with a column for each cell, so
that 102 pads by 3 appraisers take 3.4 s instead of 1 ms and 200 by 40 need 2.6 GB. Pooling and the variance components
of random effects are not part of it.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from scenes.support.errors import ScoreError

Floats = NDArray[np.float64]

# Width of a study, in standard deviations: 99.73 % of a Gaussian.
WIDTH = 6.0
# An interaction less significant than this is pooled into repeatability.
ALPHA = 0.05


@dataclass(frozen=True)
class VarianceSource:
    """A row of the analysis of variance."""

    degrees: int
    sum_of_squares: float
    mean_square: float
    f: float | None
    """Against the interaction (parts, appraisers) or repeatability (interaction); None for repeatability."""
    p: float | None


@dataclass(frozen=True)
class GaugeStudy:
    """Standard deviations of a measuring system, in the measurement's unit."""

    parts: VarianceSource
    appraisers: VarianceSource
    interaction: VarianceSource
    repeatability: VarianceSource
    pooled: bool
    """The interaction was not significant and went into repeatability."""
    ev: float
    """Equipment variation: repeatability."""
    av: float
    """Appraiser variation: reproducibility without the interaction."""
    interaction_sd: float
    grr: float
    """Repeatability and reproducibility together."""
    pv: float
    """Part variation."""
    tv: float
    """Total variation."""
    tolerance: float | None
    """Width of the tolerance, upper minus lower limit."""

    @property
    def reproducibility(self) -> float:
        """Appraisers and interaction together."""
        return float(np.hypot(self.av, self.interaction_sd))

    @property
    def grr_percent_of_study(self) -> float:
        """GRR over total variation, percent; below 10 is good, above 30 unfit (AIAG)."""
        return 100.0 * self.grr / self.tv if self.tv else 0.0

    @property
    def grr_percent_of_tolerance(self) -> float | None:
        """Six GRR over the tolerance, percent; None without a tolerance."""
        return None if self.tolerance is None else 100.0 * WIDTH * self.grr / self.tolerance

    @property
    def distinct_categories(self) -> int:
        """How many classes of parts it can distinguish, 1.41 PV/GRR; 5 or more are wanted."""
        return int(np.sqrt(2.0) * self.pv / self.grr) if self.grr else 0

    def to_dict(self) -> dict[str, Any]:
        """Plain data, the derived figures included."""
        return asdict(self) | {
            "reproducibility": self.reproducibility,
            "grr_percent_of_study": self.grr_percent_of_study,
            "grr_percent_of_tolerance": self.grr_percent_of_tolerance,
            "distinct_categories": self.distinct_categories,
        }


@dataclass(frozen=True)
class Capability:
    """A measuring system against one known part."""

    cg: float
    """Spread alone."""
    cgk: float
    """Spread and bias; 1.33 or more is wanted of both."""
    bias: float
    sd: float


def gauge_study(
    values: ArrayLike, tolerance: float | None = None, alpha: float = ALPHA
) -> GaugeStudy:
    """Analysis of variance of a crossed gauge study.

    Parameters
    ----------
    values
        (part, appraiser, repeat) measurements, 2 or more of each; every part is measured by every appraiser as often.
    tolerance
        Width from lower to upper limit, in the measurement's unit.
    alpha
        An interaction with a larger p value is pooled into repeatability.

    Returns
    -------
    GaugeStudy
        Standard deviations in the measurement's unit. Negative estimates of variance are 0.

    Raises
    ------
    ScoreError
        For fewer than 2 parts, appraisers or repeats, values that are not finite, or a tolerance that is not positive.

    Notes
    -----
    AIAG, Measurement Systems Analysis, 4th edition (2010), chapter III and appendix A.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> parts, noise = rng.normal(0, 1.0, (50, 1, 1)), rng.normal(0, 0.1, (50, 3, 4))
    >>> bool(abs(gauge_study(parts + noise).grr - 0.1) < 0.01)
    True
    """
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 3 or min(x.shape) < 2:
        raise ScoreError(
            f"measurements have shape {x.shape}: give (part, appraiser, repeat), 2 or more of each"
        )
    if not np.isfinite(x).all():
        raise ScoreError(
            f"{int((~np.isfinite(x)).sum())} of {x.size} measurements are missing: a crossed study needs them all; "
            "leave out the parts that could not be measured"
        )
    if tolerance is not None and not tolerance > 0.0:
        raise ScoreError(f"tolerance = {tolerance}: give the width from lower to upper limit")
    p, a, r = x.shape
    mean, by_part, by_appraiser = x.mean(), x.mean(axis=(1, 2)), x.mean(axis=(0, 2))
    cell = x.mean(axis=2)
    squares = {
        "parts": a * r * float(((by_part - mean) ** 2).sum()),
        "appraisers": p * r * float(((by_appraiser - mean) ** 2).sum()),
        "interaction": r
        * float(((cell - by_part[:, None] - by_appraiser[None, :] + mean) ** 2).sum()),
        "repeatability": float(((x - cell[..., None]) ** 2).sum()),
    }
    degrees = {
        "parts": p - 1,
        "appraisers": a - 1,
        "interaction": (p - 1) * (a - 1),
        "repeatability": p * a * (r - 1),
    }
    within = _source("repeatability", squares, degrees, None)
    mixed = _source("interaction", squares, degrees, within)
    part = _source("parts", squares, degrees, mixed)
    appraiser = _source("appraisers", squares, degrees, mixed)
    pooled = mixed.p is not None and mixed.p > alpha
    error = within.mean_square
    against = mixed.mean_square
    if pooled:
        both = ("interaction", "repeatability")
        error = sum(squares[name] for name in both) / sum(degrees[name] for name in both)
        against = error
    interaction = 0.0 if pooled else max(0.0, (against - error) / r)
    av = max(0.0, (appraiser.mean_square - against) / (p * r))
    pv = max(0.0, (part.mean_square - against) / (a * r))
    grr = error + av + interaction
    return GaugeStudy(
        part,
        appraiser,
        mixed,
        within,
        bool(pooled),
        ev=float(np.sqrt(error)),
        av=float(np.sqrt(av)),
        interaction_sd=float(np.sqrt(interaction)),
        grr=float(np.sqrt(grr)),
        pv=float(np.sqrt(pv)),
        tv=float(np.sqrt(grr + pv)),
        tolerance=tolerance,
    )


def capability(
    values: ArrayLike, reference: float, tolerance: float, share: float = 0.2, width: float = WIDTH
) -> Capability:
    """Cg and Cgk of repeated measurements of one part of known value.

    Parameters
    ----------
    values
        (repeat,) measurements, 2 or more.
    reference
        The known value.
    tolerance
        Width from lower to upper limit.
    share
        Share of the tolerance that the gauge may use.
    width
        Width of its spread, in standard deviations; some companies use 4.

    Returns
    -------
    Capability
        A spread of 0 gives infinity, or minus infinity where the bias alone is too large.

    Raises
    ------
    ScoreError
        For fewer than 2 values, values that are not finite, or a tolerance, share or width that is not positive.

    Notes
    -----
    ``Cg = share T / (width s)`` and ``Cgk = (share T / 2 - |mean - reference|) / (width s / 2)``; with the usual share of
    0.2 and width of 6, Cg = 1.33 leaves the gauge 15 % of the tolerance.
    """
    x = np.asarray(values, dtype=np.float64)
    if x.ndim != 1 or x.size < 2 or not np.isfinite(x).all():
        raise ScoreError(
            f"measurements have shape {x.shape}: give 2 or more finite ones of one part, (repeat,)"
        )
    if not (tolerance > 0.0 and share > 0.0 and width > 0.0):
        raise ScoreError(
            f"tolerance = {tolerance}, share = {share}, width = {width}: all must be above 0"
        )
    sd, bias = float(x.std(ddof=1)), float(x.mean() - reference)
    room = 0.5 * share * tolerance - abs(bias)
    if sd == 0.0:
        return Capability(np.inf, np.copysign(np.inf, room), bias, sd)
    return Capability(share * tolerance / (width * sd), room / (0.5 * width * sd), bias, sd)


def _source(
    name: str, squares: dict[str, float], degrees: dict[str, int], against: VarianceSource | None
) -> VarianceSource:
    """One row; F and p against another row, None where that one has no spread at all."""
    mean_square = squares[name] / degrees[name]
    f = p = None
    if against is not None and against.mean_square > 0.0:
        f = mean_square / against.mean_square
        p = float(stats.f.sf(f, degrees[name], against.degrees))
    return VarianceSource(degrees[name], squares[name], mean_square, f, p)
