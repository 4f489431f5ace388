"""A comparison of strategies as a page."""

from collections.abc import Mapping

from evaluation.comparison import Comparison
from evaluation.report import Block, Grid, Paragraph, Picture, Report, Section
from evaluation.strategies import BUDGETS
from fringebench.comparison_output import figure, tables
from fringebench.provenance import provenance
from fringebench.report_grid import grid


def compare_report(result: Comparison, toml: str, seconds: Mapping[str, float]) -> Report:
    """The page; `toml` is the scene's."""
    blocks: list[Block] = []
    for table in tables(result):
        shown = grid(table)
        best = [i for i, row in enumerate(shown.rows) if any(cell.endswith(" =") for cell in row)]
        blocks.append(grid(table, best))
    blocks.append(
        Paragraph(
            "Equal: the budget a strategy was held to, total exposure time or number of frames, that of the reference "
            "exposures. Errors are of valid pixels; covered says how many those are. Efficiency is the Cramér–Rao bound of "
            "the frames taken over the variance reached: 1 cannot be surpassed. Bold: smallest RMS error, or not told "
            "from it by the repeats."
        )
    )
    if result.left_out:
        rows = [list(item) for item in result.left_out]
        blocks.append(Grid(("strategy", "budget", "reason"), rows, "Left out", words=True))
    pictures: list[Block] = [
        Picture(
            figure(result, budget),
            f"RMS error and efficiency at {budget.replace('-', ' ')}: short bars left and long ones right are good.",
            wide=True,
        )
        for budget in BUDGETS
    ]
    budget = f"{result.exposure_ms:.4g} ms of light or {result.frames} frames"
    return Report(
        f"fringebench: strategies on {result.scene}",
        f"High-dynamic-range strategies side by side, each with {budget}, from one rendering and the same seeds.",
        [
            Section("Pictures", pictures),
            Section("Regions", blocks),
            provenance(toml, result.seed, seconds, result.light),
        ],
    )
