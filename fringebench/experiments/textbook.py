"""The experiments of the textbook chapter, rendered instead of synthesised: its figures, and its numbers next to theory.

Three shipped scenes are used: ``chapter`` (A = 120, B = 80, sigma = 3), ``chapter-dim`` (B = 15) and ``chapter-trap``
(a dark corner, and a highlight on the cap that clips). A telecentric camera and projector make the chapter's model
``u = x + c h`` exact; shading and cast shadow, which it lacks, are real here.

Decoding is the chapter's: one exposure, P = 128 px unwrapped along the rows, four-fold to P = 32 px, linear heights,
saturation ignored, a mask by modulation only. Theory starts from the rendered light without noise: its modulation at
every pixel, the noise, rounding and clipping of the sensor (`evaluation.theory.phase_noise`).

Figures on the table are pooled over `CAPTURES` captures, so that their scatter is small; pictures show the first.
Regions leave out shadow and one pixel along every border (see `evaluation.scored`). Errors are of all their pixels,
including those the mask rejects: the dim plane and the dark corner of the chapter are below its threshold.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import scenes
from evaluation.output import plots
from evaluation.output.report import Report
from fringebench.experiments.chapter_experiment import APEX_PX, CAPTURES, MASK_DN, ChapterExperiment
from fringebench.output_folder import one_run, prepare
from fringebench.progress import Steps


@dataclass(frozen=True)
class ChapterRow:
    """One figure of the chapter: as printed there, as theory predicts it for the rendered light, and as measured."""

    name: str
    chapter: float
    theory: float
    measured: float
    note: str


@dataclass(frozen=True)
class ChapterResult:
    """The table of the chapter."""

    rows: tuple[ChapterRow, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain data: ``{"rows": [{"name", "chapter", "theory", "measured", "note"}]}``."""
        return {"rows": [asdict(row) for row in self.rows]}


Page = Callable[
    [ChapterResult, Mapping[str, Figure], Mapping[str, str], int, Mapping[str, float]], Report
]
"""Makes a report of the result, its figures by name, the scenes as TOML by name, the seed and the seconds taken."""


def run(
    folder: str | Path | None = None,
    seed: int = 0,
    steps: Steps | None = None,
    page: Page | None = None,
) -> ChapterResult:
    """Run the experiments of the chapter; with `folder`, write its figures as PNGs and the report of `page` there.

    Raises `FringebenchError` for a folder that cannot be written, a missing backend or a seed below 0.
    """
    out = None if folder is None else prepare(folder)
    steps = steps or Steps()
    clean, dim, trap = (
        ChapterExperiment(name, seed, steps) for name in ("chapter", "chapter-dim", "chapter-trap")
    )
    result = ChapterResult(_rows(clean, dim, trap))
    if out is not None:
        with steps.step("figures"), one_run(out) as keep:
            drawn = _pictures(clean, trap)
            for name, figure in drawn.items():
                keep(f"figure-32-{name}.png", partial(plots.save, figure))
            if page is not None:
                toml = {e.name: scenes.dumps(e.transport.scene) for e in (clean, dim, trap)}
                keep("report.html", page(result, drawn, toml, seed, steps.seconds).write)
    return result


