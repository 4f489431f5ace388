"""A projector's pixels as light: open squares with dark gaps, blurred by its optics.

Light is separable: along the axis of a pattern each pixel has its value, across it all have the same profile, which is
a comb of one pixel's period where gaps are.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.special import ndtr

from scenes.rig.projectors import Emission

Floats = NDArray[np.float64]

# Cells of a pixel, between whose centres light is linear: a fringe of 4 px keeps all but 0.12 % of its contrast.
CELLS = 16
# Standard deviations that a blur reaches.
REACH = 6.0


def cells_per_pixel(emission: Emission) -> int:
    """Cells that a pixel's profile needs: 1 for sharp squares without gaps."""
    if emission.pixelated:
        return 1 if emission.open_width == 1.0 and emission.psf_sigma_px == 0.0 else CELLS
    # Where fringes are analytic, Gray code alone is in tables.
    return 1 if emission.linear else CELLS


def along(emission: Emission, values: Floats, smooth: NDArray[np.bool_]) -> Floats:
    """Light along an axis, (frame, pixels x cells), of emitted pixel values (frame, pixels).

    Mean over pixels and cells are those of the values. Without pixels, `smooth` frames (frame,) are interpolated between
    pixel centres, others stay squares. Outside its borders the projector repeats its last pixel.
    """
    cells = cells_per_pixel(emission)
    if cells == 1:
        return values
    count = values.shape[1]
    if emission.pixelated:
        profile = _profile(emission, cells)
        reach = profile.shape[1] // 2
        padded = np.pad(values, ((0, 0), (reach, reach)), mode="edge")
        neighbours = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=1)
        light: Floats = (neighbours @ profile.T).reshape(len(values), -1)
        return light
    light = np.repeat(values, cells, axis=1)
    if smooth.any() and count > 3:
        at = (np.arange(count * cells) + 0.5) / cells - 0.5
        spline = make_interp_spline(np.arange(count), values[smooth], k=3, axis=1)
        between = spline(np.clip(at, 0.0, count - 1.0))
        # A cubic may swing below black at a kink. Bit planes do so all over, and only as they are make up their frame.
        light[smooth] = np.maximum(between, 0.0) if emission.frame_ms is None else between
    return light


def across(emission: Emission) -> Floats | None:
    """Light of even pixels across a pattern, (cell,) of one pixel, mean 1; None: no gaps."""
    if not emission.pixelated or emission.open_width == 1.0:
        return None
    comb: Floats = _profile(emission, cells_per_pixel(emission)).sum(axis=1)
    return comb


def _profile(emission: Emission, cells: int) -> Floats:
    """Share of each neighbour's value in a pixel's cells, (cell, neighbour): a blurred open square, averaged over a cell."""
    width, sigma = emission.open_width, emission.psf_sigma_px
    reach = int(np.ceil(width / 2.0 + REACH * sigma + 0.5))
    edge = np.arange(cells + 1)[:, None] / cells - 0.5 - np.arange(-reach, reach + 1)
    passed = (_ramp(edge + width / 2.0, sigma) - _ramp(edge - width / 2.0, sigma)) / width
    share: Floats = np.diff(passed, axis=0) * cells
    # What a blur sends beyond its reach, 1e-9, stays in the sum.
    return np.asarray(share / share.mean(axis=0).sum())


def _ramp(x: Floats, sigma: float) -> Floats:
    """Integral of an edge at 0 blurred by a Gaussian."""
    if sigma == 0.0:
        return np.asarray(np.maximum(x, 0.0))
    density = np.exp(-0.5 * (x / sigma) ** 2) / np.sqrt(2.0 * np.pi)
    return np.asarray(x * ndtr(x / sigma) + sigma * density)
