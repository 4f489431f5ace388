"""A projector's or camera's gamma, seen in the fringes' harmonics, and undone in the phase.

A fringe sent through ``(0.5 + 0.5 cos) ** gamma`` has harmonics of relative strength ``b2 = (gamma - 1) / (gamma + 2)`` and
so on. They bend the phase of N steps by a function of the phase alone, whatever the surface's reflectance and the ambient
light, so a table undoes them (Guo, He & Chen, Opt. Eng. 43, 2906 (2004); Liu, Wang, Lau, Hao & Hassebrook, JOSA A 27, 553
(2010)). The table assumes fringes of full amplitude.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from decode.device import Device, Lanes
from decode.phase.n_step import PI, TURN, FringeSet, fringe_sets, solution, wrap
from scenes.acquisition.fringe_fit import fringe_design
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

RANGE = (0.3, 4.0)
"""Gammas that are looked for."""
TABLE = 1024
MOST_PIXELS = 200_000
# Modulation in standard deviations of a sample's noise from which a pixel's harmonics are worth averaging, and from which
# it shows a fringe: noise alone reaches that in exp(-2.25 N) of the pixels (Rayleigh), 0.1 % for three steps.
CLEAR, FAINT = 10.0, 3.0
# Gammas of a response that count as the same, and as linear.
TOLERANCE = 0.1
# A histogram's third harmonic, which shows gamma, must exceed the harmonics that gamma does not make by this factor.
SIGNIFICANT = 4.0
FEWEST_PIXELS = 1000


@dataclass(frozen=True)
class Harmonics:
    """What one fringe set shows of a non-linear response."""

    second: float
    """Second harmonic relative to the first, signed: positive where gamma > 1. NaN: cannot be measured."""
    error: float
    """Its standard deviation."""
    gamma: float
    """Gamma that makes this harmonic; NaN as `second`."""
    residual: float
    """RMS of the samples about their own least-squares sinusoid, relative to the modulation; 0 for three steps."""
    noise: float
    """The residual that the sensor's noise alone makes."""
    second_residual: float
    """The residual that the second harmonic alone makes; 0 for three steps."""

    @property
    def bent(self) -> bool:
        """Whether the response has a gamma beyond doubt."""
        certain = abs(self.second) > SIGNIFICANT * self.error
        return bool(certain and abs(self.gamma - 1.0) > TOLERANCE)

    @property
    def linear(self) -> bool:
        """Whether the response is linear beyond doubt."""
        # d(gamma) / d(second) is 3 where gamma is 1.
        return bool(abs(self.gamma - 1.0) + SIGNIFICANT * 3.0 * self.error <= TOLERANCE)


def harmonics(stack: Stack, fringes: FringeSet, exposure: int = 0) -> Harmonics:
    """Harmonics of one fringe set over well-modulated, unsaturated pixels; NaN where fewer than a thousand are left.

    With four steps or more from the samples' departure from a sinusoid; with three, which any sinusoid fits, from the
    histogram of the phase, which gamma gives three maxima (this needs several fringes across the image).
    """
    samples = _samples(stack, fringes, exposure)
    nothing = float("nan")
    if samples.shape[1] < FEWEST_PIXELS:
        return Harmonics(*[nothing] * 6)
    a, c, s = solution(fringes) @ samples
    modulation, phase = np.hypot(c, s), np.arctan2(s, c)
    shifts = np.asarray(fringes.shifts_rad)
    fit = a + modulation * np.cos(phase + shifts[:, None])
    steps = len(shifts)
    free = steps - 3
    variance = stack.sensor.variance_dn2(a, stack.exposure_ms[exposure])
    # Ratios of means, not means of ratios: pixels in which blur leaves hardly a fringe say little about the frames.
    power = np.mean(modulation**2)
    residual = float(np.sqrt(np.mean((samples - fit) ** 2) / power))
    noise = float(np.sqrt(np.mean(variance) / power * free / steps))
    share = 0.0
    if free:
        second, error, share = _from_residual(samples - fit, modulation, phase, fringes)
    else:
        second, error = _from_histogram(phase, shifts)
    gamma = _gamma(second, fringes) if np.isfinite(second) else nothing
    return Harmonics(second, error, gamma, residual, noise, share)


