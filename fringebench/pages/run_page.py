"""The report of a run: the scene, what was measured, where it is wrong and why."""

from collections.abc import Mapping

import numpy as np

import decode
import scenes
from evaluation.output.inspector import inspector_of
from evaluation.output.plots import figures
from evaluation.output.report import Block, Grid, Paragraph, Picture, Report, Section, Surface
from evaluation.output.scene_pictures import (
    frames_picture,
    phase_figures,
    reason_map,
    scene_picture,
)
from fringebench.experiments.whole_run import Run
from fringebench.pages.figure_tables import grid
from fringebench.pages.headlines import run_headline
from fringebench.pages.origin import provenance
from fringebench.pages.score_tables import extra_tables, fused_title, score_rows

SCORE_COLUMNS = (
    "region", "pixels", "valid %", "bias µm", "RMS µm", "predicted µm", "p95 µm", "outliers %",
    "render / sensor noise",
)  # fmt: skip
CAPTIONS = {
    "height": "Measured height; grey pixels were rejected.",
    "error": "Signed error, on a scale symmetric about zero. Structure is bias; uncorrelated grain is noise.",
    "modulation": "Fringe amplitude, in DN of the exposure used for each pixel: where it is low, noise is high.",
    "sigma": "Standard deviation that the decoder predicts.",
    "slope": "Measured slope along x.",
    "slope_sigma": "Standard deviation of the slope along x that the decoder predicts.",
    "render_noise": "Standard deviation from the noise of light paths alone, which no camera has; on the scale of the "
    "predicted one.",
    "histograms": "Errors of each region, and the normal distribution of the predicted noise: a wider or shifted "
    "histogram is error that noise does not explain.",
}


def run_report(run: Run, spent: Mapping[str, float]) -> Report:
    """The page for one run."""
    rec, truth, stack = run.reconstruction, run.truth, run.stack
    drawn = figures(rec, truth)
    profiles = [name for name in drawn if name.startswith("profile-")]
    measured = [
        Picture(drawn[name], CAPTIONS[name])
        for name in ("modulation", "sigma", "slope", "slope_sigma", "render_noise")
        if name in drawn
    ]
    wrong: list[Block] = []
    if "histograms" in drawn:
        wrong.append(Picture(drawn["histograms"], CAPTIONS["histograms"], wide=True))
    wrong += [
        Picture(
            drawn[name],
            f"A row through {name.removeprefix('profile-').replace('-', ' and ')}: measured, true, and the error below.",
        )
        for name in profiles
    ]
    where = [
        Picture(
            scene_picture(stack, truth),
            "The mean of the first camera's frames, on a logarithmic scale, with its labels.",
        ),
        Picture(drawn["error"], CAPTIONS["error"]),
    ]
    shown = [*_phases(rec), *measured]
    frames = Picture(
        frames_picture(stack),
        "The first frame of each exposure and camera; saturated pixels are orange.",
        wide=len(stack.exposure_ms) > 1 or run.scene.second_camera is not None,
    )
    return Report(
        title=f"fringebench: {run.scene.name}",
        summary=run.scene.description,
        headline=run_headline(run.score, run.naive, len(run.stack.exposure_ms)),
        sections=[
            Section("Where the errors are", where),
            Section("Scores", _scores(run)),
            Section("Frames", [frames]),
            *(
                [Section("Phase and modulation" if rec.phases else "Matches", shown)]
                if shown
                else []
            ),
            Section(
                "Height",
                [
                    *([Paragraph(rec.order_note)] if rec.order_note else []),
                    Picture(drawn["height"], CAPTIONS["height"]),
                    Picture(reason_map(rec), "Where heights are given, and why not elsewhere."),
                    _surface(rec, truth),
                ],
            ),
            *([Section("Errors by region", wrong)] if wrong else []),
            Section("Pixels", [inspector_of(stack, rec, truth)]),
            provenance(scenes.dumps(run.scene), stack.seed, spent, run.score.light),
        ],
    )


def _phases(rec: decode.Reconstruction) -> list[Block]:
    if not rec.phases:
        return []
    wrapped, absolute = phase_figures(rec)
    return [
        Picture(wrapped, "Phase of the finest fringes, before unwrapping."),
        Picture(
            absolute,
            rec.order_note or "Phase after unwrapping: the projector column seen by each pixel.",
        ),
    ]


def _scores(run: Run) -> list[Block]:
    count = len(run.stack.exposure_ms)
    blocks: list[Block] = [
        Grid(SCORE_COLUMNS, score_rows(run.naive), "One exposure, saturation ignored"),
        Grid(SCORE_COLUMNS, score_rows(run.score), fused_title(count, run.fusion).capitalize()),
        Paragraph(
            "Regions are the lit pixels of each label. Errors are measured minus true height. Predicted is the standard "
            "deviation that the decoder claims; outliers are errors beyond five of them. Render / sensor noise compares the noise of "
            "light paths, which no camera has, with the sensor's."
        ),
    ]
    return blocks + [grid(table) for table in extra_tables(run.score)]


def _surface(rec: decode.Reconstruction, truth: scenes.Truth) -> Surface:
    return Surface(
        np.where(rec.valid, rec.height_mm, np.nan),
        truth.height_mm,
        truth.xyz_mm,
        "Measured heights coloured by error; drag to turn, hover for pixel, height, truth and error.",
    )
