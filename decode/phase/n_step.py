"""N-step phase shifting: offset, modulation and phase of one fringe set by linear least squares.

``I_k = A + B cos(phi + delta_k)`` is linear in ``(A, B cos phi, B sin phi)``. For equal steps ``delta_k = 2 pi k / N``
the solution is the discrete Fourier transform's first bin (Bruning et al. 1974; for N = 4
``phi = atan2(I3 - I1, I0 - I2)``); other steps go through the same normal equations (Greivenkamp 1984).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike, NDArray

from decode.device import Device, Lanes
from scenes.acquisition.fringe_fit import fringe_design, fringe_solution
from scenes.acquisition.patterns import Axis, Frame
from scenes.support.errors import DecodeError

TURN = 2.0 * np.pi

PI, HALF_PI = float(np.float32(np.pi)), float(np.float32(np.pi / 2.0))
# ``atan(q) / q`` in powers of q^2 for q in [0, 1]: the minimax polynomial, error 4e-8 rad, found by Lawson's
# iteration.
ATAN = (
    0.9999993443489075,
    -0.33329859375953674,
    0.19946566224098206,
    -0.1390862911939621,
    0.0964219719171524,
    -0.0559123195707798,
    0.021862953901290894,
    -0.004054565913975239,
)
Terms = Mapping[tuple[int, int], float]
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
    """False where no exposure could be used; the numbers are then the best available."""
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
    """Rows (3, N), read-only, that turn N samples into ``(A, B cos phi, B sin phi)``; `DecodeError` if the shifts leave
    it undetermined.
    """
    rows = fringe_solution(fringes.shifts_rad)
    if rows is None:
        raise DecodeError(
            f"the {fringes.axis} fringes of period {fringes.period_px:g} px have {len(fringes.frames)} frames with "
            f"phase shifts {np.round(fringes.shifts_rad, 4).tolist()} rad: offset, modulation and phase need at least "
            "three different shifts"
        )
    rows = np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows)
    rows.flags.writeable = False  # It is shared.
    return rows


def variance_rad2(
    fringes: FringeSet, cosine: Lanes, sine: Lanes, variance_dn2: Lanes, slope: float
) -> Lanes:
    """Predicted variance of the phase of a least-squares phasor, to first order: `across_dn2` over B^2.

    Parameters
    ----------
    fringes
        Fringe set of N steps.
    cosine, sine
        ``B cos phi`` and ``B sin phi``, DN.
    variance_dn2
        The samples' mean variance, DN^2.
    slope
        Its growth per DN.

    Returns
    -------
    Lanes
        Variance, rad^2.

    Notes
    -----
    For equal steps this is ``2 sigma^2 / (N B^2)``; with N = 3 the slope adds ``-slope cos(3 phi) / (3 B)``, for then the
    bright steps' noise does not average out.
    """
    across = across_dn2(fringes, cosine, sine, variance_dn2, slope)
    return across * inverse(cosine * cosine + sine * sine)


def across_dn2(
    fringes: FringeSet, cosine: Lanes, sine: Lanes, variance_dn2: Lanes, slope: float
) -> Lanes:
    """Variance in DN^2 of a least-squares phasor across its own direction, which is what turns its phase.

    `variance_dn2` is the samples' mean variance, `slope` its growth per DN.
    """
    even, odd = _variance_terms(fringes, slope)
    tilted = any(abs(c) > NEGLIGIBLE for c in odd.values())
    if not tilted and abs(even[2, 0] - even[0, 2]) < NEGLIGIBLE and abs(even[1, 1]) < NEGLIGIBLE:
        return variance_dn2 * even[2, 0]
    total = variance_dn2 * _polynomial(even, cosine, sine)
    if tilted:
        total = total + _polynomial(odd, cosine, sine)
    return total * inverse(cosine * cosine + sine * sine)


def inverse(power2: Lanes) -> Lanes:
    """Reciprocal by multiplication: see `Device.root`."""
    import drjit as dr  # Not before `Device.open` has set where LLVM is.

    root = dr.rsqrt(power2)
    return root * root


@lru_cache(maxsize=256)
def _variance_terms(fringes: FringeSet, slope: float) -> tuple[Terms, Terms]:
    """Coefficients of ``cosine^i sine^j`` by (i, j), times B^4: of the mean variance, and of the steps' departure from it."""
    rows = solution(fringes)[1:]
    # phi moves by (cosine rows[1] - sine rows[0]) / B^2 per DN of a step: its square, times constants per step.
    waves = fringe_design(fringes.shifts_rad)[:, 1:].T
    square = {(2, 0): rows[1] ** 2, (1, 1): -2.0 * rows[0] * rows[1], (0, 2): rows[0] ** 2}
    even = {power: float(step.sum()) for power, step in square.items()}
    odd: dict[tuple[int, int], float] = {}
    for (i, j), step in square.items():
        for di, wave in enumerate(waves[::-1]):
            power = (i + di, j + 1 - di)
            odd[power] = odd.get(power, 0.0) + float(slope * (step * wave).sum())
    return even, odd


