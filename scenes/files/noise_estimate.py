"""The noise of a camera's frames, from what is left of their samples by each of three explanations."""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import special

from scenes.acquisition.fringe_fit import fringe_design, fringe_solution
from scenes.acquisition.patterns import Frame

# Mean |x| of the smaller nine tenths of Gaussian numbers, in standard deviations: sqrt(2/pi) (1 - exp(-a^2/2)) / 0.9 with
# a = 1.645 the limit of those nine tenths.
TRIMMED_MEAN = 0.6573
FEWEST_PIXELS = 100
# Light must vary over the frames by so many times what is left, squared, or the slope is noise's.
VARIED = 30.0
MAX_PIXELS = 200_000


def noise_dn(
    frames: NDArray[Any],
    saturation_dn: float = float("inf"),
    step_dn: float = 1.0,
    patterns: Sequence[Frame] = (),
) -> float:
    """Standard deviation in DN of the noise of frames (exposure, frame, row, col), from their roughness, or what a
    sinusoid leaves of four steps or more; never below rounding noise.

    Weights 1 -2 1 by 1 -2 1 cancel whatever is linear along a row or a column; the mean absolute value over the
    brightest tenth of the pixels gives sigma (Immerkaer, CVIU 64, 300 (1996)), without the roughest tenth, which is
    edges. Where less than a tenth of the image is lit, the lit pixels are used. Saturated samples are left out with
    their neighbours.
    """
    every = max(1, frames.shape[1] // 6)
    planes = [f for f in frames.reshape(-1, *frames.shape[2:])[::every] if min(f.shape) >= 3]
    rough = [s for f in planes if (s := _roughness(f, saturation_dn)) is not None]
    # Texture adds to the first, gamma and flicker to the second, narrow stripes that texture blurs to the third: the smallest is nearest.
    found = (
        rough,
        list(_misfits(frames, patterns, saturation_dn)),
        list(_unshared(frames, saturation_dn)),
    )
    sigmas = [float(np.median(s)) for s in found if s]
    return float(max(min(sigmas, default=0.0), step_dn * np.sqrt(1.0 / 12.0)))


def _misfits(
    frames: NDArray[Any], patterns: Sequence[Frame], saturation_dn: float
) -> Iterator[float]:
    """Noise in DN of each fringe set of four steps or more: what a sinusoid leaves of the bright pixels' samples."""
    every = max(1, int(np.sqrt(frames[0, 0].size / MAX_PIXELS)))
    for members in set_members(patterns):
        shifts = [patterns[k].phase_shift_rad for k in members]
        solution = fringe_solution(shifts)
        if solution is None or len(members) < 4:
            continue
        for exposure in frames:
            samples = exposure[members][:, ::every, ::every].reshape(len(members), -1)
            samples = samples[:, samples.max(axis=0) < saturation_dn].astype(np.float64)
            if samples.shape[1] < FEWEST_PIXELS:
                continue
            level = samples.mean(axis=0)
            samples = samples[:, level >= _bright(level)]
            left = samples - fringe_design(shifts) @ (solution @ samples)
            yield float(np.sqrt((left**2).sum(axis=0).mean() / (len(members) - 3)))


def _unshared(frames: NDArray[Any], saturation_dn: float) -> Iterator[float]:
    """Noise in DN of each exposure: what of a pixel's samples over the frames is no linear function of its neighbours' mean.

    Texture and ambient light make that function, and flicker and patterns that vary across the two neighbours are in both. The
    smaller of neighbours above and below, and left and right.
    """
    for exposure in frames:
        found = [_left_by_neighbours(p, saturation_dn) for p in (exposure, exposure.swapaxes(1, 2))]
        yield from sorted(sigma for sigma in found if sigma is not None)[:1]


def _left_by_neighbours(planes: NDArray[Any], saturation_dn: float) -> float | None:
    """Noise in DN of planes (frame, line, pixel) beside what neighbouring lines explain; None if too few pixels tell."""
    free_numbers = len(planes) - 2
    if free_numbers < 2 or planes.shape[1] < 3:
        return None
    free = planes.max(axis=0) < saturation_dn
    free = free[:-2] & free[1:-1] & free[2:]
    level = planes.mean(axis=0, dtype=np.float32)[1:-1]
    if free.sum() < FEWEST_PIXELS:
        return None
    chosen = free & (level >= _bright(level[free]))
    above, own, below = (
        planes[:, k : planes.shape[1] - 2 + k][:, chosen].astype(np.float32) for k in range(3)
    )
    mean = 0.5 * (above + below)
    mean -= mean.mean(axis=0)
    own -= own.mean(axis=0)
    power = (mean**2).sum(axis=0)
    slope = (mean * own).sum(axis=0) / np.maximum(power, 1e-6)
    left = ((own - slope * mean) ** 2).sum(axis=0) / (1.0 + 0.5 * slope**2)
    clear = power > VARIED * left
    if clear.sum() < FEWEST_PIXELS:
        return None
    # The median of chi square, because edges are above it.
    return float(np.sqrt(np.median(left[clear]) / special.chdtri(free_numbers, 0.5)))


def _bright(levels: NDArray[Any]) -> float:
    """Level from which pixels are the brightest tenth, or lit where fewer than a tenth are."""
    tenth, lit = np.percentile(levels, 90.0), 0.5 * np.percentile(levels, 99.9)
    few = tenth < lit and (levels >= lit).sum() >= FEWEST_PIXELS
    return float(lit if few else tenth)


def _roughness(frame: NDArray[Any], saturation_dn: float) -> float | None:
    """Noise of one frame in DN; None if too few pixels are unsaturated."""
    plane = frame.astype(np.float32)
    rough = np.abs(np.diff(np.diff(plane, 2, axis=0), 2, axis=1))
    # Independent of the roughness, so that choosing bright pixels does not choose noisy ones.
    centre = cv2.blur(plane, (3, 3))[1:-1, 1:-1]
    if plane.max() >= saturation_dn:
        clipped = plane >= saturation_dn
        rows = clipped[:-2] | clipped[1:-1] | clipped[2:]
        free = ~(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])
        rough, centre = rough[free], centre[free]
    if not centre.size:
        return None
    seen = rough[centre >= _bright(centre)]
    kept = np.sort(seen)[: max(1, int(0.9 * seen.size))]
    # The weights' squares sum to 36.
    return float(kept.mean()) / (6.0 * TRIMMED_MEAN)


def set_members(patterns: Sequence[Frame]) -> Iterator[list[int]]:
    """Indices of the frames of each fringe set."""

    def key(k: int) -> tuple[int, int, str, float]:
        frame = patterns[k]
        return frame.camera, frame.projector, frame.axis, frame.period_px

    fringes = sorted((k for k, f in enumerate(patterns) if f.kind == "fringe"), key=key)
    for _, members in groupby(fringes, key=key):
        yield list(members)
