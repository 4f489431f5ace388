"""A comparison as tables for the terminal, JSON, and figures."""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.table import Table

from evaluation.comparison import Comparison, Entry, Estimate, Region
from evaluation.figures import MEASURED, MISSING, UM_PER_MM, save
from evaluation.strategies import BUDGETS, ladder
from fringebench.alone import alone
from fringebench.run import prepare
from scenes.replace_file import replacing

COLUMNS = (
    "equal",
    "frames",
    "light\nms",
    "covered\n%",
    "bias\nµm",
    "RMS\nµm",
    "outliers\n%",
    "efficiency\n",
    "decode\nms",
)


def tables(result: Comparison) -> list[Table]:
    """One table a region; ``=`` marks the smallest RMS error and those that repeats do not tell from it."""
    return [_table(result, label) for label in _labels(result)]


def _table(result: Comparison, label: str) -> Table:
    table = Table(
        title=f"{label}: {result.repeats} repeats, half widths of 95 % intervals; = best RMS, or tied with it",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.add_column("strategy", no_wrap=True)
    for name in COLUMNS:
        table.add_column(name, justify="right", no_wrap=True)
    best: dict[str, tuple[str, ...]] = {b: result.best(b, label) for b in BUDGETS}
    for entry in result.entries:
        both = entry.plan == ladder.__name__
        if both and entry.budget == BUDGETS[1]:
            continue  # the reference's own frames: the row of the other budget says it
        region = entry.regions[label]
        marks = [entry.name in best[b] for b in (BUDGETS if both else (entry.budget,))]
        table.add_row(
            entry.name,
            "both" if both else entry.budget.removeprefix("equal-"),
            f"{entry.frames}",
            f"{entry.exposure_ms:.4g}",
            _text(region.figures["coverage"], 100, 1, False),
            _text(region.figures["bias_mm"], UM_PER_MM, 2),
            _text(region.figures["rms_mm"], UM_PER_MM, 2) + _mark(marks),
            _text(region.figures["outlier_fraction"], 100, 2, False),
            _text(region.efficiency, 1, 3),
            f"{entry.decode_s * 1e3:.0f}",
        )
    return table


def _mark(best: list[bool]) -> str:
    """``=`` where best under each of its budgets, ``(=)`` under one of two."""
    if all(best):
        return " ="
    return " (=)" if any(best) else ""


def _text(estimate: Estimate | None, scale: float, digits: int, interval: bool = True) -> str:
    if estimate is None:
        return "-"
    text = f"{estimate.value * scale:.{digits}f}"
    if interval and estimate.half_width is not None:
        text += f" ±{estimate.half_width * scale:.{digits}f}"
    return text


def write(result: Comparison, folder: str | Path) -> list[Path]:
    """``compare.json``, and ``compare-<budget>.png`` with RMS error and efficiency of every strategy and region."""
    out = prepare(folder)
    paths = [out / "compare.json"]
    with alone(out):
        with replacing(paths[0]) as beside:
            text = json.dumps(result.to_dict(), indent=2, allow_nan=False)
            beside.write_text(text + "\n", "utf-8")
        for budget in BUDGETS:
            paths.append(out / f"compare-{budget}.png")
            save(figure(result, budget), paths[-1])
    return paths


def figure(result: Comparison, budget: str) -> Figure:
    """Bars with intervals: a row of axes a region, RMS error left, efficiency right; best and tied ones are dark."""
    entries = [e for e in result.entries if e.budget == budget]
    labels = _labels(result)
    height = 0.7 + len(labels) * (0.5 + 0.2 * len(entries))
    drawing = Figure(figsize=(9.0, height), layout="constrained")
    drawing.suptitle(
        f"{result.scene}, {budget}: {result.repeats} repeats, 95 % intervals; blue: smallest RMS error, or tied with it"
    )
    grid = drawing.subplots(len(labels), 2, squeeze=False, sharey="row")
    for (left, right), label in zip(grid, labels, strict=True):
        best = result.best(budget, label)
        colours = [MEASURED if e.name in best else MISSING for e in entries]
        rms = [_figure(e, label, "rms_mm") for e in entries]
        reached = [e.regions[label].efficiency for e in entries]
        for axes, estimates, scale, name in (
            (left, rms, UM_PER_MM, f"{label}: RMS error in µm"),
            (right, reached, 1.0, f"{label}: efficiency (bound / variance)"),
        ):
            width = [np.nan if x is None else x.value * scale for x in estimates]
            error = [0.0 if x is None else (x.half_width or 0.0) * scale for x in estimates]
            axes.barh(range(len(entries)), width, xerr=error, color=colours, ecolor="black")
            axes.set_title(name, fontsize=9, loc="left")
            axes.tick_params(labelsize=8)
        left.set_yticks(range(len(entries)), [e.name for e in entries])
        left.invert_yaxis()
        right.axvline(1.0, color="black", linewidth=0.8)
        right.set_xlim(0.0, max(1.1, right.get_xlim()[1]))
    return drawing


def _figure(entry: Entry, label: str, name: str) -> Estimate | None:
    region: Region = entry.regions[label]
    return region.figures[name]


def _labels(result: Comparison) -> list[str]:
    """Regions with pixels to judge."""
    first = result.entries[0].regions
    return [label for label, region in first.items() if region.pixels]
