"""Scores and comparisons as tables for the terminal."""

import math

from rich.table import Table

import evaluation
from evaluation.scoring.error_budget import ErrorBudget
from fringebench.diagnosis import Diagnosis
from fringebench.pages.figure_tables import figure_table, number

# Share of a region beyond its predicted noise that asks for an explanation.
MANY_OUTLIERS = 0.01


def fused_title(exposures: int, fusion: str) -> str:
    """Title of the second score table of a run."""
    if exposures == 1:
        return "one exposure, saturated pixels rejected"
    return f"all {exposures} exposures, fused by {fusion}"


def score_rows(score: evaluation.Score) -> list[list[str]]:
    """One row per region: label, pixels, valid %, then bias, RMS, predicted and p95 in um, outliers in %, render noise."""
    # Heights integrated from slopes are good to nanometres.
    fine = score.slopes and any((r.rms_mm or 1.0) < 1e-3 for r in score.regions.values())
    digits = 4 if fine else 1
    return [
        [
            label,
            str(region.pixels),
            number(region.coverage, 100, 1),
            number(region.bias_mm, 1000, digits),
            number(region.rms_mm, 1000, digits),
            number(region.predicted_sd_mm, 1000, digits),
            number(region.p95_abs_mm, 1000, digits),
            number(region.outlier_fraction, 100, 2),
            number(region.render_to_sensor_noise, 1, 2),
        ]
        for label, region in score.regions.items()
    ]


def score_table(score: evaluation.Score, title: str) -> Table:
    """One row per region: share measured, errors, and the standard deviation predicted."""
    figures = "pixels", "valid %", "bias µm", "RMS µm", "pred. µm", "p95 µm", "outl. %", "rend. ×"
    return figure_table(title, "region", figures, score_rows(score))


def outliers_in_words(score: evaluation.Score) -> str | None:
    """What the outliers of a scene with fringes are beyond, in one line; None where there are few or no causes to look for."""
    if score.slopes or score.stereo:
        return None
    total = {label: r.total_outlier_fraction for label, r in score.regions.items()}
    if any(share is not None for share in total.values()):
        shares = ", ".join(
            f"{label} {share:.2%}" for label, share in total.items() if share is not None
        )
        return f"beyond 5 sigma of all causes: {shares}"
    sensor = {
        label: region.outlier_fraction or 0.0
        for label, region in score.regions.items()
        if region.predicted_sd_mm is not None
    }
    worst = max(sensor, key=lambda label: sensor[label], default=None)
    if worst is None or sensor[worst] < MANY_OUTLIERS:
        return None
    return (
        f"beyond 5 sigma of the sensor's noise: up to {sensor[worst]:.2%} ({worst}); blur, mixed pixels and stray light are "
        "predicted by fringebench decode --uncertainty by-cause"
    )


def feature_table(score: evaluation.Score) -> Table:
    """One row per feature: measured, true, difference."""
    rows = []
    for label, feature in score.features.items():
        measured, truth = feature.measured_mm, feature.truth_mm
        difference = None if measured is None or truth is None else measured - truth
        rows.append(
            [label, number(measured, 1, 4), number(truth, 1, 4), number(difference, 1000, 1)]
        )
    return figure_table("features", "feature", ("measured mm", "truth mm", "difference µm"), rows)


def extra_tables(score: evaluation.Score) -> list[Table]:
    """Shares of bad matches, features and slopes, where there are any."""
    tables = [feature_table(score)] if score.features else []
    if score.stereo:
        rows = [
            [label, number(own.bad_1px, 100, 1), number(own.bad_2px, 100, 1)]
            for label, own in score.stereo.items()
        ]
        columns = "bad 1 px %", "bad 2 px %"
        tables.insert(0, figure_table("missing or wrong matches", "region", columns, rows))
    if score.slopes:
        rows = [
            [
                label,
                number(own.rms_urad, 1, 1),
                number(own.predicted_urad, 1, 1),
                number(own.within_one_sigma, 100, 1),
                number(own.within_two_sigma, 100, 1),
                number(own.form_um, 1, 3),
            ]
            for label, own in score.slopes.items()
        ]
        figures = "slopes µrad", "pred. µrad", "in 1 σ %", "in 1.96 σ %", "form µm"
        title = "slopes, and the form without its tilt"
        tables.append(figure_table(title, "region", figures, rows))
    return tables


def budget_table(found: ErrorBudget) -> Table:
    """One row per region and cause: RMS error with this cause alone, and RMS error removed without it."""
    table = figure_table("error budget, RMS; squares add up", "region", ())
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
                number(coverage, 100, 1, signed=True) if coverage else "",
            )
        table.add_row(
            "", "[bold]total[/]", number(_root(total), 1000, 2), "", "", "", number(region.coverage, 100, 1),
            end_section=True,
        )  # fmt: skip
    return table


def _root(square: float | None) -> float | None:
    """Square root of the magnitude, with the sign."""
    return None if square is None else math.copysign(math.sqrt(abs(square)), square)


def doctor_table(diagnosis: Diagnosis) -> Table:
    """Properties of this machine."""
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
