"""N-step phase shifting: offset, modulation and phase of one fringe set by linear least squares.

``I_k = A + B cos(phi + delta_k)`` is linear in ``(A, B cos phi, B sin phi)``. For equal steps ``delta_k = 2 pi k / N``
the solution is the discrete Fourier transform's first bin (Bruning et al. 1974; for N = 4
``phi = atan2(I3 - I1, I0 - I2)``); other steps go through the same normal equations (Greivenkamp 1984).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from scenes.errors import DecodeError
from scenes.patterns import Axis, Frame

# Coefficients below this are the rounding of an exact zero such as cos(pi / 2).
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class FringeSet:
    """The frames of one axis, period and projector: which of the stack's frames, and each one's phase shift."""

    axis: Axis
    period_px: float
    frames: tuple[int, ...]
    shifts_rad: tuple[float, ...]


@dataclass(frozen=True)
class Phasor:
    """One fringe set of every pixel: ``B cos phi``, ``B sin phi`` and A in DN, and what is known of them."""

    cosine: Lanes
    sine: Lanes
    offset: Lanes
    variance_rad2: Lanes
    """Predicted variance of the phase."""
    usable: Lanes
    """False where no exposure could be used; the numbers are then the least bad ones."""
    exposure: Lanes
    """Index of the exposure used; `MERGED` for several."""


def fringe_sets(frames: Sequence[Frame], projector: int) -> dict[Axis, tuple[FringeSet, ...]]:
    """A projector's fringe sets by axis, coarsest period first. Raises `DecodeError` if a set gives no phase."""
    mine = [(i, f) for i, f in enumerate(frames) if f.kind == "fringe" and f.projector == projector]

    def key(item: tuple[int, Frame]) -> tuple[str, float]:
        return item[1].axis, -item[1].period_px

    sets: dict[Axis, list[FringeSet]] = {}
    for _, group in groupby(sorted(mine, key=key), key=key):
        members = list(group)
        first = members[0][1]
        found = FringeSet(
            first.axis,
            first.period_px,
            tuple(i for i, _ in members),
            tuple(f.phase_shift_rad for _, f in members),
        )
        solution(found)
        sets.setdefault(first.axis, []).append(found)
    return {axis: tuple(found) for axis, found in sets.items()}


@lru_cache(maxsize=256)
def solution(fringes: FringeSet) -> NDArray[np.float64]:
    """Rows that turn the N samples into ``(A, B cos phi, B sin phi)``, (3, N).

    Raises `DecodeError` when the phase shifts leave the phase undetermined.
    """
    shifts = np.asarray(fringes.shifts_rad)
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    if np.linalg.matrix_rank(design, tol=1e-6) < 3:
        raise DecodeError(
            f"the {fringes.axis} fringes of period {fringes.period_px:g} px have {len(shifts)} frames with "
            f"phase shifts {np.round(shifts, 4).tolist()} rad: offset, modulation and phase need at least three "
            "different shifts"
        )
    rows = np.linalg.pinv(design)
    rows = np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows)
    rows.flags.writeable = False  # it is shared
    return rows


def variance_rad2(
    fringes: FringeSet, cosine: Lanes, sine: Lanes, variance_dn2: Lanes, slope: float
) -> Lanes:
    """Predicted variance of the phase of a least-squares phasor, to first order.

    `variance_dn2` is the samples' mean variance, `slope` how it grows with the digital number. For equal steps this is
    ``2 sigma^2 / (N B^2)``; with N = 3 the slope adds ``-slope cos(3 phi) / (3 B)``, for then the bright steps' noise does
    not average out.
    """
    rows, shifts = solution(fringes)[1:], np.asarray(fringes.shifts_rad)
    # phi moves by (cosine rows[1] - sine rows[0]) / B^2 per DN of a step: its square, times constants per step
    waves = np.stack([np.cos(shifts), -np.sin(shifts)])
    square = {(2, 0): rows[1] ** 2, (1, 1): -2.0 * rows[0] * rows[1], (0, 2): rows[0] ** 2}
    even = {power: float(step.sum()) for power, step in square.items()}
    odd: dict[tuple[int, int], float] = {}
    for (i, j), step in square.items():
        for di, wave in enumerate(waves[::-1]):
            power = (i + di, j + 1 - di)
            odd[power] = odd.get(power, 0.0) + float(slope * (step * wave).sum())
    power2 = cosine * cosine + sine * sine
    total = variance_dn2 * _polynomial(even, cosine, sine, power2)
    if any(abs(c) > NEGLIGIBLE for c in odd.values()):
        total = total + _polynomial(odd, cosine, sine, power2)
    return total / (power2 * power2)


def _polynomial(
    coefficients: dict[tuple[int, int], float], cosine: Lanes, sine: Lanes, power2: Lanes
) -> Lanes:
    """Sum of ``c cosine^i sine^j``; a circle's ``c (cosine^2 + sine^2)`` in one product."""
    c = {power: value for power, value in coefficients.items() if abs(value) > NEGLIGIBLE}
    if c.keys() == {(2, 0), (0, 2)} and abs(c[2, 0] - c[0, 2]) < NEGLIGIBLE:
        return c[2, 0] * power2
    total = 0.0
    for (i, j), value in c.items():
        term = value
        for factor in [cosine] * i + [sine] * j:
            term = term * factor
        total = total + term
    return total


def weighted_sum(weights: NDArray[np.float64], samples: Sequence[Lanes]) -> Lanes:
    """Sum of samples times constants, leaving out the zeros."""
    terms = [float(w) * s for w, s in zip(weights, samples, strict=True) if w]
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def wrapped(device: Device, phasor: Phasor) -> Lanes:
    """Phase in [-pi, pi) as float32 lanes."""
    phase = device.dr.atan2(phasor.sine, phasor.cosine)
    # atan2 gives +pi on the negative axis; the convention's interval is open there
    pi = float(np.float32(np.pi))
    return device.dr.select(phase >= pi, -pi, phase)