def response(stack: Stack, projector: int = 0) -> float | None:
    """Gamma of a response that all fringe sets show alike; None if it is linear, or they do not show one."""
    sets = [f for axis in fringe_sets(stack.patterns, projector).values() for f in axis]
    found = [harmonics(stack, fringes, clearest(stack, fringes)) for fringes in sets]
    gammas = [h.gamma for h in found if h.bent]
    if not gammas or np.ptp(gammas) > TOLERANCE or any(h.linear for h in found):
        return None
    return float(np.mean(gammas))


def clearest(stack: Stack, fringes: FringeSet) -> int:
    """Index of the exposure in which most pixels are modulated and unsaturated."""

    def count(exposure: int) -> int:
        frames = stack.frames[exposure][list(fringes.frames)][:, ::4, ::4]
        low, high = frames.min(axis=0), frames.max(axis=0).astype(np.float64)
        return int(((high < stack.saturation_dn) & (high - low > CLEAR)).sum())

    return max(range(len(stack.exposure_ms)), key=count)


def estimate(stack: Stack, projector: int = 0, exposure: int = 0) -> float:
    """Gamma from all fringe sets of a projector, weighted by their certainty; `DecodeError` where too few bright pixels
    or fringes show it.
    """
    found = [
        harmonics(stack, fringes, exposure)
        for sets in fringe_sets(stack.patterns, projector).values()
        for fringes in sets
    ]
    measured = [h for h in found if np.isfinite(h.gamma)]
    if not measured:
        raise DecodeError(
            "gamma cannot be estimated: too few well-lit, unsaturated pixels, or three steps with too few fringes across "
            "the image; give gamma as a number, or leave it out"
        )
    weights = np.array([1.0 / max(h.error, 1e-6) ** 2 for h in measured])
    return float(np.average([h.gamma for h in measured], weights=weights))


def table(gamma: float, fringes: FringeSet) -> NDArray[np.float32]:
    """True minus measured phase in rad at `TABLE` + 1 equidistant measured phases from -pi to pi, for a gamma."""
    true = np.linspace(-np.pi, np.pi, 8 * TABLE, endpoint=False)
    measured = _measured(gamma, fringes, true)
    bend = wrap(true - measured)
    order = np.argsort(measured)
    grid = np.linspace(-np.pi, np.pi, TABLE + 1)
    bent = np.interp(grid, measured[order], bend[order], period=TURN)
    return np.asarray(bent, dtype=np.float32)


def correct(device: Device, phase: Lanes, gamma: float, fringes: FringeSet) -> Lanes:
    """Wrapped phase with gamma's error removed, by linear interpolation in `table`."""
    dr, types = device.dr, device.types
    values = types.Float(table(gamma, fringes))
    place = (phase * (1.0 / TURN) + 0.5) * TABLE
    index = types.UInt32(dr.clip(dr.floor(place), 0.0, TABLE - 1.0))
    rest = place - types.Float(index)
    low, high = dr.gather(types.Float, values, index), dr.gather(types.Float, values, index + 1)
    true = phase + low + rest * (high - low)
    true = dr.select(true >= PI, true - TURN, true)
    return dr.select(true < -PI, true + TURN, true)


