"""A run of the gate as a page: what got worse, where in the image, by how much, and what would still pass."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evaluation.gate.regression import JudgedFigure
from evaluation.output.plots import UM_PER_MM, symmetric
from evaluation.output.report import Block, Grid, Paragraph, Picture, Report, Section
from evaluation.output.sheet import Panel, contact_sheet
from fringebench.gate.regression_result import RegionFailure, Regression, severity
from fringebench.gate.wording import scaled, short_name
from fringebench.pages.figure_tables import number
from fringebench.pages.headlines import regress_headline
from fringebench.pages.origin import provenance

# Okabe and Ito's colours; black for what needs more seeds.
COLOURS = {"worse": "#D55E00", "undecided": "#000000", "same": "#0072B2", "better": "#009E73"}
BARS = 30
# Changes beyond so many margins are drawn at the edge.
FARTHEST = 100.0
FAILED = "✗"
# Figures plotted over the runs of a history.
CURVES = 6


def regress_report(
    result: Regression, seconds: Mapping[str, float], history: Sequence[Mapping[str, Any]] = ()
) -> Report:
    """The page of a run of the gate; `history` holds the runs so far, oldest first, this one included."""
    sections = [Section("Verdict", _verdict(result))] if result.rows else []
    if len(history) > 1 and result.rows:
        sections.append(Section("History", [_history(result, history)]))
    for case in dict.fromkeys(row.case for row in result.rows):
        rows = [row for row in result.rows if row.case == case]
        failed = any(not row.comparison.passed for row in rows)
        blocks: list[Block] = []
        if failed and case in result.maps:
            blocks = [_maps(result, case), _worst_pixels(result, case)]
        sections.append(Section(f"Case {case}", [*blocks, _overview(rows)]))
    sections.append(provenance("", ", ".join(map(str, result.seeds)), seconds))
    return Report(
        f"fringebench: {result.decoder}",
        "A decoder compared with a baseline: errors, wrong fringe orders, claimed sigma, and missing pixels.",
        sections,
        regress_headline(result),
    )


def _verdict(result: Regression) -> list[Block]:
    """What failed and where, one line a region, then the figures in a picture."""
    blocks: list[Block] = []
    if failures := result.failures():
        columns = ("region", "worst figure", "baseline → now", "allowed", "where", "failed too")
        cells = [_failure_cells(failure) for failure in failures]
        blocks.append(Grid(columns, cells, "What failed, and where: worst first", words=True))
    if all(row.comparison.lower == row.comparison.upper == 0.0 for row in result.rows):
        return [Paragraph("Every figure is exactly that of the baseline.")]
    ranked = sorted(result.rows, key=severity, reverse=True)
    blocks.append(
        Picture(
            _figure(ranked[:BARS]),
            "Change of each figure in margins, worst first: the dot is the change found, the line its confidence interval. "
            "Reaching beyond 1 fails.",
            wide=True,
        )
    )
    return blocks


def _failure_cells(failure: RegionFailure) -> list[str]:
    """A row of the table of what failed."""
    row, test = failure.worst, failure.worst.comparison
    scale, unit = scaled(row.metric)
    return [
        f"{row.case} / {row.region}",
        short_name(row.metric) + ("" if test.verdict == "worse" else f" ({test.verdict})"),
        f"{_pair(row)} {unit}",
        f"+{number(test.margin, scale, 2)} {unit}",
        failure.where,
        ", ".join(map(short_name, failure.others)) or "-",
    ]


def _overview(rows: Sequence[JudgedFigure]) -> Grid:
    """All figures of a case, a column a region: the baseline's and today's."""
    regions = list(dict.fromkeys(row.region for row in rows))
    cells = {
        (row.metric, row.region): ("" if row.comparison.passed else f"{FAILED} ") + _pair(row)
        for row in rows
    }
    lines = [
        [f"{short_name(metric)} ({scaled(metric)[1]})"]
        + [cells.get((metric, region), "-") for region in regions]
        for metric in dict.fromkeys(row.metric for row in rows)
    ]
    return Grid(("figure", *regions), lines, f"All figures, baseline → now; {FAILED}: failed")


def _pair(row: JudgedFigure) -> str:
    old, new = (number(side.mean, scaled(row.metric)[0], 2) for side in (row.old, row.new))
    return f"{old} → {new}"


def _maps(result: Regression, case: str) -> Picture:
    """Error maps of a failed case, now and in the baseline, on one colour scale."""
    now, before = result.maps[case], result.baseline_maps.get(case)
    # The baseline's errors set the scale: what got worse stands out.
    limits = symmetric((before or now).error_mm * UM_PER_MM)
    panels = []
    for name, maps in (("now", now), ("baseline", before)):
        if maps is not None:
            error = maps.error_mm * UM_PER_MM
            panels.append(Panel(f"mean error, {name}", error, "µm", "RdBu_r", limits))
    for name, maps in (("now", now), ("baseline", before)):
        if maps is not None:
            wrong = 100.0 * np.maximum(maps.silent, maps.wrong_order)
            panels.append(
                Panel(
                    f"silent or wrong order, {name}", wrong, "% of seeds", "viridis", (0.0, 100.0)
                )
            )
    columns = 1 if before is None else 2
    return Picture(
        contact_sheet(panels, columns=columns),
        f"Case {case}: mean height error over the seeds (gray: never valid), and pixels that are silently wrong or of wrong order"
        + ("" if before is None else "; left now, right the baseline, on the same scale")
        + ".",
        wide=True,
    )


def _worst_pixels(result: Regression, case: str) -> Grid:
    """The worst pixels of a failed case, with their intensities."""
    cells = [
        [
            f"{pixel.row}, {pixel.col}",
            pixel.region,
            number(pixel.true_mm, UM_PER_MM, 1),
            number(pixel.error_mm, UM_PER_MM, 1),
            "; ".join(" ".join(f"{dn:.5g}" for dn in exposure) for exposure in pixel.counts_dn),
        ]
        for pixel in result.worst
        if pixel.case == case
    ]
    names = ("row, column", "region", "true µm", "error µm", "intensities in DN, by exposure")
    return Grid(
        names, cells, "Worst pixels, and what the camera saw in the first repeat", words=True
    )


def _history(result: Regression, history: Sequence[Mapping[str, Any]]) -> Picture:
    """The figures that changed most, over the runs of a history."""
    ranked = sorted(result.rows, key=severity, reverse=True)[:CURVES]
    figure = Figure(figsize=(9.0, 1.4 * len(ranked) + 0.8), layout="constrained")
    grid = figure.subplots(len(ranked), 1, squeeze=False, sharex=True)[:, 0]
    names = [
        str(run.get("commit") or str(run.get("time", ""))[5:16].replace("T", " "))
        for run in history
    ]
    for axes, row in zip(grid, ranked, strict=True):
        scale, unit = scaled(row.metric)
        values = [_past(run, row) * scale for run in history]
        axes.plot(range(len(history)), values, "o-", color=COLOURS["same"], markersize=3)
        axes.axhline(
            (row.old.mean + row.comparison.margin) * scale,
            color=COLOURS["worse"],
            linestyle="--",
            linewidth=1.0,
        )
        axes.set_title(f"{_name(row)} ({unit})", fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
    every = max(1, len(names) // 12)
    grid[-1].set_xticks(range(0, len(names), every), names[::every], rotation=30)
    return Picture(
        figure,
        "Figures over the runs of the history; dashed: the baseline plus the margin of today.",
        wide=True,
    )


def _past(run: Mapping[str, Any], row: JudgedFigure) -> float:
    """A figure in an earlier run; NaN where it has none."""
    value = run.get("figures", {}).get(row.case, {}).get(row.region, {}).get(row.metric)
    return float(value) if isinstance(value, int | float) else float("nan")


def _figure(rows: Sequence[JudgedFigure]) -> Figure:
    """Changes with their intervals, one line a figure."""
    figure = Figure(figsize=(9.0, 1.2 + 0.2 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for i, row in enumerate(rows):
        c = row.comparison
        low, middle, high = np.clip(
            np.divide([c.lower, c.difference, c.upper], c.margin), -FARTHEST, FARTHEST
        )
        axes.plot([low, high], [i, i], color=COLOURS[c.verdict], linewidth=1.5)
        axes.plot(middle, i, "o", color=COLOURS[c.verdict], markersize=4)
    axes.set_yticks(range(len(rows)), [_name(row) for row in rows], fontsize=7)
    axes.invert_yaxis()
    axes.margins(y=0.02)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.axvline(1.0, color="#D55E00", linestyle="--", linewidth=1.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("change, in margins (worse to the right)")
    return figure


def _name(row: JudgedFigure) -> str:
    """Case, region and figure."""
    return f"{row.case} / {row.region}: {short_name(row.metric)}"
