"""Statistics of a comparison: what repeats of the same measurement say about a strategy, and which differ for sure."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from decode import Reconstruction
from evaluation.bound import CONFIDENCE, FringeLight, efficiency
from evaluation.score import RegionScore, region_scores, scored
from scenes.truth import Truth

FIGURES = ("coverage", "bias_mm", "rms_mm", "sd_mm", "outlier_fraction", "flagged_fraction")
# A strategy that covers less than the best by more than this is not its equal, however small its error.
COVERAGE_MARGIN = 0.01
# Heights of one pixel that differ by more than this many predicted sigmas have different fringe orders.
SAME_ORDER_SIGMAS = 20.0


@dataclass(frozen=True)
class Estimate:
    """A mean over repeats, and the half width of its confidence interval (Student's t; None for one repeat)."""

    value: float
    half_width: float | None

    @classmethod
    def of(cls, repeats: Sequence[float]) -> "Estimate":
        """From one value per repeat."""
        values = np.asarray(repeats, np.float64)
        n = values.size
        if n < 2:
            return cls(float(values.mean()), None)
        quantile = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, n - 1))
        return cls(float(values.mean()), quantile * float(values.std(ddof=1)) / np.sqrt(n))


@dataclass(frozen=True, eq=False)
class Region:
    """A strategy on one label."""

    pixels: int
    figures: Mapping[str, Estimate | None]
    """`FIGURES`, as `RegionScore` has them; None where a repeat lacks it."""
    efficiency: Estimate | None
    """Cramer-Rao bound over variance reached; the interval is from the scatter over pixels."""
    phase_bias_rad: float | None
    """Root mean square over pixels of what repeats leave of the phase error: saturation's and the decoder's, not the
    scene's, for the noise-free light's own phase counts as true."""
    systematic_mm: float | None
    """Root mean square over pixels of each pixel's mean height error over the repeats, noise taken off: what `bias_mm`
    averages away where errors of both signs meet, as those of clipped fringes do. The scene's own errors are in it."""
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
    """What is kept of one reconstruction."""

    scores: Mapping[str, RegionScore]
    error_rad: NDArray[np.float32]
    """Of the wrapped phase, (row, col); NaN where a pixel is not valid."""
    height_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]

    @classmethod
    def of(
        cls,
        rec: Reconstruction,
        truth: Truth,
        light: FringeLight | None,
        margin_px: int,
        outlier_mm: float,
    ) -> "Repeat":
        """Score it, and hold its phase against the noise-free light's. One yardstick for outliers serves all strategies,
        for a decoder that predicts small sigmas must not have more of them by that.
        """
        true_rad = np.nan if light is None else light.phase_rad
        off = np.where(rec.valid, rec.wrapped_rad - true_rad, np.nan)
        return cls(
            region_scores(rec, truth, margin_px=margin_px, outlier_mm=outlier_mm),
            np.angle(np.exp(1j * off)).astype(np.float32),
            np.where(rec.valid, rec.height_mm, np.nan).astype(np.float32),
            rec.sigma_mm,
        )


