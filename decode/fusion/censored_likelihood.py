"""Fusion by maximum likelihood in which a clipped sample still shows on which side of its limit it is.

Tobin's model (Econometrica 26, 24 (1958)): a sample within limits adds ``-(I - mu)^2 / (2 v)`` to the log likelihood, one
clipped above ``log Phi((mu - S) / sqrt v)``, one clipped below ``log Phi((L - mu) / sqrt v)``; mu and v as in
`decode.fusion.least_squares`. For given variances this is concave in the three unknowns, so Newton's method finds the maximum
from the least-squares fit of the unclipped samples; the variances follow mu from step to step.

What a clipped sample contributes fades within a few sigma of its limit: a fringe far beyond is certain to clip. So one exposure
with fewer than three unclipped steps stays undetermined unless its clipped ones are near the limit.
"""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from decode.device import Device, Lanes
from decode.fusion.interface import Samples
from decode.fusion.least_squares import MaskedLeastSquares, fitted, phasor_of, times
from decode.fusion.weighted_fit import Solution, solve, total_of, waves
from decode.phase.n_step import Phasor
from scenes.files.stack import Stack

# Newton's steps at most: a pixel with one clipped sample takes three or four, the worst conflicts of many about eight.
STEPS = 12
# A step that moves the fit by less than this part of its standard deviation is the last: the next would move its square.
SETTLED = 1e-2
# Where the fit is this many sigma beyond a clipped sample's limit, the sample does not constrain it: it carries no
# information, and where it would be needed the likelihood is flat.
CERTAIN = 2.0

# From this many sigma on its Mills ratio, 6e-9, is below float32's rounding next to an unclipped sample: it is not
# computed, which takes as long as all the rest of a sample.
MUTE = 6.0

# erfc(x) = t exp(-x^2 + sum_i c_i t^i) with t = 1 / (1 + x / 2), to 1.2e-7 for all x >= 0 (Press et al., Numerical Recipes,
# section 6.2).
ERFC = (
    -1.26551223,
    1.00002368,
    0.37409196,
    0.09678418,
    -0.18628806,
    0.27886807,
    -1.13520398,
    1.48851587,
    -0.82215223,
    0.17087277,
)


