"""Stereo's own measure: how far the second camera's match is off, in its pixels.

The shares of pixels whose disparity is off by more than 1 and 2 px are those of D. Scharstein and R. Szeliski, International
Journal of Computer Vision 47, 7 (2002). Pixels without a height count as bad, so that a matcher cannot gain by giving none.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decode import Reconstruction
from scenes.files.truth_maps import Truth


@dataclass(frozen=True)
class DisparityScore:
    """Shares of one label's lit pixels that both cameras see; None where there are none."""

    bad_1px: float | None
    """Not measured, or off by more than one pixel of the second camera."""
    bad_2px: float | None
    """Not measured, or off by more than two."""


def disparity_scores(
    rec: Reconstruction, truth: Truth, masks: Mapping[str, NDArray[np.bool_]]
) -> dict[str, DisparityScore] | None:
    """Shares of bad pixels of each region (row, col); None without a second camera.

    The error is the distance between the measured and the true point in the second camera's image.
    """
    rig = rec.calibration
    if rig is None or rig.second_camera is None:
        return None
    first, second = rig.camera.projection(), rig.second_camera.projection()
    measured = first.points_at(np.where(rec.valid, rec.height_mm, np.nan))
    seen, wanted = second.project(measured)[0], second.project(truth.xyz_mm)[0]
    error_px = np.hypot(*np.moveaxis(seen - wanted, -1, 0))
    return {
        label: DisparityScore(
            *(float((~(error_px[m] <= limit)).mean()) if m.any() else None for limit in (1.0, 2.0))
        )
        for label, m in masks.items()
    }
