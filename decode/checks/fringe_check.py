"""Whether the frames of a fringe set are the steps of one sinusoid: their order, and the response of projector and camera."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from decode.phase.gamma import CLEAR, TOLERANCE, Harmonics, clearest, harmonics
from decode.phase.n_step import FringeSet
from scenes.acquisition.fringe_fit import fringe_solution
from scenes.files.stack import Stack
from scenes.support.finding import Finding

# Two exchanged frames of four leave a residual of half the modulation, of eight a quarter; a gamma of 2.2 leaves 0.2, most
# of it a second harmonic, which is subtracted.
MISFIT = 0.2

# Standard deviations between the phases of one set and its repeat; noise alone makes one.
REPEATED = 10.0


def sinusoid(stack: Stack, fringes: FringeSet) -> Iterator[Finding]:
    name = f"{fringes.axis} fringes of {fringes.period_px:g} px"
    exposure = clearest(stack, fringes)
    seen = harmonics(stack, fringes, exposure)
    if not np.isfinite(seen.residual):
        yield Finding(
            name,
            "wrong",
            "no fringes are seen: fewer than a thousand pixels are modulated and unsaturated",
        )
        return
    if len(fringes.frames) == 3:
        yield Finding(
            f"{name}, order", "unknown", "three steps fit a sinusoid in any order: see agreement"
        )
    else:
        yield _order(stack, fringes, exposure, seen, f"{name}, order")
    if len(fringes.frames) > stack.patterns[fringes.frames[0]].steps:
        yield _repeat(stack, fringes, exposure, f"{name}, repeat")
    if not np.isfinite(seen.gamma):
        yield Finding(f"{name}, gamma", "unknown", "too few fringes in view to measure harmonics")
        return
    said = f"second harmonic {seen.second:+.3f} of the first, as of gamma {seen.gamma:.2f}"
    known = stack.gamma
    bent = seen.bent if known is None else abs(seen.gamma - known) > TOLERANCE
    if known is not None:
        said += f"; the stack states {known:.2f}, which decoding undoes"
    elif bent:
        said += "; decode with gamma='estimate', or linearise projector and camera"
    yield Finding(f"{name}, gamma", "warning" if bent else "ok", said, seen.gamma)


def _order(stack: Stack, fringes: FringeSet, exposure: int, seen: Harmonics, name: str) -> Finding:
    """Least-squares residual, beyond noise and the second harmonic; if large, the exchange of frames that removes it."""
    off = misfit(seen)
    if off <= MISFIT:
        said = (
            f"samples differ from a sinusoid by {off:.3f} of the modulation, beyond noise and gamma"
        )
        return Finding(name, "ok", said, off)
    repairs: list[str] = []
    for i, j in combinations(range(len(fringes.frames)), 2):
        frames = list(fringes.frames)
        frames[i], frames[j] = frames[j], frames[i]
        other = FringeSet(fringes.axis, fringes.period_px, tuple(frames), fringes.shifts_rad)
        if misfit(harmonics(stack, other, exposure)) < MISFIT:
            repairs.append(f"{i} and {j}")
    hint = "exchanging two frames does not help"
    if repairs:
        hint = f"exchanging steps {' or '.join(repairs)} removes it"
    said = f"samples differ from a sinusoid by {off:.2f} of the modulation; {hint}: correct the frames' order or steps"
    return Finding(name, "wrong", said, off)


def _repeat(stack: Stack, fringes: FringeSet, exposure: int, name: str) -> Finding:
    """Whether fringes that are shown again have the same phase, each set by itself."""
    steps = stack.patterns[fringes.frames[0]].steps
    turns = []
    for k in range(0, len(fringes.frames), steps):
        shifts = fringes.shifts_rad[k : k + steps]
        if (rows := fringe_solution(shifts)) is None:
            return Finding(
                name, "unknown", "a repeat of fewer than three steps has no phase of its own"
            )
        frames = stack.frames[exposure][list(fringes.frames[k : k + steps])]
        level, cosine, sine = np.tensordot(rows, frames.astype(np.float64), axes=1)
        good = frames.max(axis=0) < stack.saturation_dn
        variance = stack.sensor.variance_dn2(level, stack.exposure_ms[exposure])
        sigma = np.sqrt(2.0 * variance / len(shifts)) / np.maximum(np.hypot(cosine, sine), 1e-6)
        turns.append((cosine + 1j * sine, good & (sigma < 1.0 / CLEAR), sigma))
    first, clear, sigma = turns[0]
    apart = []
    for other, good, _ in turns[1:]:
        both = clear & good
        apart.append(
            float(np.median(np.abs(np.angle(other * first.conj()))[both] / sigma[both]))
            if both.any()
            else 0.0
        )
    worst = max(apart)
    said = f"phases of the same fringes, shown again, differ by {worst:.1f} predicted standard deviations (median)"
    if worst > REPEATED:
        said += ": these are not the same fringes, or the scene moved; correct period_px, or remove repeat"
    return Finding(name, "wrong" if worst > REPEATED else "ok", said, worst)


def misfit(seen: Harmonics) -> float:
    """Residual that neither noise nor the second harmonic explains."""
    explained = seen.noise**2 + seen.second_residual**2
    return float(np.sqrt(max(seen.residual**2 - explained, 0.0)))
