"""Gray code: which cell of the projector lights a pixel, bit by bit, and how far that can be trusted.

A bit is the sign of frame minus inverse, summed over exposures (a clipped pair adds nothing, a half clipped one the right
sign); without inverses, of frame minus the pixel's own threshold: the mean of white and black, else the offset of the
fringes, else the middle between the brightest and the darkest frame of the code. A bit weaker than `SURE` standard
deviations of its noise, or than `WEAK` of the pixel's contrast, is unsure. Neighbouring cells differ in one bit, so one
unsure bit means a pixel across the edge between two cells, and its coordinate is that edge. Unsure bits at the fine end
(blur, a pixel wider than the stripes) make the cell wider; any other two make the code worthless.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from decode.device import Device, Lanes
from scenes.acquisition.patterns import Axis, Frame
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# A bit flipped by noise alone at five standard deviations: three pixels in ten million.
SURE = 5.0
# A pixel wider than a bit's stripes averages them, and the sign of what is left may be the wrong one: at one and a half
# periods it is a third of the contrast, inverted. Up to there a bit carries no information.
WEAK = 1.0 / 3.0
# Fine bits that may be lost to blur before the code is no measurement any more.
MOST_LOST = 3


@dataclass(frozen=True)
class GraySet:
    """The Gray code frames of one axis and projector: indices into the stack's frames."""

    axis: Axis
    cell_px: float
    direct: tuple[int | None, ...]
    """Frame of each bit, most significant first."""
    inverse: tuple[int | None, ...]
    """Frame of each bit's inverse."""
    white: int | None
    black: int | None
    origin_px: float
    """Projector coordinate at which code 0 begins."""
    plain: bool = False
    """Plain binary instead of reflected Gray code."""

    @property
    def bits(self) -> int:
        """Length of the code."""
        return len(self.direct)

    def ambiguity(self, field_px: float) -> str:
        """Why the code is not unique over a projector of that size, px; empty if it is, or the size is infinite (unknown)."""
        codes = 2**self.bits
        # The first and the last pixel's centres are one pixel less than the size apart.
        if np.isinf(field_px) or codes * self.cell_px + self.origin_px > field_px - 1.0:
            return ""
        return (
            f"the {self.axis} Gray code of {self.bits} bits numbers {codes * self.cell_px:g} px, the projector has "
            f"{field_px:g}: set cell_px = {np.ceil(field_px / codes):g} if the finest bits were not shown"
        )


@dataclass(frozen=True)
class GrayCell:
    """The decoded code of every pixel, as lanes."""

    centre_px: Lanes
    """Middle of the cell, or the edge between two cells for a pixel across it, float32."""
    width_px: Lanes
    """Width of the cell that the sure bits leave, float32."""
    sure: Lanes
    """False where the code may be off by more than a cell."""
    contrast: Lanes
    """Half of the largest difference between bright and dark, DN."""
    offset: Lanes
    """Mean of bright and dark, DN, black level included."""
    contrast_variance: Lanes
    """Variance of a bit's half difference, relative to `contrast` squared: 1 / (signal to noise) ** 2."""
    exposure: Lanes
    """The exposure of largest contrast."""


def gray_sets(frames: Sequence[Frame], projector: int) -> dict[Axis, GraySet]:
    """A projector's Gray codes by axis. Raises `DecodeError` if a bit is missing or shown twice."""
    mine = [(i, f) for i, f in enumerate(frames) if f.projector == projector]
    flat = {f.kind: i for i, f in mine if f.kind in ("white", "black")}
    sets: dict[Axis, GraySet] = {}
    for axis in dict.fromkeys(f.axis for _, f in mine if f.kind == "gray"):
        code = [(i, f) for i, f in mine if f.kind == "gray" and f.axis == axis]
        first = code[0][1]
        bits, cell_px = first.steps, first.period_px
        alike = (bits, cell_px, first.phase_shift_rad, first.plain)
        places: dict[tuple[int, bool], int] = {}
        for i, f in code:
            key = (f.step, f.inverted)
            if (f.steps, f.period_px, f.phase_shift_rad, f.plain) != alike or key in places:
                raise DecodeError(
                    f"the {axis} Gray code shows bit {f.step} of {f.steps} (cell {f.period_px:g} px) where it has "
                    f"{bits} bits of {cell_px:g} px: give one code an axis, each bit once, all of one origin"
                )
            places[key] = i
        direct, inverse = (
            tuple(places.get((bit, flip)) for bit in range(bits)) for flip in (False, True)
        )
        lost = [bit for bit in range(bits) if direct[bit] is None and inverse[bit] is None]
        if lost:
            raise DecodeError(f"the {axis} Gray code of {bits} bits lacks bits {lost}")
        sets[axis] = GraySet(
            axis,
            cell_px,
            direct,
            inverse,
            flat.get("white"),
            flat.get("black"),
            origin_px=-first.phase_shift_rad * cell_px / (2.0 * np.pi),
            plain=first.plain,
        )
    return sets


