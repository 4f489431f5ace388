"""Errors that are no sensor noise, from signs that a decoder sees: mixed pixels, blur, and light from other surfaces.

A mixed pixel sees two heights and reports one between or beyond them, so it differs from its neighbours on every side by more
than noise and slope explain. Where brightness changes within the blur of lens and pixels, the brighter side's phase prevails,
by an amount that follows from the gradients of brightness and phase. Indirect light carries coarse fringes better than fine
ones (Nayar et al. 2006): it takes modulation from the finest fringes, and turns their phase by up to the modulation lost over
that left. Where a whole surface is rough, as grains are, differences do not show which pixels are wrong, only by how much: the
sigma grows, and none is rejected. Measured in docs/decoding.md.
"""

from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from decode.phase.n_step import TURN
from decode.reason import Reason
from decode.reconstruction import CAUSES, Reconstruction
from decode.validity.limits import DIM_RAD2
from decode.validity.uneven_light import SOBEL, SQUARE_PX2, relative_slope

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Largest deviation among 8 neighbours, in sensor sigmas, that noise exceeds in 0.5 % of pixels (each deviation has sqrt(2)
# sigma); and one that the median of 5 x 5 pixels never exceeds: there it is 2.3, give or take 0.13.
NOISE, USUAL_NOISE = 4.75, 3.1
# Sigma per mm of deviation: of the pixel's own, and of the region's median; and sigma per rad of the blur's formula, whose
# variance contains the projector's blur, too. Near the best logarithmic score on the scenes for tuning (docs/decoding.md).
OWN, REGION, BLUR = 0.4, 0.7, 0.5
# A pixel next to an unlit one has the height of its lit part. Its sigma is this part of the fringe's change over one pixel.
PARTLY_LIT = 0.2
# A pixel is mixed whose sigma of blur is above so many rad, or that deviates by so many and by so many times the region's
# deviation (else the region is rough), and from each side by 1/8 rad (else it is a clean pixel next to an edge).
MIXED_RAD, OUTSTANDING = 0.2, 3.5
# The blur's variance where one period alone does not show it, px^2.
USUAL_BLUR_PX2 = 1.0
# Phase sigma per unit of (modulation lost / modulation left), tuned likewise; and the part lost at which a pixel is stray:
# indirect light then has half the direct light's fringes.
PER_LOSS, STRAY_LOSS = 0.5, 1.0 / 3.0
# Best surfaces: this quantile of the visibility shows what the optics leave. Losses below this, or below three standard
# deviations of their noise, are none.
BEST, NO_LOSS, SURE = 0.75, 0.03, 3.0
# A surface loses light to its inside, or to others, where this loss ...
LOST = 0.25
# ... or, to see what causes it, this one holds in most of 5 x 5 pixels.
SPREAD = 0.15
# Pixels that show what the optics leave.
SAMPLE = 16384


@dataclass(frozen=True)
class Signs:
    """What the fringes show besides heights; images are (row, col)."""

    periods_px: tuple[float, ...]
    """Coarsest first."""
    visibility: tuple[Image, ...]
    """B / A of each period; none for Gray code alone."""
    sigma_rad: Image
    """Sensor noise of the finest phase."""
    mm_per_rad: Image
    """Height per phase of the finest fringes."""
    level: Image | None = None
    """Brightness of the fringes in any unit (`shadow.level`); None for Gray code alone."""


def by_cause(rec: Reconstruction, signs: Signs) -> tuple[Reconstruction, float]:
    """The reconstruction with sigmas by cause, and pixels rejected as `mixed` and `stray`.

    Parameters
    ----------
    rec
        Heights with the sensor's sigma, of one projector.
    signs
        Of the same pixels.

    Returns
    -------
    Reconstruction
        With `cause_sigma_mm`; images (row, col).
    float
        Share of valid pixels, 0 to 1, on surfaces that lose a quarter of the fine modulation, and not to blur.
    """
    valid = rec.valid & np.isfinite(rec.height_mm) & np.isfinite(rec.sigma_mm)
    nothing = np.zeros(valid.shape, np.float32)
    if not valid.any():
        return replace(rec, cause_sigma_mm=dict.fromkeys(CAUSES, nothing)), 0.0
    scale = np.where(valid, np.nan_to_num(signs.mm_per_rad), np.float32(0.0))
    mixed, outstanding, smooth = _mixed(rec, valid, scale)
    *slope, frequency = _fringes(rec, signs.periods_px[-1]) if signs.periods_px else [nothing] * 3
    unlit = np.isin(rec.reason, (Reason.SHADOW, Reason.DARK)).astype(np.uint8)
    next_to_unlit = cv2.dilate(unlit, np.ones((3, 3), np.uint8)) > 0
    mixed = np.where(next_to_unlit, np.maximum(mixed, PARTLY_LIT * TURN * frequency * scale), mixed)
    loss, lost = _loss(signs, frequency, smooth, valid)
    blur_rad = BLUR * _blur_rad(signs, slope, _blur_px2(signs, frequency, smooth), valid)
    reason = rec.reason.copy()
    reason[valid & (loss > STRAY_LOSS)] = Reason.STRAY
    reason[outstanding | (blur_rad > MIXED_RAD)] = Reason.MIXED
    sigmas = {
        "mixed": mixed,
        "stray": PER_LOSS * scale * loss / (1.0 - loss),
        "blur": scale * blur_rad,
    }
    sigmas = {cause: np.where(valid, mm, 0.0).astype(np.float32) for cause, mm in sigmas.items()}
    return replace(rec, reason=reason, cause_sigma_mm=sigmas), lost


def across_projectors(rec: Reconstruction) -> Reconstruction:
    """With the sigma `mixed` that neighbours show which other projectors measured, or more of them.

    Neighbours that some projectors do not see have other biases: the height of all projectors shows it, that of one does not.
    """
    valid = rec.valid & np.isfinite(rec.height_mm) & np.isfinite(rec.sigma_mm)
    if not valid.any():
        return rec
    causes, nothing = dict(rec.cause_sigma_mm), np.zeros(valid.shape, np.float32)
    causes["mixed"] = np.where(
        valid, np.maximum(causes["mixed"], _mixed(rec, valid, nothing)[0]), causes["mixed"]
    )
    return replace(rec, cause_sigma_mm=causes)


def _mixed(rec: Reconstruction, valid: Mask, scale: Image) -> tuple[Image, Mask, Mask]:
    """Sigma from differences to neighbours in mm; which pixels agree with no side of theirs, and are no part of a rough
    region; and where neighbours do not differ; each (row, col). `scale` is mm per rad."""
    most, side, noise_mm = _deviation(rec, valid)
    own, usual = (_beyond(most, k * noise_mm) for k in (NOISE, USUAL_NOISE))
    region = cv2.medianBlur(usual, 5)
    outstanding = (own > MIXED_RAD * scale) & (own > OUTSTANDING * cv2.blur(region, (7, 7)))
    outstanding &= _beyond(side, NOISE * noise_mm) > np.sqrt(DIM_RAD2) * scale
    return np.maximum(OWN * own, REGION * region), valid & outstanding, valid & (own <= 0.0)


def _beyond(value: Image, limit: Image) -> Image:
    """What is left of a value when noise of this size is taken out, as squares."""
    left: Image = np.sqrt(np.maximum(value**2 - limit**2, 0.0)).astype(np.float32)
    return left


def _deviation(rec: Reconstruction, valid: Mask) -> tuple[Image, Image, Image]:
    """Largest difference to a valid neighbour beyond the local slope; the same for the three neighbours of one side, of
    the side that differs least; and sensor noise around; (row, col) in mm."""
    middle = np.float32(np.median(rec.height_mm[valid]))
    height = np.where(valid, rec.height_mm - middle, np.float32(0.0))
    count = np.maximum(cv2.blur(valid.astype(np.float32), (3, 3)), np.float32(1e-6))
    filled = np.where(valid, height, cv2.blur(height, (3, 3)) / count)
    down, right = (cv2.medianBlur(np.asarray(g, np.float32), 5) for g in _gradient(filled))
    variance = np.where(valid, rec.sigma_mm**2, np.float32(0.0))
    rows, columns = valid.shape
    around, known = np.pad(height, 1), np.pad(valid, 1)
    most = np.zeros_like(height)
    sides = {side: np.zeros_like(height) for side in ((-1, 0), (1, 0), (0, -1), (0, 1))}
    for dy, dx in product((-1, 0, 1), repeat=2):
        there = np.s_[1 + dy : 1 + dy + rows, 1 + dx : 1 + dx + columns]
        apart = np.abs(around[there] - height - dy * down - dx * right)
        np.maximum(most, apart, out=most, where=known[there] & valid)
        apart[~known[there]] = np.inf
        for side in {(dy, 0), (0, dx)} & sides.keys():
            np.maximum(sides[side], apart, out=sides[side])
    least = np.minimum.reduce(list(sides.values()))
    return most, np.minimum(least, most), np.sqrt(cv2.blur(variance, (3, 3)) / count)


def _gradient(image: NDArray[np.floating]) -> list[NDArray[np.floating]]:
    """Differences down and right per px; 0 along a side of one pixel."""
    return [
        np.gradient(image, axis=axis) if image.shape[axis] > 1 else np.zeros_like(image)
        for axis in (0, 1)
    ]


def _fringes(rec: Reconstruction, period_px: float) -> tuple[Image, Image, Image]:
    """Fringes per camera pixel of the surface around: down, right and along the steepest, (row, col), at most 1."""
    parts = _gradient(rec.phases[rec.axis].coordinate_px / period_px)
    parts.append(np.hypot(*parts))
    down, right, steepest = (
        np.asarray(cv2.medianBlur(np.clip(np.nan_to_num(part), -1.0, 1.0).astype(np.float32), 5))
        for part in parts
    )
    return down, right, steepest


def _blur_rad(signs: Signs, slope: list[Image], variance_px2: float, valid: Mask) -> Image:
    """How far the phase is turned where light comes from the brighter side of a pixel's blur, (row, col) in rad."""
    if signs.level is None:
        return np.zeros(valid.shape, np.float32)
    right, down = relative_slope(np.maximum(np.nan_to_num(signs.level, posinf=0.0), 0.0))
    with np.errstate(invalid="ignore"):  # No light, no slope.
        along = np.where(valid, slope[0] * down + slope[1] * right, 0.0)
    noise = SURE * SOBEL * np.hypot(*slope) * np.where(valid, signs.sigma_rad, 0.0)
    turned: Image = TURN * variance_px2 * _beyond(along, noise.astype(np.float32))
    return turned


def _blur_px2(signs: Signs, frequency: Image, smooth: Mask) -> float:
    """Variance of the blur in px^2, from the modulation that the finest fringes lose, which contains the projector's blur."""
    if not signs.visibility or signs.periods_px[0] < 2.0 * signs.periods_px[-1]:
        return USUAL_BLUR_PX2
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.log(signs.visibility[-1] / signs.visibility[0]) / (TURN * frequency) ** 2
    left = left[smooth & np.isfinite(left)]
    return max(SQUARE_PX2, -2.0 * float(np.median(left))) if left.size else USUAL_BLUR_PX2


def _loss(signs: Signs, frequency: Image, smooth: Mask, valid: Mask) -> tuple[Image, float]:
    """Share of the finest modulation that is lost beyond optics and noise, (row, col) from 0 to less than 1; and the
    share of valid pixels of which much is lost."""
    nothing = np.zeros(valid.shape, np.float32)
    if not signs.visibility or not smooth.any():
        return nothing, 0.0
    coarse, fine = signs.visibility[0], signs.visibility[-1]
    period_px = signs.periods_px[-1]
    relative = signs.periods_px[0] >= 2.0 * period_px
    # One period, or all alike: only the fine fringes' own visibility is left to look at.
    with np.errstate(divide="ignore", invalid="ignore"):
        left = [visibility / coarse for visibility in signs.visibility[-2:]]
    raw = _below_best(left[-1] if relative else fine, frequency, smooth)
    noise = np.sqrt(2.0 if relative else 1.0) * np.nan_to_num(signs.sigma_rad, nan=1.0)
    mean = cv2.blur(raw, (3, 3)) - SURE / 3.0 * cv2.blur(noise, (3, 3))
    loss = np.where(valid, np.clip(np.maximum(raw - SURE * noise, mean) - NO_LOSS, 0.0, 0.99), 0.0)
    typical = cv2.medianBlur(np.where(valid, raw, np.float32(0.0)), 5)
    spread = valid & (typical > SPREAD)
    if len(signs.periods_px) > 2 and spread.any():
        # Blur takes 1 / ratio^2 of the loss from a coarser period, light that spreads about 1 / ratio.
        ratio = signs.periods_px[-2] / period_px
        middle = _below_best(left[0], frequency, smooth)
        middle = cv2.medianBlur(np.where(valid, middle, np.float32(0.0)), 5)
        if middle[spread].sum() < ratio**-1.5 * typical[spread].sum():
            return nothing, 0.0
    lost = float((valid & (typical > LOST)).sum() / valid.sum())
    return loss.astype(np.float32), lost


def _below_best(visibility: Image, frequency: Image, smooth: Mask) -> Image:
    """How far visibility is below that of the best smooth surfaces of the same fringe frequency in the image, as a share.

    Lenses and pixels leave a share that falls with frequency, about exponentially: found by quantile regression.
    """
    usable = np.flatnonzero(smooth & (visibility > 0.0) & np.isfinite(visibility))
    if not usable.size:
        return np.zeros_like(visibility)
    usable = usable[:: max(1, usable.size // SAMPLE)]
    f, y = frequency.reshape(-1)[usable].astype(float), np.log(visibility.reshape(-1)[usable])
    design = np.stack([np.ones_like(f), f], axis=1)
    best = np.array([np.quantile(y, BEST), 0.0])
    # Where all fringes are equally fine, there is no slope to find.
    ridge = 1e-6 * f.size * np.diag([0.0, 1.0])
    for _ in range(30):  # Iteratively reweighted least squares.
        rest = y - design @ best
        weight = np.where(rest > 0.0, BEST, 1.0 - BEST) / np.maximum(np.abs(rest), 1e-4)
        weighted = design * weight[:, None]
        best = np.linalg.solve(weighted.T @ design + ridge, weighted.T @ y)
    if best[1] > 0.0:
        best = np.array([np.quantile(y, BEST), 0.0])
    expected = np.exp(best[0] + best[1] * np.clip(frequency, *np.quantile(f, (0.005, 0.995))))
    below: Image = np.nan_to_num(1.0 - visibility / expected, posinf=0.0, neginf=0.0)
    return below.astype(np.float32)
