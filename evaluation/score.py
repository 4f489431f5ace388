"""A reconstruction held against the truth, region by region.

Heights are compared pixel by pixel, ``error = measured - true``, along the camera's own rays; nothing is aligned first.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reconstruction
from evaluation.features import Feature, features
from scenes.errors import ScoreError
from scenes.foreign_text import parse_toml
from scenes.replace_file import replacing
from scenes.truth import Truth

# Gaussian noise leaves this many of its own standard deviations in 6 of 10 million pixels: what lies beyond is not noise.
OUTLIER_SIGMAS = 5.0


@dataclass(frozen=True)
class RegionScore:
    """Figures of one label; None where no pixel gives them. Statistics are over the region's measured pixels."""

    pixels: int
    """The label's lit pixels (see `scored`)."""
    coverage: float | None
    """Fraction of them measured: valid, with a finite height."""
    bias_mm: float | None
    """Mean error."""
    rms_mm: float | None
    """Root mean square error; ``rms^2 = bias^2 + sd^2``."""
    sd_mm: float | None
    """Standard deviation of the error about its mean."""
    median_abs_mm: float | None
    """Median of the absolute error."""
    p95_abs_mm: float | None
    """95th percentile of the absolute error."""
    max_abs_mm: float | None
    """Largest absolute error."""
    outlier_fraction: float | None
    """Fraction of measured pixels whose error their own predicted noise does not explain (see `score`)."""
    flagged_fraction: float | None
    """Fraction of the lit pixels that the decoder itself rejected."""
    predicted_sd_mm: float | None
    """Root mean square of the decoder's predicted standard deviations."""


@dataclass(frozen=True)
class UnlitScore:
    """Pixels that see the scene and that no projector lights: nothing is to be measured there."""

    pixels: int
    valid: int
    """How many of them the decoder declares valid."""


@dataclass(frozen=True)
class Score:
    """How well a scene was measured: ``scores.json``."""

    scene: str
    """Name of the scene."""
    regions: Mapping[str, RegionScore]
    features: Mapping[str, Feature]
    unlit: UnlitScore
    light: Mapping[str, Any] | None = None
    """How far light's own noise was brought down, where a phase error was asked for."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data with None where there is no figure; always valid JSON."""
        light = {} if self.light is None else {"light": dict(self.light)}
        return {
            "scene": self.scene,
            "regions": {label: asdict(region) for label, region in self.regions.items()},
            "features": {name: asdict(feature) for name, feature in self.features.items()},
            "unlit": asdict(self.unlit),
            **light,
        }

    def write(self, path: str | Path) -> None:
        """Write as JSON, beside and renamed; raises `FileError` when the file cannot be written."""
        text = json.dumps(self.to_dict(), indent=2, allow_nan=False)
        with replacing(path) as beside:
            beside.write_text(text + "\n", "utf-8")


def score(
    rec: Reconstruction,
    truth: Truth,
    *,
    margin_px: int = 0,
    outlier_sigmas: float = OUTLIER_SIGMAS,
    outlier_mm: float | None = None,
) -> Score:
    """Score a reconstruction against the truth of the same camera, for every label of the scene.

    `margin_px` narrows every region, see `scored`. A measured pixel is an outlier when its error exceeds
    `outlier_sigmas` times its own predicted sigma; pixels without a finite sigma then count neither way. With
    `outlier_mm` it is one when its error exceeds that length instead: the same yardstick for decoders that predict
    different sigmas. Features are those of `evaluation.features`.

    Raises `ScoreError` when sizes differ, there are no heights, or a parameter is out of range.
    """
    regions = region_scores(
        rec, truth, margin_px=margin_px, outlier_sigmas=outlier_sigmas, outlier_mm=outlier_mm
    )
    measured = np.where(rec.valid, rec.height_mm, np.nan)
    unlit = ~truth.lit & np.isfinite(truth.height_mm)
    shade = UnlitScore(int(unlit.sum()), int((unlit & rec.valid).sum()))
    return Score(_name(truth), regions, features(measured, truth), shade)


