"""Fusion by weighted least squares over samples of all exposures.

Sample n of exposure k has the mean ``d + t_k E_n`` with ``E_n = a + b cos(phi + delta_n)``, and the variance
``constant_k + slope_k t_k E_n``. All exposures of a step see the same E_n, so they enter through two sums,
``S_n = sum_k t_k^2 / v_nk`` and ``R_n = sum_k t_k (I_nk - d) / v_nk``; three unknowns are then fitted to N steps
(Greivenkamp 1984, weighted), and the inverse of the normal matrix is the covariance.

Variances are taken at each step's mean brightness over the exposures, not at each sample itself: noise that sets its own
weight biases the mean. What is left of that is below 1 % of sigma from 10 electrons a sample up.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from decode.device import Lanes
from decode.fusion.interface import MERGED, FusionRule, Samples
from decode.fusion.weighted_fit import Solution, solve
from decode.phase.n_step import Phasor

# A product this small or, inverted, this large is far from float32's ends, 1e-38 and 3e38.
SMALL = 1e-30


@dataclass(frozen=True)
class WeightedLeastSquares(FusionRule):
    """What the rules share: the fit, with variances taken at each step's own mean brightness over the exposures."""

    @abstractmethod
    def mask(self, samples: Samples) -> list[list[Lanes]]:
        """Which samples count: booleans, ``[exposure][step]``."""

    def fuse(self, samples: Samples) -> Phasor:
        """The fit's phasor in DN of the longest exposure that counts; the shortest exposure's where nothing is determined."""
        masks = self.mask(samples)
        found = fitted(samples, masks)
        phasor = phasor_of(samples, found, masks)
        shortest = samples.phasor(samples.by_time[0])
        return samples.select(found.determined, phasor, shortest)


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


def times(samples: Samples) -> list[float]:
    """Exposure times in units of their range's geometric middle: the fit multiplies weights, which go with the time's square,
    and in ms those of nanoseconds or minutes would leave float32's range.
    """
    unit_ms = math.sqrt(min(samples.exposure_ms) * max(samples.exposure_ms))
    return [time_ms / unit_ms for time_ms in samples.exposure_ms]


def fitted(samples: Samples, masks: list[list[Lanes]]) -> Solution:
    """The fit to the samples that count, ``[exposure][step]``, in DN per unit of time (see `times`)."""
    dr, types = samples.device.dr, samples.device.types
    t = times(samples)
    weight, pull = [], []
    for n in range(len(samples.fringes.frames)):
        counts = [mask[n] for mask in masks]
        above = [steps[n] - samples.black_level_dn for steps in samples.dn]
        s = r = types.Float(0.0)
        for k, precision in enumerate(precisions(samples, counts, above)):
            gain = dr.select(counts[k], precision, 0.0)
            s = dr.fma(gain, t[k], s)
            r = dr.fma(gain, above[k], r)
        weight.append(s)
        pull.append(r)
    return solve(samples.device, samples.fringes, weight, pull)


def precisions(samples: Samples, counts: Sequence[Lanes], above: Sequence[Lanes]) -> list[Lanes]:
    """``t_k / v_k`` of one step in each exposure, by its digital numbers `above` black and which of them count; where none
    does, anything.

    The step's brightness is its own: ``E = D / T`` with ``D = sum_k (I_k - d)`` and ``T = sum_k t_k`` over the samples that
    count, which is best in pure shot noise. So the precision is ``T / (constant_k T / t_k + slope_k D)``, one division
    where E would be another; and one is enough for several exposures. Dividing was half the time of decoding.
    """
    dr, device, t = samples.device.dr, samples.device, times(samples)
    if not any(slope for _, slope in samples.noise):
        terms = zip(t, samples.noise, strict=True)
        return [device.types.Float(time / constant) for time, (constant, _) in terms]
    total_time = total = device.types.Float(0.0)
    for time, count, dn in zip(t, counts, above, strict=True):
        total_time = dr.select(count, total_time + time, total_time)
        total = dr.select(count, total + dn, total)
    total = device.positive(total)
    found: list[Lanes] = []
    for group in _together(samples):
        under = [
            dr.fma(total_time, samples.noise[k][0] / t[k], total * samples.noise[k][1])
            for k in group
        ]
        found += quotients(total_time, under)
    return found


def _together(samples: Samples) -> list[list[int]]:
    """Exposures in groups small enough for float32 to hold the product of their denominators in `precisions`."""
    t = times(samples)
    groups: list[list[int]] = []
    least = most = 1.0
    for k, (constant, slope) in enumerate(samples.noise):
        low = constant / t[k] * min(t)
        high = constant / t[k] * sum(t) + slope * len(t) * samples.saturation_dn
        least, most = least * low, most * high
        if not groups or least < SMALL or most > 1.0 / SMALL:
            groups.append([])
            least, most = low, high
        groups[-1].append(k)
    return groups


def quotients(over: Lanes, under: Sequence[Lanes]) -> list[Lanes]:
    """`over` divided by each of `under`, by one division: by their product, in pairs of pairs (Montgomery 1987)."""
    if len(under) == 1:
        return [over / under[0]]
    pairs = list(zip(under[::2], under[1::2], strict=False))
    alone = list(under[2 * len(pairs) :])
    parts = quotients(over, [a * b for a, b in pairs] + alone)
    found = [part * other for part, (a, b) in zip(parts, pairs, strict=False) for other in (b, a)]
    return found + parts[len(pairs) :]


def phasor_of(samples: Samples, found: Solution, masks: list[list[Lanes]]) -> Phasor:
    """The fit as a phasor in DN of the longest exposure with a sample that counts, ``[exposure][step]``."""
    dr, types = samples.device.dr, samples.device.types
    t, time = times(samples), types.Float(0.0)
    for k in samples.by_time:
        some = masks[k][0]
        for mask in masks[k][1:]:
            some = some if mask is some else some | mask
        time = dr.select(some, t[k], time)
    return Phasor(
        cosine=found.cosine * time,
        sine=found.sine * time,
        offset=dr.fma(found.offset, time, samples.black_level_dn),
        variance_rad2=found.variance_rad2,
        usable=found.determined,
        exposure=types.UInt32(MERGED),
    )
