"""A fringe's offset and phasor fitted to steps of unequal weight, and the covariance that the fit predicts.

Minimises ``sum_n S_n (a + b cos(phi + delta_n) - R_n / S_n)^2``; S_n is a step's weight, R_n its weighted value.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from decode.phase.n_step import (
    NEGLIGIBLE,
    FringeSet,
    inverse,
    solution,
    variance_rad2,
    weighted_sum,
)
from scenes.acquisition.fringe_fit import fringe_design

# Where the normal matrix's determinant is this small compared with its diagonal's product, float32 has no digits left in it.
SINGULAR = 1e-5


@dataclass(frozen=True)
class Solution:
    """a, b cos phi, b sin phi in DN per unit of time, and what the fit knows of them."""

    offset: Lanes
    cosine: Lanes
    sine: Lanes
    variance_rad2: Lanes
    determined: Lanes
    """False where the samples leave the phase open: fewer than three steps with weight."""


def waves(fringes: FringeSet) -> NDArray[np.float64]:
    """What ``b cos phi`` and ``b sin phi`` add to each of N steps, (2, N)."""
    rows = fringe_design(fringes.shifts_rad)[:, 1:].T
    return np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows)


def solve(
    device: Device,
    fringes: FringeSet,
    weight: Sequence[Lanes],
    pull: Sequence[Lanes],
    at: tuple[Lanes, Lanes] | None = None,
) -> Solution:
    """Fit ``a + b cos(phi + delta_n)`` to values of unequal weight: `weight` is their inverse variance, `pull` weight
    times value.

    `at`: ``(b cos phi, b sin phi)`` at which the phase's variance in rad^2 is taken; None: at the solution.
    """
    if all(w.index == weight[0].index for w in weight):
        return _even(fringes, weight[0], pull, at)
    wave = waves(fringes)
    quarters = _quarters(wave)
    if quarters is None:
        return _centred(device, wave, weight, pull, at)
    return _crossed(device, quarters, weight, pull, at)


def _quarters(wave: NDArray[np.float64]) -> tuple[int, int, int, int] | None:
    """Of four steps a quarter turn apart, those with the shifts 0, pi, -pi/2 and pi/2; None of others."""
    if wave.shape[1] != 4:
        return None
    first, second = (np.argmax(row) for row in wave)
    opposite, last = (np.argmin(row) for row in wave)
    order = int(first), int(opposite), int(second), int(last)
    ideal = np.array([[1.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, -1.0]])
    return order if np.abs(wave[:, order] - ideal).max() < NEGLIGIBLE else None


def _even(
    fringes: FringeSet, weight: Lanes, pull: Sequence[Lanes], at: tuple[Lanes, Lanes] | None
) -> Solution:
    """Steps of one weight: the plain N-step phasor."""
    x, y = waves(fringes) - waves(fringes).mean(axis=1, keepdims=True)
    singular = (x @ x) * (y @ y) - (x @ y) ** 2 <= SINGULAR * (x @ x) * (y @ y)
    variance = 1.0 / weight
    offset, cosine, sine = (weighted_sum(row, pull) * variance for row in solution(fringes))
    return Solution(
        offset=offset,
        cosine=cosine,
        sine=sine,
        variance_rad2=variance_rad2(fringes, *(at or (cosine, sine)), variance, slope=0.0),
        determined=(weight > 0.0) & (not singular),
    )


def _crossed(
    device: Device,
    order: tuple[int, int, int, int],
    weight: Sequence[Lanes],
    pull: Sequence[Lanes],
    at: tuple[Lanes, Lanes] | None,
) -> Solution:
    """Four steps a quarter turn apart, half the work of `_centred`: two know ``a +- b cos phi``, two ``a +- b sin phi``.

    Either pair's mean is an a; from the a that weighs both, each pair's difference gives its component.
    """
    dr = device.dr
    (s0, s1, s2, s3), (r0, r1, r2, r3) = ([of[i] for i in order] for of in (weight, pull))
    u, v = s0 + s1, s2 + s3
    both, half_x, half_y = u * v, s0 * s1, s2 * s3
    shared = dr.fma(half_y, u, half_x * v)
    level = dr.fma(dr.fma(r2, s3, r3 * s2), u, dr.fma(r0, s1, r1 * s0) * v)
    per_shared = dr.rcp(shared)
    offset = level * per_shared * 0.5
    dx, dy = s0 - s1, s2 - s3
    per_both = dr.rcp(both)
    cosine = dr.fma(-dx, offset, r0 - r1) * (v * per_both)
    sine = dr.fma(-dy, offset, r2 - r3) * (u * per_both)
    # The centred normal matrix times the weights' sum.
    xx, yy = dr.fma(half_x, 4.0, both), dr.fma(half_y, 4.0, both)
    c, s = at or (cosine, sine)
    across = s * s * yy - 2.0 * c * s * (dx * dy) + c * c * xx
    per_power = inverse(c * c + s * s)
    return Solution(
        offset=offset,
        cosine=cosine,
        sine=sine,
        variance_rad2=across * (0.25 * per_shared) * per_power * per_power,
        # Products of two weights: for four float32 has not always room. NaN, where nothing has weight, is not greater.
        determined=shared * per_both * (u + v) > xx * (yy * per_both) * (0.25 * SINGULAR),
    )


def _centred(
    device: Device,
    wave: NDArray[np.float64],
    weight: Sequence[Lanes],
    pull: Sequence[Lanes],
    at: tuple[Lanes, Lanes] | None,
) -> Solution:
    """Any steps: the offset is eliminated by centring the waves, which keeps the digits that a difference of products would
    lose.
    """
    dr = device.dr
    total = total_of(weight)
    part = dr.rcp(total)
    level = total_of(pull) * part
    means = [weighted_sum(row, weight) * part for row in wave]
    x, y = ([float(w) - mean for w in row] for row, mean in zip(wave, means, strict=True))
    rest = [dr.fma(-w, level, p) for p, w in zip(pull, weight, strict=True)]

    def moment(one: Sequence[Lanes], two: Sequence[Lanes]) -> Lanes:
        total = one[0] * two[0]
        for i, j in zip(one[1:], two[1:], strict=True):
            total = dr.fma(i, j, total)
        return total

    wx, wy = ([w * i for w, i in zip(weight, row, strict=True)] for row in (x, y))
    xx, xy, yy = moment(wx, x), moment(wx, y), moment(wy, y)
    px, py = moment(x, rest), moment(y, rest)
    det = dr.fma(xx, yy, -xy * xy)
    per_det, smallest = dr.rcp(det), total * SINGULAR**2
    cosine = dr.fma(yy, px, -xy * py) * per_det
    sine = dr.fma(xx, py, -xy * px) * per_det
    c, s = at or (cosine, sine)
    across = s * s * yy + 2.0 * c * s * xy + c * c * xx
    per_power = inverse(c * c + s * s)
    return Solution(
        offset=level - cosine * means[0] - sine * means[1],
        cosine=cosine,
        sine=sine,
        variance_rad2=across * per_det * per_power * per_power,
        # Two steps on which one of the waves is alike leave rounding errors of it, squared, which may have any determinant.
        # NaN, where nothing has weight, is not greater.
        determined=(det > SINGULAR * xx * yy) & (xx > smallest) & (yy > smallest),
    )


def total_of(terms: Sequence[Lanes]) -> Lanes:
    """Sum of lanes, 0 of none."""
    total: Any = 0.0
    for term in terms:
        total = total + term
    return total
