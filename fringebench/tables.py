"""Scores and comparisons as tables for the terminal."""

import math
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

import evaluation
from evaluation.budget import Budget
from fringebench.doctor import Diagnosis

if TYPE_CHECKING:
    from fringebench.chapter import ChapterResult


# Columns the widest tables need: a narrower terminal wraps them, which loses no figure; rich would cut figures short.
WIDEST = 120


def wide_console() -> Console:
    """Standard output for tables of many figures."""
    console = Console(highlight=False)
    return console if console.width >= WIDEST else Console(highlight=False, width=WIDEST)


def fused_title(exposures: int, fusion: str) -> str:
    """What the second score table of a run is about."""
    if exposures == 1:
        return "one exposure, saturated pixels rejected"
    return f"all {exposures} exposures, fused by {fusion}"


def score_rows(score: evaluation.Score) -> list[list[str]]:
    """One row per region: label, pixels, valid %, then bias, RMS, predicted and p95 in um, and outliers in %."""
    return [
        [
            label,
            str(region.pixels),
            number(region.coverage, 100, 1),
            number(region.bias_mm, 1000, 1),
            number(region.rms_mm, 1000, 1),
            number(region.predicted_sd_mm, 1000, 1),
            number(region.p95_abs_mm, 1000, 1),
            number(region.outlier_fraction, 100, 2),
        ]
        for label, region in score.regions.items()
    ]


def score_table(score: evaluation.Score, title: str) -> Table:
    """One row per region: how much was measured, how wrong it is, how wrong it was expected to be."""
    table = Table(title=title, title_justify="left")
    table.add_column("region")
    for name in (
        "pixels",
        "valid %",
        "bias µm",
        "RMS µm",
        "pred. µm",
        "p95 µm",
        "outl. %",
    ):
        table.add_column(name, justify="right")
    for row in score_rows(score):
        table.add_row(*row)
    return table


def feature_table(score: evaluation.Score) -> Table:
    """One row per feature: measured, true, difference."""
    table = Table(title="features", title_justify="left")
    table.add_column("feature")
    for name in ("measured mm", "truth mm", "difference µm"):
        table.add_column(name, justify="right")
    for label, feature in score.features.items():
        measured, truth = feature.measured_mm, feature.truth_mm
        both = measured is not None and truth is not None
        difference = measured - truth if measured is not None and truth is not None else None
        table.add_row(
            label,
            number(measured, 1, 4),
            number(truth, 1, 4),
            number(difference, 1000, 1) if both else "-",
        )
    return table


def budget_table(found: Budget) -> Table:
    """One row per region and cause: root of the mean square error it makes alone, and that goes when it goes."""
    table = Table(title="error budget, RMS: squares add; minus: less error", title_justify="left")
    table.add_column("region")
    table.add_column("cause", no_wrap=True)
    for name in ("alone µm", "share %", "removed µm", "bias µm", "valid %"):
        table.add_column(name, justify="right")
    for label, region in found.regions.items():
        total = region.total_mm2
        lines: list[tuple[str, float | None, float | None, float | None, float]] = [
            (name, share.alone_mm2, share.removed_mm2, share.bias_alone_mm, share.coverage_alone)
            for name, share in region.causes.items()
        ]
        lines += [
            ("(method itself)", region.ideal_mm2, None, None, 0.0),
            ("(interaction)", region.interaction_mm2, None, None, 0.0),
        ]
        for i, (name, alone, removed, bias, coverage) in enumerate(lines):
            table.add_row(
                label if i == 0 else "",
                name,
                number(_root(alone), 1000, 2),
                number(alone / total if alone is not None and total else None, 100, 1),
                number(_root(removed), 1000, 2),
                number(bias, 1000, 2),
                f"{coverage * 100:+.1f}" if coverage else "",
            )
        table.add_row(
            "", "[bold]total[/]", number(_root(total), 1000, 2), "", "", "", number(region.coverage, 100, 1),
            end_section=True,
        )  # fmt: skip
    return table


def _root(square: float | None) -> float | None:
    """Square root that keeps the sign."""
    return None if square is None else math.copysign(math.sqrt(abs(square)), square)


def chapter_table(result: "ChapterResult") -> Table:
    """The chapter's figures beside theory and measurement."""
    table = Table(title="the chapter's experiments", title_justify="left")
    table.add_column("figure", min_width=max(len(row.name) for row in result.rows))
    for name in ("chapter", "theory", "measured"):
        table.add_column(name, justify="right")
    table.add_column("note")
    for row in result.rows:
        table.add_row(
            row.name,
            number(row.chapter, 1, 4),
            number(row.theory, 1, 4),
            number(row.measured, 1, 4),
            row.note,
        )
    return table


def doctor_table(diagnosis: Diagnosis) -> Table:
    """What this machine has."""
    table = Table(show_header=False)
    table.add_row("Python", diagnosis.python)
    table.add_row("platform", f"{diagnosis.platform}, {diagnosis.cores} cores")
    for name, version in diagnosis.packages.items():
        table.add_row(name, version)
    table.add_row("backend", f"{diagnosis.backend or 'none'} ({diagnosis.variant or '-'})")
    table.add_row("CUDA device", "yes" if diagnosis.cuda else "no")
    llvm = f"{diagnosis.llvm_version} at {diagnosis.llvm_path} ({diagnosis.llvm_origin})"
    table.add_row("LLVM", llvm if diagnosis.llvm_path else "none")
    return table


def number(value: float | None, scale: float, digits: int) -> str:
    """A figure in the unit asked for; a dash where there is none."""
    # Adding 0.0 makes a rounded -0.0 plain.
    return "-" if value is None else f"{round(value * scale, digits) + 0.0:.{digits}f}"
