"""A run of the gate as a page: what got worse, by how much, and what would still pass."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from evaluation.regression import Row
from evaluation.report import Block, Grid, Paragraph, Picture, Report, Section
from fringebench.provenance import provenance
from fringebench.regress import Regression

COLUMNS = ("figure", "baseline", "now", "difference", "at most", "margin", "verdict")
# Okabe and Ito's colours; black for what needs more seeds.
COLOURS = {"worse": "#D55E00", "undecided": "#000000", "same": "#0072B2", "better": "#009E73"}
BARS = 40
PER_MM, PER_CENT = 1000.0, 100.0


def regress_report(result: Regression, seconds: Mapping[str, float]) -> Report:
    """The page."""
    failed = result.failed
    blocks: list[Block] = []
    if result.rows:
        verdict = f"{len(failed)} of {len(result.rows)} figures failed" if failed else "Passed"
        blocks.append(Paragraph(f"{verdict}, held against {result.baseline}."))
        ranked = sorted(result.rows, key=_excess, reverse=True)
        blocks.append(
            Picture(
                _figure(ranked[:BARS]),
                "Change of each figure in margins, worst first: the dot is what was found, the line what the seeds do not "
                "rule out. Reaching beyond 1 fails.",
                wide=True,
            )
        )
        if failed:
            worst = [_cells(row, f"{row.case} / ") for row in failed]
            blocks.append(Grid(COLUMNS, worst, "What failed; undecided: give more seeds"))
    else:
        blocks.append(Paragraph(f"A new baseline was stored: {result.baseline}."))
    sections = [Section("Verdict", blocks)]
    cases = dict.fromkeys(row.case for row in result.rows)
    for case in cases:
        rows = [row for row in result.rows if row.case == case]
        bad = [i for i, row in enumerate(rows) if not row.comparison.passed]
        sections.append(
            Section(f"Case {case}", [Grid(COLUMNS, [_cells(r) for r in rows], best=bad)])
        )
    sections.append(provenance("", None, seconds))
    return Report(
        f"fringebench: {result.decoder}",
        "A decoder held against a baseline: bias, systematic and silent errors, and pixels given up.",
        sections,
    )


def _excess(row: Row) -> float:
    """Upper end of the difference, in margins."""
    return row.comparison.upper / row.comparison.margin


def _figure(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(9.0, 1.2 + 0.2 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for i, row in enumerate(rows):
        c = row.comparison
        # Far beyond the margin, how far no longer matters; the table says it.
        low, middle, high = np.clip(
            np.divide([c.lower, c.difference, c.upper], c.margin), -5.0, 10.0
        )
        axes.plot([low, high], [i, i], color=COLOURS[c.verdict], linewidth=1.5)
        axes.plot(middle, i, "o", color=COLOURS[c.verdict], markersize=4)
    axes.set_yticks(range(len(rows)), [_name(row) for row in rows], fontsize=7)
    axes.invert_yaxis()
    axes.axvline(1.0, color="#D55E00", linestyle="--", linewidth=1.0)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("change, in margins (worse to the right)")
    return figure


def _name(row: Row) -> str:
    return f"{row.case} / {row.region}: {row.metric.rsplit('_', 1)[0]}"


def _cells(row: Row, case: str = "") -> list[str]:
    c = row.comparison
    scale, unit = (PER_MM, "µm") if row.metric.endswith("_mm") else (PER_CENT, "%")
    numbers = (row.old.mean, row.new.mean, c.difference, c.upper, c.margin)
    name = f"{case}{row.region}: {row.metric.rsplit('_', 1)[0]} ({unit})"
    return [name, *(f"{scale * number + 0.0:.3g}" for number in numbers), c.verdict]
