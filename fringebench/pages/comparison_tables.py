"""A comparison as tables for the terminal, JSON, and figures."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from rich.box import SIMPLE_HEAD
from rich.table import Table

from evaluation.hdr.capture_strategies import ladder
from evaluation.hdr.comparison import (
    MeanInterval,
    StrategyComparison,
    StrategyRegion,
    StrategyResult,
)
from evaluation.output.plots import MEASURED, MISSING, UM_PER_MM, save
from fringebench.output_folder import locked, prepare, write_json
from fringebench.pages.figure_tables import figure_table, number

COLUMNS = (
    "equal",
    "frames",
    "light\nms",
    "cycle\nms",
    "covered\n%",
    "bias\nµm",
    "RMS\nµm",
    "outliers\n%",
    "efficiency\n",
    "decode\nms",
)


# Columns of a terminal, which has room for 80 characters; the report has all.
NARROW = {0: "equal", 4: "cov.\n%", 5: "bias\nµm", 6: "RMS\nµm", 7: "outl.\n%", 8: "eff.\n"}

BUDGET_WORDS = {"equal-time": "time", "equal-frames": "frames", "cycle-time": "cycle"}


def tables(result: StrategyComparison, narrow: bool = False) -> list[Table]:
    """One table per region; ``=`` marks the smallest RMS error and those statistically tied with it.

    `narrow` leaves out frames, times and the intervals of bias and efficiency.
    """
    return [_table(result, label, narrow) for label in _labels(result)]


def _table(result: StrategyComparison, label: str, narrow: bool) -> Table:
    chosen = NARROW if narrow else dict(enumerate(COLUMNS))
    title = f"{label}: {result.repeats} repeats, half widths of 95 % intervals; = best RMS, or tied with it"
    table = figure_table(title, "strategy", chosen.values(), box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    best: dict[str, tuple[str, ...]] = {b: result.best(b, label) for b in result.budgets}
    for entry in result.entries:
        every = entry.plan == ladder.__name__
        if every and entry.budget != result.budgets[0]:
            continue  # The frames of the reference fit every budget: one row is enough.
        region = entry.regions[label]
        marks = [entry.name in best[b] for b in (best if every else (entry.budget,))]
        cells = (
            "all" if every else BUDGET_WORDS[entry.budget],
            f"{entry.frames}",
            f"{entry.exposure_ms:.4g}",
            f"{entry.cycle_ms:.4g}",
            _text(region.figures["coverage"], 100, 1, False),
            _text(region.figures["bias_mm"], UM_PER_MM, 2, not narrow),
            _text(region.figures["rms_mm"], UM_PER_MM, 2) + _mark(marks),
            _text(region.figures["outlier_fraction"], 100, 2, False),
            _text(region.efficiency, 1, 3, not narrow),
            f"{entry.decode_s * 1e3:.0f}",
        )
        table.add_row(entry.name, *(cells[i] for i in chosen))
    return table


def _mark(best: list[bool]) -> str:
    """``=`` where best under each of its budgets, ``(=)`` under some."""
    if all(best):
        return " ="
    return " (=)" if any(best) else ""


def _text(estimate: MeanInterval | None, scale: float, digits: int, interval: bool = True) -> str:
    if estimate is None:
        return "-"
    text = number(estimate.value, scale, digits)
    if interval and estimate.half_width is not None:
        text += f" ±{estimate.half_width * scale:.{digits}f}"
    return text


def write(result: StrategyComparison, folder: str | Path) -> None:
    """``compare.json``, and ``compare-<budget>.png`` with RMS error and efficiency of every strategy and region, ``compare-pareto.png``."""
    out = prepare(folder)
    with locked(out):
        write_json(result.to_dict(), out / "compare.json")
        for budget in result.budgets:
            save(figure(result, budget), out / f"compare-{budget}.png")
        if result.pareto:
            save(pareto_figure(result), out / "compare-pareto.png")


def figure(result: StrategyComparison, budget: str) -> Figure:
    """Bars with intervals: one row of axes per region, RMS error left, efficiency right; the best and tied are blue."""
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


def pareto_tables(result: StrategyComparison) -> list[Table]:
    """One table per region: the points of the sweep that no other point beats in both cycle time and RMS error."""
    names = ("cycle ms", "frames", "covered %", "RMS µm")
    found = []
    for label in _labels(result) if result.pareto else ():
        rows = [
            (
                e.name,
                f"{e.cycle_ms:.4g}",
                f"{e.frames}",
                _text(e.regions[label].figures["coverage"], 100, 1, False),
                _text(e.regions[label].figures["rms_mm"], UM_PER_MM, 2),
            )
            for e in result.front(label)
        ]
        title = f"{label}: RMS error by cycle time"
        found.append(figure_table(title, "strategy", names, rows, box=SIMPLE_HEAD))
    return found


def pareto_figure(result: StrategyComparison) -> Figure:
    """RMS error against cycle time: a line for each strategy, one row of axes per region; black: the front."""
    labels = _labels(result)
    drawing = Figure(figsize=(9.0, 0.7 + 3.6 * len(labels)), layout="constrained")
    drawing.suptitle(f"{result.scene}: RMS error by cycle time, {result.repeats} repeats")
    for axes, label in zip(
        drawing.subplots(len(labels), 1, squeeze=False)[:, 0], labels, strict=True
    ):
        front = result.front(label)
        lines: dict[str, list[tuple[float, float]]] = {}
        for e in result.pareto:
            if (rms := _figure(e, label, "rms_mm")) is not None:
                lines.setdefault(e.name, []).append((e.cycle_ms, rms.value * UM_PER_MM))
        for i, (name, points) in enumerate(lines.items()):
            # Ten colours, then the same with dashes.
            style = {"color": f"C{i % 10}", "linestyle": ("-", "--", ":")[i // 10 % 3]}
            axes.plot(*zip(*points, strict=True), marker=".", label=name, linewidth=0.8, **style)
        best = [(e.cycle_ms, np.mean(e.regions[label].rms_mm) * UM_PER_MM) for e in front]
        if best:
            axes.plot(*zip(*best, strict=True), "ko", markerfacecolor="none")
        axes.set(xscale="log", yscale="log", xlabel="cycle time in ms", ylabel="RMS error in µm")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(LogFormatter())
            axis.set_minor_formatter(LogFormatter(minor_thresholds=(1.0, 0.4)))
        axes.set_title(label, fontsize=9, loc="left")
        axes.legend(fontsize=6, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return drawing


def _figure(entry: StrategyResult, label: str, name: str) -> MeanInterval | None:
    region: StrategyRegion = entry.regions[label]
    return region.figures[name]


def _labels(result: StrategyComparison) -> list[str]:
    """Regions with pixels to judge."""
    first = (result.entries or result.pareto)[0].regions
    return [label for label, region in first.items() if region.pixels]