def _polynomial(coefficients: Terms, cosine: Lanes, sine: Lanes) -> Lanes:
    """Sum of ``c cosine^i sine^j``."""
    total = 0.0
    for (i, j), value in coefficients.items():
        if abs(value) < NEGLIGIBLE:
            continue
        term = value
        for factor in [cosine] * i + [sine] * j:
            term = term * factor
        total = total + term
    return total


def weighted_sum(weights: NDArray[np.float64], samples: Sequence[Lanes]) -> Lanes:
    """Sum of N samples times constants, leaving out zeros, with one product for constants that differ in sign alone."""
    groups: dict[float, Lanes] = {}
    for weight, sample in zip(weights.tolist(), samples, strict=True):
        size = next((w for w in groups if abs(abs(w) - abs(weight)) < NEGLIGIBLE), weight)
        if size == weight and size not in groups:
            groups[size] = sample
        elif weight:
            same = weight * size > 0.0
            groups[size] = groups[size] + sample if same else groups[size] - sample
    first, *others = [w * total for w, total in groups.items() if w]
    for term in others:
        first = first + term
    return first


def wrap(phase_rad: ArrayLike) -> NDArray[np.float64]:
    """Wrap phases, or differences of phases, into one turn.

    Parameters
    ----------
    phase_rad
        Phases (...), rad.

    Returns
    -------
    ndarray of float64, (...)
        The same phases in (-pi, pi], rad.

    Examples
    --------
    >>> float(wrap(2.0 * np.pi + 0.25).round(6))
    0.25
    """
    turned: NDArray[np.float64] = np.angle(np.exp(1j * np.asarray(phase_rad, np.float64)))
    return turned


def wrapped(device: Device, phasor: Phasor) -> Lanes:
    """Wrapped phase, float32 in [-pi, pi), of a phasor in any unit."""
    dr, y, x = device.dr, phasor.sine, phasor.cosine
    across, along = dr.abs(y), dr.abs(x)
    steep = across > along
    # Chosen, not `minimum`, whose care for NaN costs more than all the rest.
    less, more = dr.select(steep, along, across), dr.select(steep, across, along)
    # No modulation, and NaN, have phase 0.
    q = dr.select(more > 0.0, less / more, 0.0)
    # Pairs of terms, then pairs of pairs (Estrin): one after the other, each product waits for the one before.
    terms, z = list(ATAN), q * q
    while len(terms) > 1:
        terms = [dr.fma(z, b, a) for a, b in zip(terms[::2], terms[1::2], strict=True)]
        z = z * z
    angle = terms[0] * q
    angle = dr.select(steep, HALF_PI - angle, angle)
    # Pi itself belongs to the other end of the interval.
    angle = dr.select(x < 0.0, PI - angle, angle)
    return dr.select((y < 0.0) | (angle >= PI), -angle, angle)
