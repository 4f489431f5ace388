"""A reconstruction compared with the truth, region by region.

Heights are compared pixel by pixel, ``error = measured - true``, along the camera's own rays; nothing is aligned first.
"""

import warnings
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reconstruction
from evaluation.scoring.disparity import disparity_scores
from evaluation.scoring.feature_fits import features
from evaluation.scoring.scene_match import other_unit, require_same_scene
from evaluation.scoring.score_result import RegionScore, Score, UnlitScore
from evaluation.scoring.slope_errors import slope_scores
from scenes.files.truth_maps import Truth
from scenes.support.errors import FringebenchWarning, ScoreError
from scenes.support.safe_parse import parse_toml

# Gaussian noise exceeds five standard deviations in 6 of 10 million pixels: an error beyond is not noise.
OUTLIER_SIGMAS = 5.0


def score(
    rec: Reconstruction,
    truth: Truth,
    *,
    margin_px: int = 0,
    outlier_sigmas: float = OUTLIER_SIGMAS,
    outlier_mm: float | None = None,
    force: bool = False,
) -> Score:
    """Score a reconstruction against the truth of the same camera, for every label of the scene.

    Parameters
    ----------
    rec
        The reconstruction, with heights in mm.
    truth
        Truth of the same scene and resolution.
    margin_px
        Narrows every region by that many pixels, see `scored`.
    outlier_sigmas
        A measured pixel is an outlier when its error exceeds this many of its own predicted sigmas; pixels without a
        finite sigma count neither way.
    outlier_mm
        If given, a pixel is an outlier when its error exceeds this length instead: the same limit for decoders that
        predict different sigmas.
    force
        Score a reconstruction of another scene or rig all the same; the score says so.

    Returns
    -------
    Score
        Figures by label, features (see `evaluation.scoring.feature_fits`), and unlit pixels declared valid.

    Raises
    ------
    ScoreError
        When the scene or rig of the two or their sizes differ, there are no heights, or a parameter is out of range.

    Warns
    -----
    FringebenchWarning
        When the heights seem to be in metres, inches or micrometres, or when a file is of a version that does not say which
        scene and rig it is of.

    Examples
    --------
    >>> from decode import Reconstruction
    >>> height = np.zeros((4, 6), np.float32)
    >>> xyz = np.zeros((4, 6, 3), np.float32)
    >>> one = np.ones((1, 4, 6), np.float32)
    >>> label = np.ones((4, 6), np.uint16)
    >>> truth = Truth(xyz, xyz + [0, 0, 1], label, ("base",), one > 0, one, one, one, 'name = "flat"')
    >>> score(Reconstruction.of_heights(height + 0.5), truth).regions["base"].bias_mm
    0.5
    """
    parts = require_same_scene(rec, truth, force)
    regions = region_scores(
        rec, truth, margin_px=margin_px, outlier_sigmas=outlier_sigmas, outlier_mm=outlier_mm
    )
    measured = np.where(rec.valid, rec.height_mm, np.nan)
    unlit = ~truth.lit & np.isfinite(truth.height_mm)
    shade = UnlitScore(int(unlit.sum()), int((unlit & rec.valid).sum()))
    unit = other_unit(measured, truth.height_mm)
    if unit:
        warnings.warn(
            f"the heights seem to be in {unit}: they are scored as millimetres; convert them, or the calibration",
            FringebenchWarning,
            stacklevel=2,
        )
    masks = {label: scored(truth, label, margin_px) for label in truth.labels}
    return Score(
        _name(truth),
        regions,
        features(measured, truth),
        shade,
        forced=parts,
        slopes=slope_scores(rec, truth, masks),
        stereo=disparity_scores(rec, truth, masks),
    )


