"""Fusion by weighted least squares over samples of all exposures.

Sample n of exposure k has the mean ``d + t_k E_n`` with ``E_n = a + b cos(phi + delta_n)`` in DN/ms, and the variance
``constant_k + slope_k t_k E_n``. All exposures of a step see the same E_n, so they enter through two sums,
``S_n = sum_k t_k^2 / v_nk`` and ``R_n = sum_k t_k (I_nk - d) / v_nk``; three unknowns are then fitted to N steps
(Greivenkamp 1984, weighted), and the inverse of the normal matrix is the covariance.

Variances are taken at each step's mean brightness over the exposures, not at each sample itself: noise that sets its own
weight biases the mean. What is left of that is below 1 % of sigma from 10 electrons a sample up.
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from decode.fusion import MERGED, FusionRule, Samples
from decode.phase import NEGLIGIBLE, FringeSet, Phasor

# Where the normal matrix's determinant is this small beside its diagonal's product, float32 has no digits left in it.
SINGULAR = 1e-5


@dataclass(frozen=True)
class Solution:
    """Radiance a, b cos phi, b sin phi in DN/ms, and what the fit knows of them."""

    offset: Lanes
    cosine: Lanes
    sine: Lanes
    variance_rad2: Lanes
    determined: Lanes
    """False where the samples leave the phase open: fewer than three steps with weight."""

    def radiance(self, fringes: FringeSet) -> list[Lanes]:
        """E_n of each step."""
        return [
            self.offset + self.cosine * float(c) + self.sine * float(s)
            for c, s in zip(*waves(fringes), strict=True)
        ]


def waves(fringes: FringeSet) -> NDArray[np.float64]:
    """(2, N): what ``b cos phi`` and ``b sin phi`` add to each step."""
    shifts = np.asarray(fringes.shifts_rad)
    rows = np.stack([np.cos(shifts), -np.sin(shifts)])
    return np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows)


def solve(
    device: Device,
    fringes: FringeSet,
    weight: Sequence[Lanes],
    pull: Sequence[Lanes],
    at: tuple[Lanes, Lanes] | None = None,
) -> Solution:
    """Fit ``a + b cos(phi + delta_n)`` to ``pull_n / weight_n``, of variance ``1 / weight_n``; no weight, no say.

    The phase's variance is taken at the solution, or at another ``(b cos phi, b sin phi)`` given as `at`. The offset is eliminated by centring the waves, which keeps the digits that a difference of products would lose.
    """
    dr = device.dr
    wave = waves(fringes)
    part = dr.rcp(total_of(weight))
    share = [w * part for w in weight]
    level = total_of(pull) * part
    means = [total_of([s * float(x) for s, x in zip(share, row, strict=True) if x]) for row in wave]
    centred = [[float(x) - mean for x in row] for row, mean in zip(wave, means, strict=True)]
    rest = [p - w * level for p, w in zip(pull, weight, strict=True)]
    (x, y) = centred

    def moment(one: Sequence[Lanes], two: Sequence[Lanes]) -> Lanes:
        return total_of([i * j for i, j in zip(one, two, strict=True)])

    weighted = [[w * i for w, i in zip(weight, row, strict=True)] for row in centred]
    xx, xy, yy = moment(weighted[0], x), moment(weighted[0], y), moment(weighted[1], y)
    px, py = moment(x, rest), moment(y, rest)
    det = xx * yy - xy * xy
    inverse = dr.rcp(det)
    cosine, sine = (yy * px - xy * py) * inverse, (xx * py - xy * px) * inverse
    c, s = at or (cosine, sine)
    power = c * c + s * s
    across = s * s * yy + 2.0 * c * s * xy + c * c * xx
    return Solution(
        offset=level - cosine * means[0] - sine * means[1],
        cosine=cosine,
        sine=sine,
        variance_rad2=across * inverse / (power * power),
        # NaN, where nothing has weight, is not greater
        determined=(det > SINGULAR * xx * yy) & (dr.minimum(xx, yy) > 0.0),
    )


def total_of(terms: Sequence[Lanes]) -> Lanes:
    """Sum of lanes, 0 of none."""
    total: Any = 0.0
    for term in terms:
        total = total + term
    return total


@dataclass(frozen=True)
class WeightedLeastSquares(FusionRule):
    """What the rules share: the fit, with variances taken at each step's own mean brightness over the exposures, and at
    the fit's in `refinements` more passes.
    """

    refinements: int = 0

    @abstractmethod
    def mask(self, samples: Samples) -> list[list[Lanes]]:
        """Which samples count, [exposure][step]."""

    def fit(self, samples: Samples) -> tuple[Solution, list[list[Lanes]]]:
        """The fit to the samples that count, and which those are."""
        masks = self.mask(samples)
        if not any(slope for _, slope in samples.noise):
            return fitted(samples, masks, None), masks
        found = fitted(samples, masks, brightness(samples, masks))
        for _ in range(self.refinements):
            found = fitted(samples, masks, found.radiance(samples.fringes))
        return found, masks

    def fuse(self, samples: Samples) -> Phasor:
        """The fit's phasor in DN of the longest exposure that counts; the shortest exposure's where nothing is determined."""
        found, masks = self.fit(samples)
        phasor = phasor_of(samples, found, masks)
        return samples.select(found.determined, phasor, not_usable(samples))


@dataclass(frozen=True)
class InverseVariance(WeightedLeastSquares):
    """Every exposure without a saturated step, weighted by the inverse of its variance (Granados et al. 2010; for noise
    that is alike in all steps the matched filter ``phi = arg sum_k m_k (B_k / sigma_k^2) Z_k`` with
    ``sigma_k^2 = gain A_k + sigma_r^2 + q^2/12``).

    B_k enters through the time, to which it is proportional and which has no noise. Shot noise differs between steps; the
    matched filter knows only its mean, and its efficiency at N = 4 is ``1 - (B sin 2phi / A)^2 / 2``: 3/4 on average at
    full contrast. So each step has its own variance here.
    """

    def mask(self, samples: Samples) -> list[list[Lanes]]:
        """All steps of an exposure, or none."""
        masks = [samples.unsaturated(k) for k in range(len(samples.exposure_ms))]
        return [[m] * len(samples.fringes.frames) for m in masks]


@dataclass(frozen=True)
class MaskedLeastSquares(WeightedLeastSquares):
    """Every unsaturated sample of every exposure, weighted by the inverse of its variance (for one exposure: Chen, He & Hu
    2008). Unbiased while three steps survive, in whichever exposures.
    """

    def mask(self, samples: Samples) -> list[list[Lanes]]:
        """The unsaturated samples."""
        return [[dn < samples.saturation_dn for dn in steps] for steps in samples.dn]


def fitted(samples: Samples, masks: list[list[Lanes]], light: Sequence[Lanes] | None) -> Solution:
    """One weighted fit; the noise model takes each step's radiance from `light`, None if it needs none."""
    dr, types = samples.device.dr, samples.device.types
    weight, pull = [], []
    for n in range(len(samples.fringes.frames)):
        s = r = types.Float(0.0)
        e = None if light is None else samples.device.positive(light[n])
        for k, time_ms in enumerate(samples.exposure_ms):
            constant, slope = samples.noise[k]
            if e is None or not slope:
                gain = types.Float(time_ms / constant)
            else:
                gain = dr.rcp(dr.fma(e, slope, constant / time_ms))
            gain = dr.select(masks[k][n], gain, 0.0)
            s = dr.fma(gain, time_ms, s)
            r = dr.fma(gain, samples.dn[k][n] - samples.black_level_dn, r)
        weight.append(s)
        pull.append(r)
    return solve(samples.device, samples.fringes, weight, pull)


