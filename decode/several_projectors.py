"""One height from those of several projectors: an M-estimate per pixel (Huber 1964).

Where projectors agree it is their mean, each weighted by its total sigma: nothing has a smaller variance. Indirect light
biases projectors differently, though, and taking the one with the smallest sigma lets a little noise decide whose bias a
pixel has. This estimate changes continuously with the heights instead, and none of them can pull it by more than `CORNER`
sigmas of the others' mean.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from decode.reconstruction import AxisPhase, Reconstruction

Image = NDArray[np.float32]
Floats = NDArray[np.floating]

# A height farther from the estimate pulls no more: standard deviations of a height's distance from the mean of all. Noise
# alone exceeds them in 0.3 %.
CORNER = 3.0
# Pixels at a time, so that what is computed on the way takes little memory.
BLOCK = 1 << 16
TINY = np.finfo(np.float32).tiny


@dataclass(frozen=True, eq=False)
class Heights:
    """What is kept of each projector; images are (row, col)."""

    height_mm: Image
    sigma_mm: Image
    cause_sigma_mm: Mapping[str, Image]
    valid: NDArray[np.bool_]

    @classmethod
    def of(cls, rec: Reconstruction) -> Self:
        """Those of a reconstruction by one projector."""
        return cls(rec.height_mm, rec.sigma_mm, rec.cause_sigma_mm, rec.valid)


def better(one: Reconstruction, two: Reconstruction) -> Reconstruction:
    """Per pixel the valid one with the smaller predicted sigma, of all causes that were looked for."""
    take = two.valid & (~one.valid | (two.total_sigma_mm < one.total_sigma_mm))
    images = (
        "height_mm",
        "sigma_mm",
        "modulation_dn",
        "offset_dn",
        "reason",
        "exposure",
        "projector",
    )
    phases = {
        axis: AxisPhase(
            phase.period_px,
            np.where(take, two.phases[axis].wrapped_rad, phase.wrapped_rad),
            np.where(take, two.phases[axis].order, phase.order),
        )
        for axis, phase in one.phases.items()
        if axis in two.phases and two.phases[axis].period_px == phase.period_px
    }
    merged = {name: np.where(take, getattr(two, name), getattr(one, name)) for name in images}
    causes = {
        cause: np.where(take, two.cause_sigma_mm[cause], sigma)
        for cause, sigma in one.cause_sigma_mm.items()
    }
    return replace(one, phases=phases, cause_sigma_mm=causes, **merged)


def of_all(best: Reconstruction, each: Sequence[Heights]) -> Reconstruction:
    """The best projector's reconstruction with the height of all valid ones, and its sigmas.

    Noise is independent between projectors; other causes are taken to be common to them, so their sigmas do not average out.
    """
    images = [best.height_mm, best.sigma_mm, *best.cause_sigma_mm.values()]
    flat = [np.array(image, np.float32).reshape(-1) for image in images]
    kept = [(o.height_mm, o.sigma_mm, *o.cause_sigma_mm.values()) for o in each]
    for start in range(0, flat[0].size, BLOCK):
        at = slice(start, start + BLOCK)
        valid = np.stack([one.valid.reshape(-1)[at] for one in each])
        # From the best one's height, as numbers of 32 bits keep more digits of what is near zero.
        parts = [np.stack([i.reshape(-1)[at] for i in part]) for part in zip(*kept, strict=True)]
        apart, *sigmas = (np.where(valid, part, np.float32(0.0)) for part in parts)
        apart -= np.where(valid, flat[0][at], np.float32(0.0))
        variance = np.sum(np.square(sigmas), axis=0)
        known = np.isfinite(apart + variance) & (variance > TINY)
        weight = np.divide(1.0, variance, out=np.zeros_like(apart), where=known)
        usable = (valid.sum(axis=0) > 1) & (known | ~valid).all(axis=0)
        shift, share = estimate(np.where(usable, apart, 0.0), np.where(usable, weight, 0.0))
        told = share.any(axis=0)
        flat[0][at] += np.where(told, shift, np.float32(0.0))
        own, *causes = (share * np.where(known, sigma, np.float32(0.0)) for sigma in sigmas)
        common = (cause.sum(axis=0) for cause in causes)
        for image, sigma in zip(flat[1:], (np.sqrt((own**2).sum(axis=0)), *common), strict=True):
            np.copyto(image[at], sigma, where=told)
    height, sigma, *rest = (image.reshape(best.reason.shape) for image in flat)
    named = dict(zip(best.cause_sigma_mm, rest, strict=True))
    return replace(best, height_mm=height, sigma_mm=sigma, cause_sigma_mm=named)


def estimate(height: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Where the sum of Huber's losses is least, and its derivative by each height.

    The loss of a height is ``weight r^2 / 2`` of its residual r and linear from where ``weight |r| = CORNER sqrt(weight (1 -
    weight / W))``, W the sum of weights: `CORNER` standard deviations of the residual where noise alone is at work.

    Parameters
    ----------
    height
        (projector, pixel).
    weight
        1 / variance, (projector, pixel); 0: not valid.

    Returns
    -------
    Floats
        (pixel).
    Floats
        (projector, pixel), 0 beyond the corner: there a height pulls, but moving it changes nothing. All are 0 where none is
        valid, and where two disagree, so that nothing tells which is right.
    """
    whole = weight.sum(axis=0)
    share = np.divide(weight, whole, out=np.zeros_like(weight), where=whole > 0.0)
    middle = (share * height).sum(axis=0)
    most = CORNER * np.sqrt(weight * (1.0 - share))
    apart = ~(np.abs(middle - height) * weight <= most).all(axis=0)
    share[:, apart] = 0.0
    far = np.flatnonzero(apart & (np.count_nonzero(weight, axis=0) > 2))
    height, weight, most = height[:, far], weight[:, far], most[:, far]
    reach = np.divide(most, weight, out=np.zeros_like(most), where=weight > 0.0)
    # The pull of all heights rises, straight between corners.
    corners = np.concatenate([height - reach, height + reach])
    pulls = np.stack([np.clip((x - height) * weight, -most, most).sum(axis=0) for x in corners])
    below = np.where(pulls <= 0.0, corners, -np.inf).argmax(axis=0)[None]
    above = np.where(pulls >= 0.0, corners, np.inf).argmin(axis=0)[None]
    (low,), (high,) = (np.take_along_axis(corners, i, axis=0) for i in (below, above))
    (down,), (up,) = (np.take_along_axis(pulls, i, axis=0) for i in (below, above))
    rise = np.divide(-down, up - down, out=np.full_like(low, 0.5), where=up > down)
    middle[far] = low + rise * (high - low)
    inside = np.where(np.abs(middle[far] - height) * weight < most, weight, 0.0)
    total = inside.sum(axis=0)
    share[:, far] = np.divide(inside, total, out=np.zeros_like(inside), where=total > 0.0)
    return middle, share