def summary(
    repeats: Sequence[Repeat], truth: Truth, bound_rad2: NDArray[np.float64] | None, margin_px: int
) -> dict[str, Region]:
    """A strategy's regions by label, from its repeats and the bound (row, col) of its frames, None if there is none."""
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
) -> Region:
    scores = [repeat.scores[label] for repeat in repeats]
    figures: dict[str, Estimate | None] = {}
    for name in FIGURES:
        values = [getattr(s, name) for s in scores]
        figures[name] = None if None in values else Estimate.of(values)
    reached = None
    if len(repeats) > 1 and bound_rad2 is not None:
        reached = efficiency(np.stack([r.error_rad[mask] for r in repeats]), bound_rad2[mask])
    systematic, ratio = _scatter(repeats, truth.height_mm, mask)
    rms = [s.rms_mm for s in scores if s.rms_mm is not None]
    return Region(
        pixels=scores[0].pixels,
        figures=figures,
        efficiency=None if reached is None else Estimate(reached.value, reached.half_width),
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
    # a wrong order is no noise: it lies far beyond what noise can do
    with np.errstate(invalid="ignore"):
        good = np.ptp(error, axis=0) < SAME_ORDER_SIGMAS * np.sqrt(sigma2)
    if not good.any():
        return None, None
    variance = error[:, good].var(axis=0, ddof=1)
    bias2 = np.mean(error[:, good].mean(axis=0) ** 2 - variance / len(repeats))
    return float(np.sqrt(max(bias2, 0.0))), float(np.sqrt(np.mean(variance / sigma2[good])))


@dataclass(frozen=True, eq=False)
class Entry:
    """One strategy under one budget."""

    name: str
    budget: str
    plan: str
    fusion: str
    source: str
    frames: int
    exposure_ms: float
    decode_s: float
    """Fastest of the repeats; the first also compiles."""
    regions: Mapping[str, Region]


@dataclass(frozen=True, eq=False)
class Comparison:
    """Strategies side by side on one scene."""

    scene: str
    repeats: int
    seed: int
    margin_px: int
    outlier_mm: float
    """A larger error counts as an outlier."""
    frames: int
    """The reference's, the budget of equal-frames."""
    exposure_ms: float
    """The reference's, the budget of equal-time."""
    entries: tuple[Entry, ...]
    left_out: tuple[tuple[str, str, str], ...]
    """(name, budget, reason) of strategies that could not be had."""
    light: Mapping[str, Any] | None = None
    """How far light's own noise was brought down, where a phase error was asked for."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data; always valid JSON."""
        light = {} if self.light is None else {"light": dict(self.light)}
        best = {(budget, label): self.best(budget, label) for budget, label in self._groups()}
        return {
            "scene": self.scene,
            "repeats": self.repeats,
            "seed": self.seed,
            "margin_px": self.margin_px,
            "outlier_mm": self.outlier_mm,
            "confidence": CONFIDENCE,
            "budgets": {"equal-time": self.exposure_ms, "equal-frames": self.frames},
            "strategies": [
                {
                    **{k: v for k, v in vars(entry).items() if k != "regions"},
                    "regions": {
                        label: {
                            **region.to_dict(),
                            "best_or_tied": entry.name in best[entry.budget, label],
                        }
                        for label, region in entry.regions.items()
                    },
                }
                for entry in self.entries
            ],
            "left_out": [
                dict(zip(("name", "budget", "reason"), item, strict=True)) for item in self.left_out
            ],
            **light,
        }

    def _groups(self) -> Iterator[tuple[str, str]]:
        seen = {(e.budget, label): None for e in self.entries for label in e.regions}
        return iter(seen)

    def best(self, budget: str, label: str) -> tuple[str, ...]:
        """Names with the smallest RMS error of a label, and those whose difference from it the repeats do not establish.

        Repeats share seeds, so differences are taken repeat by repeat. Strategies that cover less than the most by more
        than `COVERAGE_MARGIN` do not compete. One repeat establishes nothing: then all that compete tie.
        """
        rows = {e.name: e.regions[label] for e in self.entries if e.budget == budget}
        covered = {n: r.figures["coverage"] for n, r in rows.items() if r.rms_mm}
        most = max((c.value for c in covered.values() if c), default=0.0)
        rivals = [n for n, c in covered.items() if c and c.value >= most - COVERAGE_MARGIN]
        if not rivals:
            return ()
        first = min(rivals, key=lambda n: np.mean(rows[n].rms_mm))
        return tuple(n for n in rivals if _tied(rows[n].rms_mm, rows[first].rms_mm))


def _tied(one: Sequence[float], best: Sequence[float]) -> bool:
    worse = Estimate.of(np.subtract(one, best).tolist())
    return worse.half_width is None or worse.value <= worse.half_width
