"""Whether the frames of a fringe set are the steps of one sinusoid: their order, and the response of projector and camera."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from decode.phase.gamma import TOLERANCE, Harmonics, clearest, harmonics
from decode.phase.n_step import FringeSet
from scenes.files.stack import Stack
from scenes.support.finding import Finding

# Two exchanged frames of four leave a residual of half the modulation, of eight a quarter; a gamma of 2.2 leaves 0.2, most
# of it a second harmonic, which is subtracted.
MISFIT = 0.2


def sinusoid(stack: Stack, fringes: FringeSet) -> Iterator[Finding]:
    name = f"{fringes.axis} fringes of {fringes.period_px:g} px"
    exposure = clearest(stack, fringes)
    seen = harmonics(stack, fringes, exposure)
    if not np.isfinite(seen.residual):
        yield Finding(
            name, "wrong", "no fringes are seen: fewer than a thousand pixels are modulated"
        )
        return
    if len(fringes.frames) == 3:
        yield Finding(
            f"{name}, order", "unknown", "three steps fit a sinusoid in any order: see agreement"
        )
    else:
        yield _order(stack, fringes, exposure, seen, f"{name}, order")
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


def misfit(seen: Harmonics) -> float:
    """Residual that neither noise nor the second harmonic explains."""
    explained = seen.noise**2 + seen.second_residual**2
    return float(np.sqrt(max(seen.residual**2 - explained, 0.0)))