def region_scores(
    rec: Reconstruction,
    truth: Truth,
    *,
    margin_px: int = 0,
    outlier_sigmas: float = OUTLIER_SIGMAS,
    outlier_mm: float | None = None,
) -> dict[str, RegionScore]:
    """Score the regions alone, without features, whose fits take longer than all the rest.

    Parameters
    ----------
    rec, truth, margin_px, outlier_sigmas, outlier_mm
        As for `score`.

    Returns
    -------
    dict of str to RegionScore
        Figures by label.

    Raises
    ------
    ScoreError
        As `score`.
    """
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
    total = rec.total_sigma_mm.astype(np.float64) if rec.cause_sigma_mm else None
    noise = truth.render_noise_mm
    if noise is None:
        noise = np.full(error.shape, np.nan, np.float32)
    regions = {}
    for label in truth.labels:
        mask = scored(truth, label, margin_px)
        region = _region(error[mask], sigma[mask], limit[mask], ~rec.valid[mask], noise[mask])
        if total is not None:
            region = _with_total(region, error[mask], total[mask], outlier_sigmas)
        regions[label] = region
    return regions


def scored(truth: Truth, label: str, margin_px: int = 0) -> NDArray[np.bool_]:
    """Pixels that a label is scored on: those whose centre sees it and that a projector lights.

    Parameters
    ----------
    truth
        The truth.
    label
        One of its labels.
    margin_px
        Also leaves out pixels this close (in rows and columns) to another label, to the background or to shadow. 0 keeps
        them: they are what a camera sees, and a paste grain consists of edges only. 1 removes the pixels that an edge can
        cross, where the light of two heights is mixed; defocus needs more.

    Returns
    -------
    ndarray of bool, (row, col)
        Shadow is no failure of a decoder, so unlit pixels are left out; `Score.unlit` counts those that a decoder measures
        all the same.

    Raises
    ------
    ScoreError
        For an unknown label or a negative margin.
    """
    if margin_px < 0:
        raise ScoreError(f"margin_px = {margin_px}: needs 0 or more")
    mask = truth.region(label) & truth.lit & np.isfinite(truth.height_mm)
    if margin_px:
        # The image's frame is no edge of the region: border_value keeps its pixels.
        mask = ndimage.binary_erosion(
            mask, np.ones((3, 3), np.bool_), iterations=margin_px, border_value=1
        )
    return np.asarray(mask, dtype=np.bool_)


def height_error_mm(rec: Reconstruction, truth: Truth) -> NDArray[np.float64]:
    """Measured minus true height of every pixel.

    Parameters
    ----------
    rec
        The reconstruction, with heights in mm.
    truth
        Truth of the same scene and resolution.

    Returns
    -------
    ndarray of float64, (row, col)
        Error in mm, along the camera's rays; NaN where a pixel is not valid or has no truth.

    Raises
    ------
    ScoreError
        When the sizes differ, or for phases without heights.
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
    render_noise: NDArray[np.float32],
) -> RegionScore:
    """Figures of one region from its pixels (pixel,): errors, sigmas, outlier limits, whether they are rejected, and the
    height noise of light paths in mm."""
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
    both = measured & np.isfinite(sigma) & np.isfinite(render_noise)
    if both.any() and (sensor := float(np.mean(sigma[both] ** 2))) > 0.0:
        ratio = np.sqrt(np.mean(render_noise[both].astype(np.float64) ** 2) / sensor)
        figures["render_to_sensor_noise"] = float(ratio)
    return RegionScore(**figures)


def _with_total(
    region: RegionScore, error: NDArray[np.float64], total: NDArray[np.float64], sigmas: float
) -> RegionScore:
    """With the figures of the sigma of all causes, of pixels (pixel,)."""
    judged = np.isfinite(error) & np.isfinite(total)
    if not judged.any():
        return region
    beyond = float((np.abs(error) > sigmas * total)[judged].mean())
    rms = float(np.sqrt(np.mean(total[judged] ** 2)))
    return replace(region, total_outlier_fraction=beyond, total_sd_mm=rms)


def _name(truth: Truth) -> str:
    """Name of the scene, from the TOML in the truth; empty where there is none."""
    try:
        return str(parse_toml(truth.scene).get("name", ""))
    except ValueError as error:
        raise ScoreError(
            f"the truth's scene is not valid TOML ({error}): make the truth again from its scene"
        ) from error