def cells_of(
    device: Device,
    gray: GraySet,
    stack: Stack,
    plane: Callable[[Any], Lanes],
    fringe_offset: Sequence[Lanes] | None = None,
    weak: float = WEAK,
) -> GrayCell:
    """Middle and width in px of each pixel's cell in one axis' Gray code, and whether they are sure, as lanes.

    `fringe_offset` is the fringes' mean of each exposure in DN, as threshold where the code has none; `weak` the share
    of the contrast below which a bit is unsure, 0 where fringes check the code.
    """
    dr, types = device.dr, device.types
    noise = [stack.sensor.noise_model(ms) for ms in stack.exposure_ms]
    black = stack.sensor.black_level_dn
    signals: list[Lanes] = [types.Float(0.0)] * gray.bits
    variance = types.Float(0.0)
    best = offset = types.Float(0.0)
    exposure = types.UInt32(0)
    for e, frames in enumerate(stack.frames):
        threshold = None
        if None in gray.direct or None in gray.inverse:
            threshold = _threshold(device, gray, frames, plane, fringe_offset and fringe_offset[e])
        largest, middle = types.Float(0.0), types.Float(0.0)
        for bit in range(gray.bits):
            difference, mean = _difference(gray, bit, frames, plane, threshold)
            signals[bit] = signals[bit] + difference
            strength = dr.abs(difference)
            middle = dr.select(strength > largest, mean, middle)
            largest = dr.maximum(largest, strength)
        constant, slope = noise[e]
        variance = variance + 2.0 * (constant + slope * dr.maximum(middle - black, 0.0))
        better = largest > best
        best, offset = dr.select(better, largest, best), dr.select(better, middle, offset)
        exposure = dr.select(better, types.UInt32(e), exposure)
    limit = dr.maximum(SURE * dr.sqrt(variance), weak * best)
    return _cells(device, gray, signals, limit, best, offset, variance, exposure)


def _difference(
    gray: GraySet, bit: int, frames: Any, plane: Callable[[Any], Lanes], threshold: Lanes | None
) -> tuple[Lanes, Lanes]:
    """Bright minus dark of one bit, signed, and their mean."""
    direct, inverse = gray.direct[bit], gray.inverse[bit]
    if direct is not None and inverse is not None:
        one, other = plane(frames[direct]), plane(frames[inverse])
        return one - other, 0.5 * (one + other)
    index, sign = (direct, 2.0) if direct is not None else (inverse, -2.0)
    assert index is not None and threshold is not None  # `gray_sets` and `decode` saw to it.
    return sign * (plane(frames[index]) - threshold), threshold


def _threshold(
    device: Device,
    gray: GraySet,
    frames: Any,
    plane: Callable[[Any], Lanes],
    fringe_offset: Lanes | None,
) -> Lanes:
    if gray.white is not None and gray.black is not None:
        return 0.5 * (plane(frames[gray.white]) + plane(frames[gray.black]))
    if fringe_offset is not None:
        return fringe_offset
    shown = [plane(frames[i]) for i in (*gray.direct, *gray.inverse) if i is not None]
    low = high = shown[0]
    for values in shown[1:]:
        low, high = device.dr.minimum(low, values), device.dr.maximum(high, values)
    return 0.5 * (low + high)


def _cells(
    device: Device,
    gray: GraySet,
    signals: Sequence[Lanes],
    limit: Lanes,
    best: Lanes,
    offset: Lanes,
    variance: Lanes,
    exposure: Lanes,
) -> GrayCell:
    dr, types = device.dr, device.types
    one, zero = types.UInt32(1), types.UInt32(0)
    value, parity = zero, types.Bool(False)
    for signal in signals:
        parity = (signal > 0.0) if gray.plain else parity ^ (signal > 0.0)
        value = (value << 1) | dr.select(parity, one, zero)
    # Unsure bits counted from the fine end, and the others; `flip` turns a code into the one with that other bit inverted.
    lost, others, flip, run = zero, zero, zero, types.Bool(True)
    for place, signal in enumerate(reversed(signals)):
        unsure = dr.abs(signal) < limit
        run = run & unsure
        lost = lost + dr.select(run, one, zero)
        isolated = unsure & ~run
        others = others + dr.select(isolated, one, zero)
        changed = 1 << place if gray.plain else (2 << place) - 1
        flip = dr.select(isolated, types.UInt32(changed), flip)
    block = types.Int32(value >> lost)
    beyond = types.Int32((value ^ flip) >> lost)
    width = types.Float(one << lost)
    # Across an edge, the place is the edge itself, between two neighbouring blocks.
    middle = 0.5 * types.Float(block + beyond + 1)
    single = (others == 0) | ((others == 1) & (dr.abs(block - beyond) == 1))
    contrast = 0.5 * best
    return GrayCell(
        centre_px=middle * width * gray.cell_px + gray.origin_px,
        width_px=width * gray.cell_px,
        sure=single & (lost <= min(MOST_LOST, gray.bits - 1)),
        contrast=contrast,
        offset=offset,
        contrast_variance=0.25 * variance / dr.square(contrast),
        exposure=exposure,
    )
