"""Strategy by surface: which strategy errs least on which region of which scene."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from fringebench.pages.figure_tables import figure_table

Entries = Sequence[Mapping[str, Any]]
"""Strategies under one budget, as in ``compare.json``."""
# Coverage that a strategy may lack to the best one's and still be compared with it.
COVERAGE_APART = 0.01
# Coverage from which the table does not state it.
WHOLE = 0.995


def best_strategies(entries: Entries, label: str) -> list[str]:
    """Names of the strategies for one region: that of the smallest median error among those that cover most, then those whose
    intervals overlap with its; none if no strategy measured it.
    """
    found = {e["name"]: e["regions"][label] for e in entries}
    found = {n: r for n, r in found.items() if r["median_abs_mm"] is not None}
    most = max((r["coverage"] for r in found.values()), default=0.0)
    rivals = {n: r for n, r in found.items() if r["coverage"] >= most - COVERAGE_APART}
    ranked = sorted(rivals, key=lambda name: rivals[name]["median_abs_mm"])

    def reach(name: str, sign: float) -> float:
        half_width = rivals[name]["half_width"]["median_abs_mm"] or 0.0
        return float(rivals[name]["median_abs_mm"] + sign * half_width)

    return [n for n in ranked if n == ranked[0] or reach(n, -1.0) <= reach(ranked[0], 1.0)]


def surfaces(found: Mapping[str, Entries]) -> list[tuple[str, str]]:
    """Scene and label of every region that has pixels to judge."""
    return [
        (scene, label)
        for scene, entries in found.items()
        for label, region in entries[0]["regions"].items()
        if region["pixels"]
    ]


def strategy_table(found: Mapping[str, Entries], title: str) -> Table:
    """Median height error of each strategy (row) on each surface (column); ``=`` marks the best and those tied with it."""
    columns = surfaces(found)
    best = {surface: best_strategies(found[surface[0]], surface[1]) for surface in columns}
    rows: dict[str, list[str]] = {e["name"]: [] for entries in found.values() for e in entries}
    for scene, label in columns:
        regions = {e["name"]: e["regions"][label] for e in found[scene]}
        for name, cells in rows.items():
            cells.append(_cell(regions.get(name), name in best[scene, label]))
    heads = [f"{scene}\n{label}\nµm" for scene, label in columns]
    lines = [[name, *cells] for name, cells in rows.items()]
    return figure_table(title, "strategy", heads, lines, box=SIMPLE_HEAD, padding=(0, 1, 0, 0))


def _cell(region: Mapping[str, Any] | None, best: bool) -> str:
    if region is None or region["median_abs_mm"] is None:
        return "-"
    share = "" if region["coverage"] >= WHOLE else f" ({100 * region['coverage']:.0f} %)"
    return f"{1e3 * region['median_abs_mm']:.2f}{share}{' =' if best else ''}"
