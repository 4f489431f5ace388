"""Which change of a manifest would make its fringes agree: a first phase, the direction of shift, exchanged frames, a period.

Every candidate is tried on a sample of the pixels: the frames are decoded as if the manifest said so, and the share of
pixels whose periods disagree is compared.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from decode.phase.n_step import fringe_sets
from decode.pipeline import reconstruct
from decode.reason import Reason
from scenes.acquisition.patterns import Axis, Frame
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# The likelier ones first: inverted, sine for cosine, centred three steps.
FIRST_PHASES_DEG = (180, 90, 270, 120, 240)
MAX_NAMED = 3
# Share of pixels that disagree with the right patterns.
AGREE = 0.02
# Largest distance of a predicted order from a whole number, periods: less than the sixth by which the nearest wrong first
# phase of three steps misses.
CLOSE = 0.15
MAX_PIXELS = 40_000
# Periods that are tried, relative to the stated one, and pixels that it takes.
SCALES, FEWEST_PIXELS = np.linspace(-0.06, 0.06, 241), 500
# A change of the coordinate over the field, in periods, that is worth naming.
LEAST = 0.05
Change = Callable[[Sequence[Frame]], list[Frame]]


def fitting_change(stack: Stack, axis: Axis, projector: int = 0) -> str:
    """The change that makes an axis' fringes agree, in the manifest's words; empty if none of those tried does."""
    every = max(1, int(np.sqrt(stack.frames[0, 0].size / MAX_PIXELS)))
    small = replace(
        stack,
        frames=np.ascontiguousarray(stack.frames[..., ::every, ::every]),
        calibration=None,
        projector_resolution=stack.projector_size(projector),
    )
    found: list[tuple[float, int, str]] = []
    candidates = [*_candidates(stack, axis, projector), *_other_period(small, axis, projector)]
    for rank, said, patterns in candidates:
        share = _disagreement(replace(small, patterns=patterns), axis, projector)
        if share < AGREE:
            found.append((round(share, 2), rank, said))
    best = [said for _, _, said in sorted(found)[:MAX_NAMED]]
    return f"{', or '.join(best)} would fit" if best else ""


def _disagreement(stack: Stack, axis: Axis, projector: int) -> float:
    try:
        rec = reconstruct(
            stack, height="phase", axis=axis, projector=projector, max_order_residual=CLOSE
        )
    except DecodeError:
        return 1.0
    seen = (rec.reason == Reason.OK) | (rec.reason == Reason.ORDER_MISMATCH)
    return float((rec.reason[seen] == Reason.ORDER_MISMATCH).mean()) if seen.any() else 1.0


def _candidates(
    stack: Stack, axis: Axis, projector: int
) -> Iterator[tuple[int, str, tuple[Frame, ...]]]:
    """Rank, what to change, and the patterns with that change: of all the axis' sets alike, or of one."""
    sets = [fringes.frames for fringes in fringe_sets(stack.patterns, projector).get(axis, ())]
    groups = [(f"of all {axis} fringes", sets)] if len(sets) > 1 else []
    for members in sets:
        name = f"of the {axis} fringes of {stack.patterns[members[0]].period_px:g} px"
        groups.append((name, [members]))
    for name, chosen in groups:
        for rank, (said, change) in enumerate(_changes(stack, chosen)):
            patterns = list(stack.patterns)
            for members in chosen:
                changed = change([stack.patterns[k] for k in members])
                for k, frame in zip(members, changed, strict=True):
                    patterns[k] = frame
            yield rank, said.format(name), tuple(patterns)


def _other_period(
    stack: Stack, axis: Axis, projector: int
) -> Iterator[tuple[int, str, tuple[Frame, ...]]]:
    """The finest period that agrees with the coordinate of all others: where ``exp(j (phase - 2 pi u / period))`` adds up most."""
    *_, finest = fringe_sets(stack.patterns, projector).get(axis, (None,))
    if finest is None:
        return
    other = [i for i in range(len(stack.patterns)) if i not in finest.frames]
    rest = replace(
        stack, frames=stack.frames[:, other], patterns=tuple(stack.patterns[i] for i in other)
    )
    alone = replace(
        stack,
        frames=stack.frames[:, list(finest.frames)],
        patterns=tuple(stack.patterns[i] for i in finest.frames),
    )
    try:
        coarse = reconstruct(rest, height="phase", axis=axis, projector=projector)
        fine = reconstruct(alone, height="phase", axis=axis, projector=projector, anchor="spatial")
    except DecodeError:
        return
    both = coarse.valid & (fine.reason == Reason.OK)
    if not coarse.order_known or both.sum() < FEWEST_PIXELS:
        return
    at = coarse.phases[axis].coordinate_px[both]
    turn = np.exp(1j * fine.phases[axis].wrapped_rad[both])
    frequency = (1.0 + SCALES) / finest.period_px
    sums = [abs(np.sum(turn * np.exp(-2j * np.pi * f * at))) for f in frequency]
    best = float(1.0 / frequency[int(np.argmax(sums))])
    if abs(best / finest.period_px - 1.0) * float(np.ptp(at)) < LEAST * finest.period_px:
        return
    patterns = tuple(
        replace(f, period_px=best) if i in finest.frames else f
        for i, f in enumerate(stack.patterns)
    )
    yield 0, f"period_px = {best:.5g} instead of {finest.period_px:g}", patterns


def _changes(stack: Stack, chosen: Sequence[Sequence[int]]) -> Iterator[tuple[str, Change]]:
    firsts = {round(float(np.rad2deg(stack.patterns[m[0]].phase_shift_rad)), 6) for m in chosen}
    for degrees in FIRST_PHASES_DEG:
        # Where the origin is 0, the first frame's shift is the first phase itself.
        value = (next(iter(firsts)) + degrees) % 360.0 if len(firsts) == 1 else None
        said = (
            f"first_phase_deg = {value:g}"
            if value is not None and value % 1.0 == 0.0
            else "first_phase_deg"
        )
        yield f"{said} ({degrees} more than now) {{}}", _shifted(degrees)
    yield "direction = -1 instead of 1, or the reverse, {}", _reversed
    steps = {len(members) for members in chosen}
    if len(chosen) == 1 and steps == {3}:
        for i, j in combinations(range(3), 2):
            yield f"exchanging steps {i} and {j} {{}}", _exchanged(i, j)


def _shifted(degrees: float) -> Change:
    return lambda frames: [
        replace(f, phase_shift_rad=f.phase_shift_rad + float(np.deg2rad(degrees))) for f in frames
    ]


def _reversed(frames: Sequence[Frame]) -> list[Frame]:
    first = frames[0].phase_shift_rad
    return [replace(f, phase_shift_rad=2.0 * first - f.phase_shift_rad) for f in frames]


def _exchanged(i: int, j: int) -> Change:
    def change(frames: Sequence[Frame]) -> list[Frame]:
        shifts = [f.phase_shift_rad for f in frames]
        shifts[i], shifts[j] = shifts[j], shifts[i]
        return [replace(f, phase_shift_rad=s) for f, s in zip(frames, shifts, strict=True)]

    return change
