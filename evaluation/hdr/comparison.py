"""Statistics of a comparison: figures of each strategy from repeats, and which differences are significant."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from decode import Reconstruction
from decode.phase import wrap
from evaluation.scoring.regions import region_scores, scored
from evaluation.scoring.score_result import RegionScore
from evaluation.theory.cramer_rao import CONFIDENCE, Efficiency, FringeLight, efficiency
from scenes.files.truth_maps import Truth

FIGURES = (
    "coverage",
    "bias_mm",
    "rms_mm",
    "sd_mm",
    "median_abs_mm",
    "outlier_fraction",
    "flagged_fraction",
)
# A strategy whose coverage is below the best by more than this is not tied with it, however small its error.
COVERAGE_MARGIN = 0.01
# Heights of one pixel that differ by more than this many predicted sigmas have different fringe orders.
SAME_ORDER_SIGMAS = 20.0


@dataclass(frozen=True)
class MeanInterval:
    """A mean over repeats, and the half width of its confidence interval (Student's t; None for one repeat)."""

    value: float
    half_width: float | None

    @classmethod
    def of_efficiency(cls, found: Efficiency | None) -> "MeanInterval | None":
        """An efficiency; one pixel leaves its interval open, a decoder without scatter the efficiency itself."""
        if found is None or not np.isfinite(found.value):
            return None
        return cls(found.value, found.half_width if found.pixels > 1 else None)

    @classmethod
    def of(cls, repeats: Sequence[float]) -> "MeanInterval":
        """Mean and confidence interval of one value per repeat."""
        values = np.asarray(repeats, np.float64)
        n = values.size
        if n < 2:
            return cls(float(values.mean()), None)
        quantile = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, n - 1))
        return cls(float(values.mean()), quantile * float(values.std(ddof=1)) / np.sqrt(n))


@dataclass(frozen=True, eq=False)
class StrategyRegion:
    """A strategy on one label."""

    pixels: int
    figures: Mapping[str, MeanInterval | None]
    """`FIGURES`, as `RegionScore` has them; None where a repeat lacks it."""
    efficiency: MeanInterval | None
    """Cramer-Rao bound over variance reached; the interval is from the scatter over pixels."""
    phase_bias_rad: float | None
    """Root mean square over pixels of the mean phase error, corrected for noise: the error of saturation and of the decoder,
    not of the scene, because the phase of the noise-free light counts as true."""
    systematic_mm: float | None
    """Root mean square over pixels of each pixel's mean height error over the repeats, corrected for noise. Contains what
    cancels in `bias_mm` where errors have both signs, as those of clipped fringes do; includes the scene's own errors."""
    sigma_ratio: float | None
    """Observed scatter of heights over the repeats / predicted sigma, root mean square over pixels."""
    rms_mm: tuple[float, ...]
    """One per repeat; empty if a repeat has none."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data: each figure, and half widths under ``half_width``."""
        named = {**self.figures, "efficiency": self.efficiency}
        return {
            "pixels": self.pixels,
            **{name: None if e is None else e.value for name, e in named.items()},
            "systematic_mm": self.systematic_mm,
            "phase_bias_rad": self.phase_bias_rad,
            "sigma_ratio": self.sigma_ratio,
            "half_width": {name: None if e is None else e.half_width for name, e in named.items()},
        }