@dataclass(frozen=True)
class CensoredMl(MaskedLeastSquares):
    """Maximum likelihood of all samples, the clipped ones as limits (Tobin 1958): in variance the best any rule can
    do, once the light suffices for the Gaussian limit. Predicted variance: the inverse of the information.

    Rounding counts as noise of variance 1/12 and puts the limits half a DN inside. Where nothing is clipped this is
    `MaskedLeastSquares`, number for number.
    """

    lowest_dn: float = -np.inf
    """A sample at or below this is clipped; learnt from the stack's sensor."""
    rounding_dn: float = 0.0
    """How far from its digital number the true value may be; learnt from the stack's sensor."""

    def prepare(self, stack: Stack) -> Self:
        """Learn from the sensor whether it rounds, and clips at 0."""
        return replace(self, lowest_dn=0.0, rounding_dn=0.5) if stack.sensor.bits else self

    def fuse(self, samples: Samples) -> Phasor:
        """The most likely phasor in DN of the longest exposure; usable where the samples determine it."""
        dr = samples.device.dr
        masks = self.mask(samples)
        start = fitted(samples, masks)
        if samples.saturation_dn == np.inf and self.lowest_dn == -np.inf:
            return phasor_of(samples, start, masks)
        good = start.determined
        unclipped, darkest = good, samples.dn[0][0]
        for steps, unsaturated in zip(samples.dn, masks, strict=True):
            for dn, below in zip(steps, unsaturated, strict=True):
                unclipped = unclipped & below
                darkest = dr.select(dn < darkest, dn, darkest)
        clipped = ~(unclipped & (darkest > self.lowest_dn))
        # Where unclipped samples alone determine nothing, begin with the shortest exposure's clipped ones at their limits.
        shortest = samples.by_time[0]
        naive, per_time = samples.phasor(shortest), 1.0 / min(times(samples))
        state = (
            dr.select(good, start.offset, (naive.offset - samples.black_level_dn) * per_time),
            dr.select(good, start.cosine, naive.cosine * per_time),
            dr.select(good, start.sine, naive.sine * per_time),
        )
        offset, cosine, sine, variance, determined, _, _ = dr.while_loop(
            (*state, start.variance_rad2, good, samples.device.types.UInt32(0), clipped),
            lambda *s: s[6],
            lambda *s: self._newton(samples, s[:3], s[5]),
            label="newton",
        )
        return phasor_of(samples, Solution(offset, cosine, sine, variance, determined), masks)

    def _newton(self, samples: Samples, at: tuple[Lanes, ...], count: Lanes) -> tuple[Lanes, ...]:
        """One step of Newton's method, and the variance and determinacy where it started."""
        device = samples.device
        dr = device.dr
        offset, cosine, sine = at
        shapes = list(zip(*waves(samples.fringes), strict=True))
        score: list[Lanes] = []
        bend: list[Lanes] = []
        known: list[Lanes] = []
        for n, (c, s) in enumerate(shapes):
            light = offset + cosine * float(c) + sine * float(s)
            parts = [self._sample(samples, k, n, light) for k in range(len(samples.exposure_ms))]
            for sums, part in zip((score, bend, known), zip(*parts, strict=True), strict=True):
                sums.append(total_of(part))
        move = solve(device, samples.fringes, bend, score)
        go = move.determined
        change = [dr.select(go, x, 0.0) for x in (move.offset, move.cosine, move.sine)]
        gain = total_of(
            [
                g * (change[0] + change[1] * float(c) + change[2] * float(s))
                for g, (c, s) in zip(score, shapes, strict=True)
            ]
        )
        here = solve(device, samples.fringes, known, score, at=(cosine, sine))
        return (
            offset + change[0],
            cosine + change[1],
            sine + change[2],
            here.variance_rad2,
            here.determined,
            count + 1,
            go & (gain > SETTLED**2) & (count + 1 < STEPS),
        )

    def _sample(self, samples: Samples, k: int, n: int, light: Lanes) -> tuple[Lanes, Lanes, Lanes]:
        """A sample's slope and curvature of the log likelihood along E_n, and the part of the latter that is knowledge."""
        dr = samples.device.dr
        dn, time = samples.dn[k][n], times(samples)[k]
        constant, slope = samples.noise[k]
        mu = light * time
        root = dr.rsqrt(constant + slope * samples.device.positive(mu))
        precision = root * root
        high, low = dn >= samples.saturation_dn, dn <= self.lowest_dn
        clipped = high | low
        top = samples.saturation_dn - self.rounding_dn - samples.black_level_dn
        bottom = max(self.lowest_dn, -1e30) + self.rounding_dn - samples.black_level_dn
        z = dr.select(high, mu - min(top, 1e30), bottom - mu) * root
        ratio = dr.if_stmt(
            (z,),
            clipped & (z < MUTE),
            lambda z: mills(samples.device, z),
            lambda z: dr.zeros(type(z)),
        )
        inside = (dn - samples.black_level_dn - mu) * precision
        outside = dr.select(high, ratio, -ratio) * root
        bend = dr.select(clipped, ratio * (z + ratio), 1.0) * (precision * time**2)
        return (
            dr.select(clipped, outside, inside) * time,
            bend,
            dr.select(high & (z > CERTAIN), 0.0, bend),
        )


def mills(device: Device, z: Any) -> Lanes:
    """``phi(z) / Phi(z)`` of float32 lanes, the slope of log Phi, good to 1e-6 of itself, or of 1."""
    dr = device.dr
    x = dr.abs(z) * float(np.sqrt(0.5))
    t = 1.0 / (1.0 + 0.5 * x)
    exponent = device.types.Float(ERFC[-1])
    for coefficient in ERFC[-2::-1]:
        exponent = dr.fma(exponent, t, coefficient)
    # erfc(x) exp(x^2): one tail's probability over its density, but for a constant.
    scaled, bell = t * dr.exp(exponent), dr.exp(-x * x)
    below = z < 0.0
    over = dr.select(below, 1.0, bell) * float(np.sqrt(2.0 / np.pi))
    return over / dr.select(below, scaled, 2.0 - scaled * bell)
