"""Any coding as ordinary fringes: phasors of the coding, written as four steps of each period, which the pipeline decodes.

Micro and embedded phase shifting, 2+1 phase shifting, modulated phase shifting, line shifting, XOR codes and Gray codes shown twice
become `PhaseShift` and Gray code frames, exposure by exposure, so that fusion, orders, validity and heights are those of every stack.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.codings.shared_offset import Fitted, Floats, fit, search
from scenes.acquisition.frames import Axis, Frame
from scenes.acquisition.sensor import Emva, Sensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# Marks saturated pixels: a digital number beyond those of all sensors.
SATURATED_DN = 1e9
QUARTERS = np.exp(0.5j * np.pi * np.arange(4))


@dataclass(frozen=True, eq=False)
class PlainStack:
    """A stack of fringes and Gray code alone."""

    stack: Stack
    sigma_factor: dict[tuple[int, Axis], NDArray[np.float32]]
    """(projector, axis) -> what the phase's standard deviation, predicted for four plain steps, must be multiplied by:
    (exposure, row, col)."""


def as_fringes(stack: Stack, reject_saturated: bool = True) -> PlainStack:
    """A stack in which every coding is rewritten as fringes of four steps and Gray code; the same where it has none.

    `reject_saturated`: pixels with a saturated sample are marked as saturated. Raises `DecodeError` if a coding lacks
    frames, or the projector's size is unknown.
    """
    stack = _with_one_code(_without_xor(stack))
    groups = [key for key in _groups(stack.patterns) if _coded(stack.patterns, key)]
    if not groups:
        return PlainStack(stack, {})
    sensor = _plain(stack.sensor)
    kept = [i for i, f in enumerate(stack.patterns) if not _member(f, groups)]
    frames = [stack.frames[:, kept].astype(np.float32)]
    patterns = [stack.patterns[i] for i in kept]
    factors = {}
    for projector, axis in groups:
        mine = [i for i, f in enumerate(stack.patterns) if _member(f, [(projector, axis)])]
        shown = [stack.patterns[i] for i in mine]
        made, factor = _rewritten(stack, mine, shown, sensor, reject_saturated)
        frames.append(np.concatenate(list(made.values()), axis=1))
        factors[projector, axis] = factor
        patterns += [
            Frame(axis, period, k, 4, 0.5 * np.pi * k, projector)
            for period in made
            for k in range(4)
        ]
    plain = replace(
        stack, frames=np.concatenate(frames, axis=1), patterns=tuple(patterns), sensor=sensor
    )
    return PlainStack(plain, factors)


def _groups(frames: Sequence[Frame]) -> list[tuple[int, Axis]]:
    return list(dict.fromkeys((f.projector, f.axis) for f in frames))


def _member(frame: Frame, groups: Sequence[tuple[int, Axis]]) -> bool:
    """Whether a frame takes part in the fringes of some axes: grey ones in those of both."""
    if frame.kind == "grey":
        return any(projector == frame.projector for projector, _ in groups)
    return frame.kind in ("fringe", "modulated", "line") and (frame.projector, frame.axis) in groups


def _coded(frames: Sequence[Frame], group: tuple[int, Axis]) -> bool:
    """Whether an axis has modulated fringes or lines, or fewer than three steps of some periods and what completes them."""
    mine = [f for f in frames if _member(f, [group])]
    if any(f.kind in ("modulated", "line") for f in mine):
        return True
    grey = any(f.kind == "grey" for f in mine)
    mine = [f for f in mine if f.kind == "fringe"]
    counts = [sum(f.period_px == p for f in mine) for p in {f.period_px for f in mine}]
    return bool(counts) and min(counts) < 3 and (grey or max(counts) >= 3)


def _rewritten(
    stack: Stack, mine: Sequence[int], shown: Sequence[Frame], sensor: Sensor, reject: bool
) -> tuple[dict[float, NDArray[np.float32]], NDArray[np.float32]]:
    """Four frames (exposure, 4, row, col) of each period, and the factor of sigma (exposure, row, col)."""
    image = stack.frames.shape[2:]
    made: dict[float, list[NDArray[np.float32]]] = {}
    factors = []
    for exposure, time_ms in zip(stack.frames, stack.exposure_ms, strict=True):
        dn = exposure[mine].reshape(len(mine), -1).astype(np.float64)
        found = _fitted(stack, shown, dn, stack.sensor.variance_dn2(dn, time_ms))
        clipped = (dn >= stack.saturation_dn).any(axis=0) if reject else np.zeros(dn.shape[1], bool)
        for period, phasor in found.phasors.items():
            steps = found.offset + (phasor * QUARTERS[:, None]).real
            steps = np.where(clipped, SATURATED_DN, steps).astype(np.float32)
            made.setdefault(period, []).append(steps.reshape(4, *image))
        # Four plain steps have the variance 2 v / (4 B^2).
        power = np.abs(found.phasors[min(found.phasors)]) ** 2
        four = sensor.variance_dn2(found.offset, time_ms) / (2.0 * np.maximum(power, 1e-12))
        factors.append(np.sqrt(found.variance_rad2 / four).astype(np.float32).reshape(image))
    return {period: np.stack(steps) for period, steps in made.items()}, np.stack(factors)


def _fitted(stack: Stack, shown: Sequence[Frame], dn: Floats, noise: Floats) -> Fitted:
    if any(f.kind == "modulated" for f in shown):
        return _demodulated(shown, dn, noise)
    striped = [f for f in shown if f.kind != "grey"]
    periods = [f.period_px for f in striped]
    if min(periods.count(p) for p in periods) > 1:
        waves = [[(f.period_px, 1.0, f.phase_shift_rad)] if f.kind != "grey" else [] for f in shown]
        return fit(waves, min(periods), dn, noise)
    if striped != list(shown):
        raise DecodeError(
            "fringes of one step and a grey frame are not decoded together: show two steps"
        )
    size = stack.projector_size(shown[0].projector)
    if size is None:
        raise DecodeError(
            "fringes of one step are searched for over the projector, whose size is unknown: give projector_resolution "
            "or a calibration"
        )
    return search(shown, dn, noise, float(size[0 if shown[0].axis == "column" else 1]))


def _demodulated(shown: Sequence[Frame], dn: Floats, noise: Floats) -> Fitted:
    """The carrier, and each fringe from the carrier's sidebands: ``Z+ conj(z) + z conj(Z-)`` with the carrier's direction z.

    This is the fringe's phase in the carrier's amplitude; unmodulated light of the fringe itself is fitted and dropped.
    """
    waves = [f.waves()[1] for f in shown]
    period = shown[0].carrier_px
    found = fit(waves, period, dn, noise)
    carrier = found.phasors[period]
    turn = carrier / np.maximum(np.abs(carrier), 1e-12)
    phasors = {period: 0.25 * carrier}
    for frame, parts in zip(shown, waves, strict=True):
        above, below = (found.phasors[parts[i][0]] for i in (2, 3))
        phasors[frame.period_px] = 0.125 * (above * turn.conj() + turn * below.conj())
    return Fitted(found.offset, phasors, found.variance_rad2)


def _without_xor(stack: Stack) -> Stack:
    """The stack with XOR bits as bits of plain Gray code, in the same digital numbers."""
    coded = [i for i, f in enumerate(stack.patterns) if f.kind == "xor"]
    if not coded:
        return stack
    place = {
        (f.projector, f.axis, f.step, f.inverted): i
        for i, f in enumerate(stack.patterns)
        if f.kind in ("xor", "gray")
    }
    frames, patterns = stack.frames.copy(), list(stack.patterns)
    for i in coded:
        f = stack.patterns[i]
        patterns[i] = replace(f, kind="gray")
        if f.inverted:
            continue
        try:
            other = place[f.projector, f.axis, f.step, True]
            last = [place[f.projector, f.axis, f.steps - 1, flip] for flip in (False, True)]
        except KeyError:
            raise DecodeError(
                f"bit {f.step} of the {f.axis} XOR code lacks its inverse, or the code its last bit: show both"
            ) from None
        swap = stack.frames[:, last[0]] > stack.frames[:, last[1]]
        one, two = stack.frames[:, i], stack.frames[:, other]
        frames[:, i], frames[:, other] = np.where(swap, two, one), np.where(swap, one, two)
    return replace(stack, frames=frames, patterns=tuple(patterns))


def _with_one_code(stack: Stack) -> Stack:
    """The stack with two Gray codes of an axis, displaced by half a cell, as one of half cells and one bit more.

    Their numbers add up to its number, so that its last bit is the second code's parity; the others are those of the first.
    """
    for projector, axis in _groups([f for f in stack.patterns if f.kind == "gray"]):
        mine = [
            i
            for i, f in enumerate(stack.patterns)
            if f.kind == "gray" and (f.projector, f.axis) == (projector, axis)
        ]
        origins = {
            shift: -shift * stack.patterns[i].period_px / (2.0 * np.pi)
            for i in mine
            for shift in [stack.patterns[i].phase_shift_rad]
        }
        if len(origins) != 2:
            continue
        first, second = sorted(origins, key=lambda shift: abs(origins[shift]))
        base, other = (
            [i for i in mine if stack.patterns[i].phase_shift_rad == s] for s in (first, second)
        )
        shown = stack.patterns[base[0]]
        half = abs(origins[first] - origins[second]) / shown.period_px
        if abs(half - 0.5) > 1e-6 or {
            (f.steps, f.period_px, f.plain) for f in (stack.patterns[i] for i in mine)
        } != {(shown.steps, shown.period_px, shown.plain)}:
            raise DecodeError(
                f"the two {axis} Gray codes are {half:g} cells of {shown.period_px:g} px apart: of two codes, one must be displaced "
                "by half a cell (origin_px) and both have the same bits and cell_px"
            )
        if shown.plain:
            raise DecodeError(
                f"the {axis} code is shown twice in plain binary: show it in Gray code, or leave out one"
            )
        one, two = _parity(stack, other)
        if origins[second] > origins[first]:
            one, two = two, one
        patterns = [
            replace(f, steps=f.steps + 1, period_px=f.period_px / 2.0, phase_shift_rad=2.0 * first)
            if i in base
            else f
            for i, f in enumerate(stack.patterns)
        ]
        kept = [i for i in range(len(patterns)) if i not in other]
        last = replace(patterns[base[0]], step=shown.steps, inverted=False)
        stack = replace(
            stack,
            frames=np.concatenate([stack.frames[:, kept], one[:, None], two[:, None]], axis=1),
            patterns=(*(patterns[i] for i in kept), last, replace(last, inverted=True)),
        )
    return stack


def _parity(stack: Stack, code: Sequence[int]) -> tuple[NDArray[Any], NDArray[Any]]:
    """A frame (exposure, row, col) that is bright where an odd number of bits is, as clear as the least clear one; and its inverse."""
    place = {(stack.patterns[i].step, stack.patterns[i].inverted): i for i in code}
    flat = {f.kind: i for i, f in enumerate(stack.patterns) if f.kind in ("white", "black")}
    mine = stack.frames[:, list(flat.values()) if len(flat) == 2 else list(code)]
    middle = 0.5 * (mine.min(axis=1).astype(np.float32) + mine.max(axis=1))
    sign, least = np.full_like(middle, -1.0), np.full_like(middle, np.inf)
    for step in range(stack.patterns[code[0]].steps):
        one, two = (
            stack.frames[:, place[step, flip]].astype(np.float32)
            if (step, flip) in place
            else middle
            for flip in (False, True)
        )
        sign, least = -sign * np.sign(one - two), np.minimum(least, np.abs(one - two))
    bright, dark = (middle + way * 0.5 * sign * least for way in (1.0, -1.0))
    if np.issubdtype(stack.frames.dtype, np.integer):
        bright, dark = np.rint(bright), np.rint(dark)
    return bright.astype(stack.frames.dtype), dark.astype(stack.frames.dtype)


def _plain(sensor: Sensor) -> Sensor:
    """The sensor without a converter, and so wide that only marked pixels are saturated: four plain steps may exceed the frames."""
    if isinstance(sensor, Emva):
        well_e = 0.1 * SATURATED_DN / sensor.gain_dn_per_e
        return sensor.model_copy(update={"bits": 0, "nonlinearity": (), "full_well_e": well_e})
    return sensor.model_copy(update={"bits": 0, "saturated_from_dn": 0.1 * SATURATED_DN})