@dataclass(frozen=True, eq=False)
class Repeat:
    """The parts of one reconstruction that the statistics need."""

    scores: Mapping[str, RegionScore]
    error_rad: NDArray[np.float32]
    """Of the wrapped phase, (row, col); NaN where a pixel is not valid."""
    height_mm: NDArray[np.float32]
    """(row, col), NaN where a pixel is not valid."""
    sigma_mm: NDArray[np.float32]
    """(row, col) predicted standard deviation of the height."""

    @classmethod
    def of(
        cls,
        rec: Reconstruction,
        truth: Truth,
        light: FringeLight | None,
        margin_px: int,
        outlier_mm: float,
    ) -> "Repeat":
        """Score a reconstruction, and compare its phase with that of the noise-free light, where it is known.

        All strategies have the same outlier limit, so that a decoder that predicts small sigmas does not have more
        outliers for it.
        """
        off = np.full(rec.valid.shape, np.nan)
        if light is not None and rec.phases:
            off = np.where(rec.valid, rec.wrapped_rad - light.phase_rad, np.nan)
        return cls(
            region_scores(rec, truth, margin_px=margin_px, outlier_mm=outlier_mm),
            wrap(off).astype(np.float32),
            np.where(rec.valid, rec.height_mm, np.nan).astype(np.float32),
            rec.sigma_mm,
        )


def summary(
    repeats: Sequence[Repeat], truth: Truth, bound_rad2: NDArray[np.float64] | None, margin_px: int
) -> dict[str, StrategyRegion]:
    """Figures of one strategy by label, from repeats with different noise and the bound (row, col) of its frames in
    rad^2.
    """
    return {
        label: _region(repeats, label, truth, scored(truth, label, margin_px), bound_rad2)
        for label in truth.labels
    }


def _region(
    repeats: Sequence[Repeat],
    label: str,
    truth: Truth,
    mask: NDArray[np.bool_],
    bound_rad2: NDArray[np.float64] | None,
) -> StrategyRegion:
    scores = [repeat.scores[label] for repeat in repeats]
    values = {name: [getattr(s, name) for s in scores] for name in FIGURES}
    figures = {n: None if None in v else MeanInterval.of(v) for n, v in values.items()}
    reached = None
    if len(repeats) > 1 and bound_rad2 is not None:
        reached = efficiency(np.stack([r.error_rad[mask] for r in repeats]), bound_rad2[mask])
    systematic, ratio = _scatter(repeats, truth.height_mm, mask)
    rms = [s.rms_mm for s in scores if s.rms_mm is not None]
    return StrategyRegion(
        pixels=scores[0].pixels,
        figures=figures,
        efficiency=MeanInterval.of_efficiency(reached),
        phase_bias_rad=None if reached is None else reached.bias_rad,
        systematic_mm=systematic,
        sigma_ratio=ratio,
        rms_mm=tuple(rms) if len(rms) == len(repeats) else (),
    )


def _scatter(
    repeats: Sequence[Repeat], true_mm: NDArray[np.floating], mask: NDArray[np.bool_]
) -> tuple[float | None, float | None]:
    """Systematic error, and scatter over prediction, where every repeat is valid and has the same fringe order."""
    if len(repeats) < 2:
        return None, None
    error = np.stack([r.height_mm[mask] - true_mm[mask] for r in repeats]).astype(np.float64)
    sigma2 = np.mean([r.sigma_mm[mask].astype(np.float64) ** 2 for r in repeats], axis=0)
    # A wrong order is no noise: it is far larger.
    with np.errstate(invalid="ignore"):
        good = np.ptp(error, axis=0) < SAME_ORDER_SIGMAS * np.sqrt(sigma2)
    if not good.any():
        return None, None
    variance = error[:, good].var(axis=0, ddof=1)
    bias2 = np.mean(error[:, good].mean(axis=0) ** 2 - variance / len(repeats))
    return float(np.sqrt(max(bias2, 0.0))), float(np.sqrt(np.mean(variance / sigma2[good])))


@dataclass(frozen=True, eq=False)
class StrategyResult:
    """One strategy under one budget."""

    name: str
    budget: str
    plan: str
    fusion: str
    source: str
    frames: int
    exposure_ms: float
    cycle_ms: float
    """Time that the machine takes for the pictures."""
    decode_s: float
    """Fastest of the repeats; the first also compiles."""
    regions: Mapping[str, StrategyRegion]
    share: float = 1.0
    """Share of the budget that it was given."""


