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
from decode.phase import FringeSet, fringe_sets, solution
from decode.unwrap import TURN
from scenes.errors import DecodeError
from scenes.stack import Stack

RANGE = (0.3, 4.0)
"""Gammas that are looked for."""
TABLE = 1024
MOST_PIXELS = 200_000
# Modulation in standard deviations of noise from which a pixel's harmonics are worth averaging.
CLEAR = 10.0
# A histogram's harmonic that tells gamma must stand this far above the harmonics that gamma does not make.
SIGNIFICANT = 4.0
FEWEST_PIXELS = 1000


@dataclass(frozen=True)
class Harmonics:
    """What one fringe set shows of a non-linear response."""

    second: float
    """Second harmonic relative to the first, signed: positive where gamma > 1. NaN: cannot be told."""
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


def harmonics(stack: Stack, fringes: FringeSet, exposure: int = 0) -> Harmonics:
    """Measure the harmonics of one fringe set over well-modulated, unsaturated pixels.

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
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    variance = constant + slope * np.maximum(a - stack.sensor.black_level_dn, 0.0)
    relative = (samples - fit) / modulation
    residual = float(np.sqrt(np.mean(relative**2)))
    noise = float(np.sqrt(np.mean(variance / modulation**2) * free / steps))
    share = 0.0
    if free:
        second, error, share = _from_residual(relative, phase, fringes)
    else:
        second, error = _from_histogram(phase, shifts)
    gamma = _gamma(second, fringes) if np.isfinite(second) else nothing
    return Harmonics(second, error, gamma, residual, noise, share)


def estimate(stack: Stack, projector: int = 0, exposure: int = 0) -> float:
    """Gamma from all fringe sets of a projector, weighted by their certainty.

    Raises `DecodeError` if the fringes do not tell: too few bright pixels, or three steps and too few fringes.
    """
    found = [
        harmonics(stack, fringes, exposure)
        for sets in fringe_sets(stack.patterns, projector).values()
        for fringes in sets
    ]
    told = [h for h in found if np.isfinite(h.gamma)]
    if not told:
        raise DecodeError(
            "gamma cannot be estimated: too few well-lit, unsaturated pixels, or three steps with too few fringes across "
            "the image; give gamma as a number, or leave it out"
        )
    weights = np.array([1.0 / max(h.error, 1e-6) ** 2 for h in told])
    return float(np.average([h.gamma for h in told], weights=weights))


def table(gamma: float, fringes: FringeSet) -> NDArray[np.float32]:
    """True minus measured phase at `TABLE` + 1 equidistant measured phases from -pi to pi, rad."""
    true = np.linspace(-np.pi, np.pi, 8 * TABLE, endpoint=False)
    measured = _measured(gamma, fringes, true)
    bend = np.angle(np.exp(1j * (true - measured)))
    order = np.argsort(measured)
    grid = np.linspace(-np.pi, np.pi, TABLE + 1)
    bent = np.interp(grid, measured[order], bend[order], period=TURN)
    return np.asarray(bent, dtype=np.float32)


def correct(device: Device, phase: Lanes, gamma: float, fringes: FringeSet) -> Lanes:
    """Phase in [-pi, pi) with gamma's error taken out, by linear interpolation in `table`."""
    dr, types = device.dr, device.types
    values = types.Float(table(gamma, fringes))
    place = (phase * (1.0 / TURN) + 0.5) * TABLE
    index = types.UInt32(dr.clip(dr.floor(place), 0.0, TABLE - 1.0))
    rest = place - types.Float(index)
    low, high = dr.gather(types.Float, values, index), dr.gather(types.Float, values, index + 1)
    true = phase + low + rest * (high - low)
    pi = float(np.float32(np.pi))
    true = dr.select(true >= pi, true - TURN, true)
    return dr.select(true < -pi, true + TURN, true)


def _samples(stack: Stack, fringes: FringeSet, exposure: int) -> NDArray[np.float64]:
    """Frames (step, pixel) of pixels worth looking at, thinned evenly."""
    frames = stack.frames[exposure][list(fringes.frames)]
    every = max(1, int(np.sqrt(frames[0].size / MOST_PIXELS)))
    samples = frames[:, ::every, ::every].reshape(len(frames), -1).astype(np.float64)
    samples = samples[:, samples.max(axis=0) < stack.saturation_dn]
    a, c, s = solution(fringes) @ samples
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    sigma = np.sqrt(constant + slope * np.maximum(a - stack.sensor.black_level_dn, 0.0))
    return np.asarray(samples[:, np.hypot(c, s) > CLEAR * sigma])


def _measured(gamma: float, fringes: FringeSet, true: NDArray[np.float64]) -> NDArray[np.float64]:
    shifts = np.asarray(fringes.shifts_rad)[:, None]
    _, c, s = solution(fringes) @ (0.5 + 0.5 * np.cos(true + shifts)) ** gamma
    return np.asarray(np.arctan2(s, c))


def _from_residual(
    relative: NDArray[np.float64], phase: NDArray[np.float64], fringes: FringeSet
) -> tuple[float, float, float]:
    """Second harmonic by least squares over all pixels: what of cos 2(phi + shift) a sinusoid's fit leaves; its error, its residual."""
    shifts = np.asarray(fringes.shifts_rad)
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    left_over = np.eye(len(shifts)) - design @ solution(fringes)
    shape = left_over @ np.cos(2.0 * (phase + shifts[:, None]))
    power = float((shape**2).sum())
    if power < 1e-9 * shape.size:
        return float("nan"), float("nan"), 0.0
    second = float((shape * relative).sum() / power)
    left = relative - second * shape
    share = abs(second) * float(np.sqrt(power / shape.size))
    return second, float(np.sqrt(np.mean(left**2) / power)), share


def _from_histogram(phase: NDArray[np.float64], shifts: NDArray[np.float64]) -> tuple[float, float]:
    """Second harmonic from the density of three-step phases, ``1 - 3 b2 cos 3 phi`` about a uniform one."""
    steps = np.sort(np.mod(shifts - shifts[0], TURN))
    if not np.allclose(steps, TURN * np.arange(3) / 3.0, atol=1e-3):
        return float("nan"), float("nan")
    offset = phase + shifts[0]
    density = [np.mean(np.exp(1j * k * offset)) for k in range(1, 7)]
    # what gamma does not make tells how uniform the surface's own phases are
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
            relative = (samples - a - modulation * np.cos(phase + shifts)) / modulation
            return _from_residual(relative, phase, fringes)[0] - second
        return _from_histogram(phase, shifts[:, 0])[0] - second

    low, high = RANGE
    if off(low) > 0.0 or off(high) < 0.0:
        return low if off(low) > 0.0 else high
    return float(brentq(off, low, high, xtol=1e-6))