def _samples(stack: Stack, fringes: FringeSet, exposure: int) -> NDArray[np.float64]:
    """Frames (step, pixel) of the clear pixels, thinned evenly; where there are too few, of all that show a fringe."""
    frames = stack.frames[exposure][list(fringes.frames)]
    every = max(1, int(np.sqrt(frames[0].size / MOST_PIXELS)))
    samples = frames[:, ::every, ::every].reshape(len(frames), -1).astype(np.float64)
    samples = samples[:, samples.max(axis=0) < stack.saturation_dn]
    a, c, s = solution(fringes) @ samples
    modulation = np.hypot(c, s)
    sigma = np.sqrt(stack.sensor.variance_dn2(a, stack.exposure_ms[exposure]))
    # A pixel that clips at some phases is left out at all of them, or the phases that are left look like a gamma's.
    whole = a + modulation < stack.saturation_dn
    clear = whole & (modulation > CLEAR * sigma)
    return np.asarray(
        samples[:, clear if clear.sum() >= FEWEST_PIXELS else whole & (modulation > FAINT * sigma)]
    )


def _measured(gamma: float, fringes: FringeSet, true: NDArray[np.float64]) -> NDArray[np.float64]:
    shifts = np.asarray(fringes.shifts_rad)[:, None]
    _, c, s = solution(fringes) @ (0.5 + 0.5 * np.cos(true + shifts)) ** gamma
    return np.asarray(np.arctan2(s, c))


def _from_residual(
    left_dn: NDArray[np.float64],
    modulation: NDArray[np.float64],
    phase: NDArray[np.float64],
    fringes: FringeSet,
) -> tuple[float, float, float]:
    """Second harmonic by least squares over all pixels: what of cos 2(phi + shift) a sinusoid's fit leaves; its error, its residual."""
    shifts = np.asarray(fringes.shifts_rad)
    left_over = np.eye(len(shifts)) - fringe_design(shifts) @ solution(fringes)
    shape = modulation * (left_over @ np.cos(2.0 * (phase + shifts[:, None])))
    power, whole = float((shape**2).sum()), float((modulation**2).sum())
    if power < 1e-9 * whole * len(shifts):
        return float("nan"), float("nan"), 0.0
    second = float((shape * left_dn).sum() / power)
    share = abs(second) * float(np.sqrt(power / (whole * len(shifts))))
    return second, float(np.sqrt(np.mean((left_dn - second * shape) ** 2) / power)), share


def _from_histogram(phase: NDArray[np.float64], shifts: NDArray[np.float64]) -> tuple[float, float]:
    """Second harmonic from the density of three-step phases, ``1 - 3 b2 cos 3 phi`` about a uniform one."""
    steps = np.sort(np.mod(shifts - shifts[0], TURN))
    if not np.allclose(steps, TURN * np.arange(3) / 3.0, atol=1e-3):
        return float("nan"), float("nan")
    offset = phase + shifts[0]
    density = [np.mean(np.exp(1j * k * offset)) for k in range(1, 7)]
    # The harmonics that gamma does not make show how uniform the surface's own phases are.
    floor = float(np.sqrt(np.mean(np.abs([density[k - 1] for k in (1, 2, 4, 5)]) ** 2)))
    if floor > 1.0 / (3.0 * SIGNIFICANT):
        return float("nan"), float("nan")
    return float(2.0 / 3.0 * density[2].real), 2.0 / 3.0 * floor


def _gamma(second: float, fringes: FringeSet) -> float:
    """The gamma at which the same estimator finds this second harmonic in an ideal fringe."""
    true = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
    shifts = np.asarray(fringes.shifts_rad)[:, None]

    def off(gamma: float) -> float:
        samples = (0.5 + 0.5 * np.cos(true + shifts)) ** gamma
        a, c, s = solution(fringes) @ samples
        modulation, phase = np.hypot(c, s), np.arctan2(s, c)
        if len(shifts) > 3:
            left = samples - a - modulation * np.cos(phase + shifts)
            return _from_residual(left, modulation, phase, fringes)[0] - second
        return _from_histogram(phase, shifts[:, 0])[0] - second

    low, high = RANGE
    if off(low) > 0.0 or off(high) < 0.0:
        return low if off(low) > 0.0 else high
    return float(brentq(off, low, high, xtol=1e-6))