def _rows(
    clean: ChapterExperiment, dim: ChapterExperiment, trap: ChapterExperiment
) -> tuple[ChapterRow, ...]:
    """Each figure as printed in the chapter, by theory and as measured, and what to know of it."""
    apex, (step, step_true) = clean.apex_true_mm, clean.step_mm
    noise, dim_noise = clean.rms_theory("base"), dim.rms_theory("base")
    measured, dim_measured = clean.rms("base"), dim.rms("base")
    figures = {
        "apex_clean_mm": (5.994, apex, clean.apex_mm),
        "step_clean_mm": (2.999, step_true, step),
        "base_rms_mm": (0.0338, noise, measured),
        "base_rms_dim_mm": (0.1823, dim_noise, dim_measured),
        "dim_ratio": (5.4, dim_noise / noise, dim_measured / measured),
        "dark_flagged_fraction": (0.997, trap.flagged_theory("ink"), trap.flagged("ink")),
        "base_false_alarm_fraction": (0.0, trap.flagged_theory("base"), trap.flagged("base")),
        "saturated_flagged_fraction": (
            0.0,
            trap.flagged_theory("highlight"),
            trap.flagged("highlight"),
        ),
        "apex_saturated_mm": (5.928, apex + trap.apex_bias_theory_mm, trap.apex_mm),
        "saturated_rms_mm": (0.1087, trap.rms_theory("highlight"), trap.rms("highlight")),
        "dark_rms_mm": (0.1911, trap.rms_theory("ink"), trap.rms("ink")),
    }
    low, high = trap.shading("highlight")
    notes = (
        f"mean of {APEX_PX} x {APEX_PX} px over {CAPTURES} captures (sd {clean.apex_noise_mm:.4f}); theory: the truth there",
        "plane on the step less plane around it; theory: the truth",
        "P/(2 pi c) sigma/(sqrt(2) B) = 0.0338; 8-bit rounding adds 0.5 %",
        "formula 0.1801; rounding adds 0.5 %, the arctangent's curvature 1 %",
        "80/15 = 5.33, and the arctangent's curvature",
        f"P(B < {MASK_DN:g}) of Rice's distribution about B = {trap.modulation('ink'):.1f}",
        "cast shadow left out: there the mask is right",
        f"clipping leaves B = {trap.modulation('highlight'):.0f}: the mask cannot see it",
        "as apex_clean; the bias is a ripple over 8 px of fringe, up to +-0.073 mm for this mean, +-0.18 for one pixel",
        f"shading on the cap's slope moves the gain by {low:+.0%} to {high:+.0%}",
        "of all dark pixels, unmasked; clipping at 0 trims the noise; no wrong orders (they need 5 sigma)",
    )
    rows = zip(figures.items(), notes, strict=True)
    return tuple(ChapterRow(name, *three, note) for (name, three), note in rows)


def _pictures(clean: ChapterExperiment, trap: ChapterExperiment) -> dict[str, Any]:
    """Figures 32.1 to 32.7 of the chapter in gray; pixels that no light reaches are blue."""
    frames = clean.stack.frames[0].astype(np.float32)
    rec, shadow = clean.first, ~clean.truth.lit
    quad = Figure(figsize=(9.0, 6.6), layout="constrained")
    for k, axes in enumerate(quad.subplots(2, 2).flat):
        plots.draw_map(
            axes, frames[k], f"P = 32 px, shift {k} × π/2", "DN", limits=(0, 255), cmap="gray"
        )
    mask = Figure(figsize=(10.0, 3.7), layout="constrained")
    left, right = mask.subplots(1, 2)
    plots.draw_map(
        left, trap.first.modulation_dn, "Modulation B", "DN", limits=(0, 120), cmap="gray"
    )
    plots.draw_map(
        right, trap.masked[0], f"Mask B < {MASK_DN:g}", "rejected", limits=(0, 1), cmap="gray"
    )
    error = np.abs(trap.first.height_mm - trap.truth.height_mm)

    def gray(values: NDArray[Any], title: str, unit: str, low: float, high: float) -> Any:
        return plots.map_figure(values, title, unit, limits=(low, high), cmap="gray")

    phase = np.where(shadow, np.nan, rec.phase_rad)
    low_phase, high_phase = float(np.nanmin(phase)), float(np.nanmax(phase))
    return {
        "1-fringes": quad,
        "2-wrapped-phase": gray(rec.wrapped_rad, "Wrapped phase, P = 32 px", "rad", -np.pi, np.pi),
        "3-low-frequency-guide": gray(frames[4], "Guide fringes, P = 128 px", "DN", 0, 255),
        "4-absolute-phase": gray(
            phase, "Absolute phase (blue: shadow)", "rad", low_phase, high_phase
        ),
        "5-height-map": gray(
            np.where(shadow, np.nan, rec.height_mm), "Height (blue: shadow)", "mm", -0.5, 6.5
        ),
        "6-modulation-and-mask": mask,
        "7-error-map": gray(
            np.where(~trap.truth.lit, np.nan, error),
            "Height error |h − true| (blue: shadow)",
            "mm",
            0.0,
            0.6,
        ),
    }
