"""Slopes of deflectometry compared with those of the surface as rendered, and the form of the heights."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decode import Reconstruction
from scenes.files.truth_maps import Truth

Floats = NDArray[np.float64]
Masks = Mapping[str, NDArray[np.bool_]]

UM_PER_MM = 1e3
URAD = 1e6
# A plane through fewer points has no form left.
FEWEST_POINTS = 4


@dataclass(frozen=True)
class SlopeScore:
    """Figures of one label's measured pixels; None where there is none."""

    rms_urad: float | None
    """Root mean square error of the slopes dz/dx and dz/dy together, 1e-6."""
    predicted_urad: float | None
    """Root mean square of the decoder's predicted standard deviations."""
    within_one_sigma: float | None
    """Share of slopes whose error is below one predicted standard deviation: 0.683 for noise alone."""
    within_two_sigma: float | None
    """Share below 1.96: 0.95."""
    form_um: float | None
    """Root mean square height error without its best plane, which is what a tilt of the rig leaves."""


def slope_scores(rec: Reconstruction, truth: Truth, masks: Masks) -> dict[str, SlopeScore] | None:
    """Score slopes against the normals that mirror in the rendered scene.

    Parameters
    ----------
    rec
        The reconstruction; with slopes, if it is of a screen.
    truth
        Truth of the same scene and resolution.
    masks
        Label -> pixels to score, (row, col), such as `evaluation.scored` gives.

    Returns
    -------
    dict of str to SlopeScore, or None
        By label; None without slopes.

    Examples
    --------
    >>> from decode import Reconstruction
    >>> slope_scores(Reconstruction.of_heights([[0.0]]), None, {}) is None
    True
    """
    if rec.slope is None or rec.slope_sigma is None:
        return None
    normal = truth.normal.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = rec.slope + np.moveaxis(normal[..., :2], -1, 0) / normal[..., 2]
    height = rec.height_mm.astype(np.float64) - truth.height_mm
    return {
        label: _scored(
            error[:, at],
            rec.slope_sigma[:, at].astype(np.float64),
            truth.xyz_mm[at].astype(np.float64),
            height[at],
        )
        for label, mask in masks.items()
        for at in [mask & rec.valid]
    }


def _scored(error: Floats, sigma: Floats, point: Floats, height: Floats) -> SlopeScore:
    if not height.size:
        return SlopeScore(None, None, None, None, None)
    ratio = np.abs(error) / sigma
    form = None
    if height.size >= FEWEST_POINTS:
        plane = np.column_stack([point[:, :2], np.ones(len(point))])
        rest = height - plane @ np.linalg.lstsq(plane, height, rcond=None)[0]
        form = UM_PER_MM * float(np.sqrt(np.mean(rest**2)))
    return SlopeScore(
        URAD * float(np.sqrt(np.mean(error**2))),
        URAD * float(np.sqrt(np.mean(sigma**2))),
        float((ratio < 1.0).mean()),
        float((ratio < 1.96).mean()),
        form,
    )
