"""The result of a page in one or two sentences."""

from collections.abc import Mapping

import evaluation
from evaluation.hdr.comparison import StrategyComparison
from evaluation.output.report import Headline
from evaluation.scoring.error_budget import ErrorBudget
from fringebench.experiments.textbook import ChapterResult
from fringebench.gate.regression_result import Regression
from fringebench.pages.figure_tables import number

# RMS error over predicted noise, above which a region is called wrong.
TOLERATED = 1.5
# Coverage below which the RMS error of a strategy is not comparable: it is of the easier pixels.
COVERED = 0.95
# Share of missing or wrong matches above which a region is called badly matched.
BAD_MATCHES = 0.15


def run_headline(score: evaluation.Score, naive: evaluation.Score, exposures: int) -> Headline:
    """How far errors exceed the predicted noise, decoded properly and naively."""
    fused = _excess(score)
    bad = {label: ratio for label, ratio in fused.items() if ratio > TOLERATED}
    if score.stereo and not fused:
        return _stereo_headline(score)
    if not fused:
        return Headline("No region has an error to judge: see why pixels were rejected.", "bad")
    how = "All exposures fused" if exposures > 1 else "Saturated pixels rejected"
    if bad:
        text = f"{how}: {_worst(score, bad)}."
    else:
        text = f"{how}: every region is as accurate as predicted (RMS at most {max(fused.values()):.2g} × predicted)."
    silent = {label: ratio for label, ratio in _excess(naive).items() if ratio > TOLERATED}
    silent = {label: r for label, r in silent.items() if r > 1.5 * fused.get(label, 0.0)}
    if silent:
        text += (
            f" One exposure with saturation ignored: {_worst(naive, silent)}, without a warning."
        )
    return Headline(text, "bad" if bad else "attention" if silent else "good")


def _stereo_headline(score: evaluation.Score) -> Headline:
    """The region with the most missing or wrong matches; no sigma is predicted that errors could be compared with."""
    bad = {n: s.bad_1px for n, s in (score.stereo or {}).items() if s.bad_1px is not None}
    if not bad:
        return Headline("Both cameras see no region together.", "bad")
    worst = max(bad, key=bad.__getitem__)
    text = f"Missing or off by more than 1 px of disparity: at most {number(bad[worst], 100, 1)} % of the pixels ({worst})."
    return Headline(text, "bad" if bad[worst] > BAD_MATCHES else "good")


def regress_headline(result: Regression) -> Headline:
    """The verdict of the gate, and the worst of what failed with its place."""
    if not result.rows:
        return Headline(f"A new baseline was stored: {result.baseline}.", "attention")
    count = len(result.rows)
    failures = result.failures()
    if not failures:
        better = f"; {len(result.improved)} got better" if result.improved else ""
        return Headline(
            f"Passed: none of {count} figures is worse than {result.baseline}{better}.", "good"
        )
    regions = f"{len(failures)} region{'s' if len(failures) > 1 else ''}"
    return Headline(
        f"Failed: {len(result.failed)} of {count} figures, in {regions}, compared with {result.baseline}. Worst is "
        f"{failures[0].sentence()}.",
        "bad",
    )


def compare_headline(result: StrategyComparison) -> Headline:
    """The best strategy where strategies differ most."""
    budget = result.entries[0].budget
    spread = {}
    for label, region in result.entries[0].regions.items():
        rms = {
            entry.name: figure.value
            for entry in result.entries
            if entry.budget == budget
            and (figure := entry.regions[label].figures["rms_mm"])
            and (covered := entry.regions[label].figures["coverage"])
            and covered.value >= COVERED
        }
        if region.pixels and len(rms) > 1:
            spread[label] = rms
    if not spread:
        return Headline("One strategy alone: nothing to compare.", "attention")
    label = max(spread, key=lambda name: max(spread[name].values()) / min(spread[name].values()))
    best, worst = (choose(spread[label], key=spread[label].__getitem__) for choose in (min, max))
    return Headline(
        f"Strategies differ most on {label}: at {budget.replace('-', ' ')}, {best} has the smallest RMS error, "
        f"{number(spread[label][best], 1e3, 1)} µm; {worst} has {number(spread[label][worst], 1e3, 1)} µm.",
        "good",
    )


def budget_headline(found: ErrorBudget) -> Headline:
    """The largest cause of the region with the largest error."""
    totals = {
        label: region.total_mm2 for label, region in found.regions.items() if region.total_mm2
    }
    if not totals:
        return Headline("No region is measured in every variant: there is no budget.", "bad")
    label = max(totals, key=totals.__getitem__)
    alone = {name: share.alone_mm2 or 0.0 for name, share in found.regions[label].causes.items()}
    cause = max(alone, key=alone.__getitem__)
    return Headline(
        f"{label} has the largest error, {number(totals[label] ** 0.5, 1e3, 1)} µm RMS; {cause} alone makes "
        f"{number(alone[cause] / totals[label], 100, 0)} % of its mean square.",
        "attention",
    )


def chapter_headline(result: ChapterResult) -> Headline:
    """How far measurement is from theory."""
    off = {
        row.name: abs(row.measured - row.theory) / abs(row.theory)
        for row in result.rows
        if row.theory
    }
    if not off:
        return Headline("No figure has a theory to compare with.", "attention")
    worst = max(off, key=off.__getitem__)
    return Headline(
        f"{len(result.rows)} figures of the chapter measured on rendered light; the largest departure from theory is "
        f"{100 * off[worst]:.2g} %, of {worst}.",
        "good" if off[worst] < 0.05 else "attention",
    )


def _excess(score: evaluation.Score) -> dict[str, float]:
    """RMS error over predicted standard deviation of each region that has both."""
    return {
        label: region.rms_mm / region.predicted_sd_mm
        for label, region in score.regions.items()
        if region.rms_mm is not None and region.predicted_sd_mm
    }


def _worst(score: evaluation.Score, ratios: Mapping[str, float]) -> str:
    """The regions that exceed most, in words."""
    ranked = sorted(ratios, key=ratios.__getitem__, reverse=True)
    parts = [
        f"{label} has an RMS error of {number(score.regions[label].rms_mm, 1e3, 0)} µm, {ratios[label]:.2g} × predicted"
        for label in ranked[:2]
    ]
    if (more := len(ranked) - 2) > 0:
        exceed = "region exceeds" if more == 1 else "regions exceed"
        parts.append(f"{more} more {exceed} {TOLERATED:g} ×")
    return "; ".join(parts)