def region_scores(
    rec: Reconstruction,
    truth: Truth,
    *,
    margin_px: int = 0,
    outlier_sigmas: float = OUTLIER_SIGMAS,
    outlier_mm: float | None = None,
) -> dict[str, RegionScore]:
    """The regions of `score` alone, by label: fitting features takes longer than all the rest."""
    if outlier_sigmas <= 0 or (outlier_mm is not None and outlier_mm <= 0):
        raise ScoreError(
            f"outlier_sigmas = {outlier_sigmas}, outlier_mm = {outlier_mm}: both must be above 0"
        )
    error = height_error_mm(rec, truth)
    sigma = rec.sigma_mm.astype(np.float64)
    if outlier_mm is None:
        limit = np.where(np.isfinite(sigma), outlier_sigmas * sigma, np.nan)
    else:
        limit = np.full(error.shape, outlier_mm)
    regions = {}
    for label in truth.labels:
        mask = scored(truth, label, margin_px)
        regions[label] = _region(error[mask], sigma[mask], limit[mask], ~rec.valid[mask])
    return regions


def scored(truth: Truth, label: str, margin_px: int = 0) -> NDArray[np.bool_]:
    """(row, col) pixels a label is scored on: those whose centre sees it and that a projector lights.

    Shadow is no failure of a decoder, so pixels that no projector reaches are left out (`Score.unlit` counts those that a
    decoder measures all the same). `margin_px` also leaves out
    pixels that near (in rows and columns) to another label, to nothing or to shadow: a pixel across such a border
    mixes the light of two heights while its truth is the one at its centre. The default keeps them, for they are what a
    camera sees, and a grain of paste is all border; 1 removes just those a border can cross, defocus takes more.

    Raises `ScoreError` for an unknown label or a negative margin.
    """
    if margin_px < 0:
        raise ScoreError(f"margin_px = {margin_px}: needs 0 or more")
    mask = truth.region(label) & truth.lit & np.isfinite(truth.height_mm)
    if margin_px:
        # The frame of the image is no border of the region: border_value keeps its pixels.
        mask = ndimage.binary_erosion(
            mask, np.ones((3, 3), np.bool_), iterations=margin_px, border_value=1
        )
    return np.asarray(mask, dtype=np.bool_)


def height_error_mm(rec: Reconstruction, truth: Truth) -> NDArray[np.float64]:
    """(row, col) measured minus true height; NaN where a pixel is not valid or has no truth.

    Raises `ScoreError` when the two have different sizes, or for phases without heights.
    """
    if rec.height_mm.shape != truth.height_mm.shape:
        (rows, cols), (true_rows, true_cols) = rec.height_mm.shape, truth.height_mm.shape
        raise ScoreError(
            f"the reconstruction has {cols} x {rows} pixels, the truth {true_cols} x {true_rows}: "
            "score a reconstruction against the truth of the same scene and resolution"
        )
    if not np.isfinite(rec.height_mm).any():
        raise ScoreError(
            "the reconstruction has no height at all, only phases: decode with a calibration, or with c_px_per_mm"
        )
    measured = np.where(rec.valid, rec.height_mm, np.nan).astype(np.float64)
    return measured - truth.height_mm


def _region(
    error: NDArray[np.float64],
    sigma: NDArray[np.float64],
    limit: NDArray[np.float64],
    flagged: NDArray[np.bool_],
) -> RegionScore:
    measured = np.isfinite(error)
    judged = measured & np.isfinite(limit)
    predicted = sigma[measured & np.isfinite(sigma)]
    figures: dict[str, Any] = dict.fromkeys(field.name for field in fields(RegionScore))
    figures["pixels"] = error.size
    if error.size:
        figures["coverage"] = float(measured.mean())
        figures["flagged_fraction"] = float(flagged.mean())
    if measured.any():
        e = error[measured]
        absolute = np.abs(e)
        figures |= {
            "bias_mm": float(e.mean()),
            "rms_mm": float(np.sqrt(np.mean(e**2))),
            "sd_mm": float(e.std()),
            "median_abs_mm": float(np.median(absolute)),
            "p95_abs_mm": float(np.percentile(absolute, 95)),
            "max_abs_mm": float(absolute.max()),
        }
    if judged.any():
        figures["outlier_fraction"] = float((np.abs(error) > limit)[judged].mean())
    if predicted.size:
        figures["predicted_sd_mm"] = float(np.sqrt(np.mean(predicted**2)))
    return RegionScore(**figures)


def _name(truth: Truth) -> str:
    """The scene's name, from the TOML that the truth carries; empty where it carries none."""
    try:
        return str(parse_toml(truth.scene).get("name", ""))
    except ValueError as error:
        raise ScoreError(
            f"the truth's scene is not valid TOML ({error}): make the truth again from its scene"
        ) from error