@dataclass(frozen=True, eq=False)
class StrategyComparison:
    """Strategies side by side on one scene."""

    scene: str
    repeats: int
    seed: int
    margin_px: int
    outlier_mm: float
    """A larger error counts as an outlier."""
    limits: Mapping[str, float]
    """Budget -> what the reference costs: milliseconds or frames."""
    entries: tuple[StrategyResult, ...]
    left_out: tuple[tuple[str, str, str], ...]
    """(name, budget, reason) of strategies that were skipped."""
    light: Mapping[str, Any] | None = None
    """Render noise reached, where a limit was asked for."""
    pareto: tuple[StrategyResult, ...] = ()
    """Strategies at several shares of the reference's cycle time."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data; always valid JSON."""
        return {
            "scene": self.scene,
            "repeats": self.repeats,
            "seed": self.seed,
            "margin_px": self.margin_px,
            "outlier_mm": self.outlier_mm,
            "confidence": CONFIDENCE,
            "budgets": dict(self.limits),
            "strategies": [
                _plain(e, "best_or_tied", lambda e, x: e.name in self.best(e.budget, x))
                for e in self.entries
            ],
            "left_out": [
                dict(zip(("name", "budget", "reason"), item, strict=True)) for item in self.left_out
            ],
            **({} if self.light is None else {"light": dict(self.light)}),
            "pareto": [_plain(e, "on_front", lambda e, x: e in self.front(x)) for e in self.pareto],
        }

    @property
    def budgets(self) -> tuple[str, ...]:
        """Budgets that were compared, in order."""
        return tuple(dict.fromkeys(e.budget for e in self.entries))

    def front(self, label: str) -> list[StrategyResult]:
        """Points of the sweep that no other point beats in both cycle time and RMS error, shortest first.

        Points whose coverage is below the maximum by more than `COVERAGE_MARGIN` are excluded.
        """
        found: list[StrategyResult] = []
        smallest = np.inf
        points = _rivals({i: e.regions[label] for i, e in enumerate(self.pareto)})
        order = sorted(points, key=lambda i: (self.pareto[i].cycle_ms, points[i]))
        for i in order:
            if points[i] < smallest:
                found.append(self.pareto[i])
                smallest = points[i]
        return found

    def best(self, budget: str, label: str) -> tuple[str, ...]:
        """Names of the strategy with the smallest RMS error on a label and of those statistically tied with it.

        Repeats share seeds, so differences are paired. Strategies whose coverage is below the maximum by more than
        `COVERAGE_MARGIN` are excluded. With one repeat all others are tied.
        """
        rows = {e.name: e.regions[label] for e in self.entries if e.budget == budget}
        rivals = _rivals(rows)
        if not rivals:
            return ()
        first = min(rivals, key=rivals.__getitem__)
        return tuple(n for n in rivals if _tied(rows[n].rms_mm, rows[first].rms_mm))


def _rivals(rows: Mapping[Any, StrategyRegion]) -> dict[Any, float]:
    """Mean RMS error of those whose coverage is not clearly below the maximum."""
    covered = {n: r.figures["coverage"] for n, r in rows.items() if r.rms_mm}
    most = max((c.value for c in covered.values() if c), default=0.0)
    kept = [n for n, c in covered.items() if c and c.value >= most - COVERAGE_MARGIN]
    return {n: float(np.mean(rows[n].rms_mm)) for n in kept}


def _plain(
    entry: StrategyResult, mark: str, marked: Callable[[StrategyResult, str], bool]
) -> dict[str, Any]:
    """An entry as plain data; each region says whether it is marked."""
    regions = {x: {**r.to_dict(), mark: marked(entry, x)} for x, r in entry.regions.items()}
    return {**vars(entry), "regions": regions}


def _tied(one: Sequence[float], best: Sequence[float]) -> bool:
    worse = MeanInterval.of(np.subtract(one, best).tolist())
    return worse.half_width is None or worse.value <= worse.half_width
