"""A comparison of strategies as a page."""

from collections.abc import Mapping

from evaluation.hdr.comparison import StrategyComparison
from evaluation.output.report import Block, Grid, Paragraph, Picture, Report, Section
from fringebench.pages.comparison_tables import figure, pareto_figure, pareto_tables, tables
from fringebench.pages.figure_tables import grid
from fringebench.pages.headlines import compare_headline
from fringebench.pages.origin import provenance


def compare_report(result: StrategyComparison, toml: str, seconds: Mapping[str, float]) -> Report:
    """The page; `toml` is the scene's."""
    blocks: list[Block] = []
    for table in tables(result):
        shown = grid(table)
        best = [i for i, row in enumerate(shown.rows) if any(cell.endswith(" =") for cell in row)]
        blocks.append(grid(table, best))
    blocks.append(
        Paragraph(
            "Equal: the budget of a strategy, which is what the reference exposures need: total exposure time, number of "
            "frames, or cycle time, which is exposure time and the overhead of each frame. Errors are of valid pixels; covered is their share. Efficiency is the Cramér–Rao bound of the "
            "frames taken divided by the variance reached; 1 is the maximum. Bold: smallest RMS error, or statistically "
            "tied with it."
        )
    )
    if result.left_out:
        rows = [list(item) for item in result.left_out]
        blocks.append(Grid(("strategy", "budget", "reason"), rows, "Left out", words=True))
    pictures: list[Block] = [
        Picture(
            figure(result, budget),
            f"RMS error (left, less is better) and efficiency (right, more is better) at {budget.replace('-', ' ')}.",
            wide=True,
        )
        for budget in result.budgets
    ]
    if result.pareto:
        blocks += [grid(table) for table in pareto_tables(result)]
        pictures.append(
            Picture(
                pareto_figure(result),
                "RMS error against cycle time of each strategy; black: no other strategy is better in both.",
                wide=True,
            )
        )
    cost = result.limits
    budget = f"{cost['equal-time']:.4g} ms of light, {cost['equal-frames']:.0f} frames or {cost['cycle-time']:.4g} ms in all"
    return Report(
        f"fringebench: strategies on {result.scene}",
        f"High-dynamic-range strategies, each with {budget}, from one rendering and the same seeds.",
        [
            Section("Pictures", pictures),
            Section("Regions", blocks),
            provenance(toml, result.seed, seconds, result.light),
        ],
        compare_headline(result),
    )