def brightness(samples: Samples, masks: list[list[Lanes]]) -> list[Lanes]:
    """E_n of each step by itself, ``sum_k (I_nk - d) / sum_k t_k`` over the samples that count: best in pure shot noise."""
    dr, types = samples.device.dr, samples.device.types
    light = []
    for n in range(len(samples.fringes.frames)):
        time_ms = dn = types.Float(0.0)
        for k, exposure_ms in enumerate(samples.exposure_ms):
            counts = dr.select(masks[k][n], types.Float(1.0), 0.0)
            time_ms = dr.fma(counts, exposure_ms, time_ms)
            dn = dr.fma(counts, samples.dn[k][n] - samples.black_level_dn, dn)
        # 0 / 0 where nothing counts: no weight will ask for it
        light.append(dn * dr.rcp(time_ms))
    return light


def phasor_of(samples: Samples, found: Solution, masks: list[list[Lanes]]) -> Phasor:
    """The fit as a phasor in DN of the longest exposure with a sample that counts."""
    dr, types = samples.device.dr, samples.device.types
    time_ms = types.Float(0.0)
    for k in samples.by_time:
        some = masks[k][0]
        for mask in masks[k][1:]:
            some = some if mask is some else some | mask
        time_ms = dr.select(some, samples.exposure_ms[k], time_ms)
    return Phasor(
        cosine=found.cosine * time_ms,
        sine=found.sine * time_ms,
        offset=dr.fma(found.offset, time_ms, samples.black_level_dn),
        variance_rad2=found.variance_rad2,
        usable=found.determined,
        exposure=types.UInt32(MERGED),
    )


def not_usable(samples: Samples) -> Phasor:
    """The shortest exposure's phasor, for pixels in which nothing better is left."""
    return samples.phasor(samples.by_time[0])
