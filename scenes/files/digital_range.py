"""The range of a camera's digital numbers, seen in its frames: depth, saturation level.

Files do not say where a camera saturates: 12 bits stored at the upper end of 16 end at 65520, video levels at 235, a full
well anywhere. Clipped samples accumulate at one highest digital number, which shows in two ways. Noise makes the
histogram of unclipped samples fall off at its upper end, while clipped ones give it a spike. And in one pixel, two frames of
a fringe set with shifts far apart cannot both reach the highest level, unless they are clipped.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.patterns import Frame
from scenes.files.noise_estimate import noise_dn, set_members
from scenes.support.errors import FileError
from scenes.support.finding import Finding

# Fewer clipped samples do no harm, and may be reflections or defective pixels.
MIN_SAMPLES = 30
# A spike has this many times the samples of any level just below it.
SPIKE = 4.0
LEVELS_BELOW = 8
# Below this noise, in steps of the digital number, an unclipped surface of one brightness gives a spike too.
MIN_NOISE_STEPS = 0.4
# Phase shifts this far apart give samples that differ by an eighth of the modulation or more if one is at its maximum.
FAR_APART_RAD = np.deg2rad(59.0)
# Share of the pixels that reach the level in which two such frames do so.
TOGETHER = 0.1
# Lossy compression spreads a spike over this share of the range below the highest number, and this many levels around it.
SPREAD = 0.05
SPREAD_LEVELS = 2
# Levels in use from which a common step of the digital numbers is no coincidence.
MIN_LEVELS = 16
# Change over the frames, in parts of the highest number, below which a pixel is defective.
CONSTANT = 0.05


@dataclass(frozen=True)
class DigitalRange:
    """What the frames show of the camera's digital numbers."""

    step_dn: int
    """Digital numbers are multiples of it: 16 for 12 bits at the upper end of 16."""
    saturation_dn: float
    """From here up a sample is saturated: where samples accumulate, else the end of the range."""
    noise_dn: float
    """Standard deviation of the noise."""
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(
        cls,
        frames: NDArray[Any],
        patterns: Sequence[Frame],
        bits: int,
        saturation_dn: float | None = None,
    ) -> "DigitalRange":
        """Range of frames (exposure, frame, row, col), uint8 or uint16; `FileError` if no camera of that many bits
        gives them.
        """
        counts = _histogram(frames)
        step = _step(counts)
        _check_depth(counts, frames.dtype.itemsize * 8, bits, step)
        end = float((2**bits - 1) // step * step)
        if saturation_dn is not None:
            return cls(step, saturation_dn, noise_dn(frames, saturation_dn, step, patterns))
        found = _clipped_from(frames, patterns, step, end)
        if found is None:
            said = f"digital numbers are multiples of {step}, so the range ends at {end:g} DN"
            notes = (Finding("saturation level", "ok", said, end),) if step > 1 else ()
            return cls(step, end, noise_dn(frames, end, step, patterns), notes)
        level, samples = found
        said = (
            f"{samples} samples accumulate at {level:g} DN although the range ends at {end:g}: the camera saturates there, "
            f"and samples from {level:g} DN up are taken as saturated; state it with saturation_dn = {level:g}"
        )
        note = Finding("saturation level", "warning", said, level)
        return cls(step, level, noise_dn(frames, level, step, patterns), (note,))


def _histogram(frames: NDArray[Any]) -> NDArray[np.int64]:
    """Number of samples of each digital number, (DN,)."""
    size = 2 ** (8 * frames.dtype.itemsize)
    counts = np.zeros(size, np.int64)
    for frame in frames.reshape(-1, *frames.shape[2:]):
        counts += np.bincount(frame.ravel(), minlength=size)
    return counts


def _step(counts: NDArray[np.int64]) -> int:
    """Largest number that divides all digital numbers; 1 where too few are in use to know."""
    levels = np.flatnonzero(counts)
    return int(np.gcd.reduce(levels)) if len(levels) >= MIN_LEVELS else 1


def _check_depth(counts: NDArray[np.int64], stored: int, bits: int, step: int) -> None:
    if bits > stored:
        raise FileError(
            f"bits = {bits}, but the files hold {stored}-bit numbers: set bits = {stored}"
        )
    brightest = int(np.flatnonzero(counts)[-1])
    if brightest > 2**bits - 1:
        upper = step > 1 and brightest >= 2 ** (stored - 1)
        raise FileError(
            f"bits = {bits} ends at {2**bits - 1}, but the brightest sample is {brightest}"
            + (f" and all are multiples of {step}" if upper else "")
            + f": set bits = {stored if upper else max(brightest.bit_length(), 8)}"
            + (", for the camera's bits are at the upper end of the numbers" if upper else "")
        )
    full = [n for n in range(8, bits) if brightest == 2**n - 1]
    # Samples exactly at a shorter converter's end, in many pixels, are that converter clipping.
    clipped = int(counts[brightest]) if full else 0
    if clipped > 10:
        raise FileError(
            f"bits = {bits}, but {clipped} samples are exactly at {brightest} and none above: the camera has {full[0]} "
            f"bits; set bits = {full[0]}, or saturation would not be detected"
        )


def _clipped_from(
    frames: NDArray[Any], patterns: Sequence[Frame], step: int, end: float
) -> tuple[float, int] | None:
    """Level below the range's end at which samples are clipped, and how many; None if there is none."""
    # A defective pixel is as bright in every frame; samples of the others are counted.
    counts = np.zeros(2 ** (8 * frames.dtype.itemsize), np.int64)
    working = []
    for exposure in frames:
        low, high = exposure.min(axis=0), exposure.max(axis=0)
        working.append(high - low >= CONSTANT * high.max(initial=1))
        for frame in exposure:
            counts += np.bincount(frame[working[-1]], minlength=counts.size)
    levels = counts[::step]
    if not levels.any():
        return None
    top = int(np.flatnonzero(levels)[-1])
    if top * step >= end:
        return None
    below = levels[max(top - LEVELS_BELOW, 0) : top]
    if levels[top] >= MIN_SAMPLES and levels[top] > SPIKE * below.max(initial=0):
        quiet = noise_dn(frames, top * step, step) < MIN_NOISE_STEPS * step
        if not quiet or _together(frames, patterns, working, top * step):
            return float(top * step), int(levels[top])
    # Lossy compression: the spike is the most frequent level of the uppermost part, and has a few levels' width.
    start = int(top - SPREAD * end / step)
    if top < 3 * (top - start):
        # All frames are dark: nothing is clipped so far down.
        return None
    spike = start + int(np.argmax(levels[start:]))
    first = max(spike - SPREAD_LEVELS, 0)
    samples = int(levels[first:].sum())
    before = int(levels[max(first - SPREAD_LEVELS * 2 - 1, 0) : first].sum())
    sharp = samples >= MIN_SAMPLES and samples > SPIKE * before
    if sharp and _together(frames, patterns, working, first * step):
        return float(first * step), samples
    return None


def _together(
    frames: NDArray[Any],
    patterns: Sequence[Frame],
    working: Sequence[NDArray[np.bool_]],
    level: float,
) -> bool:
    """Whether two frames of a fringe set, far apart in phase, reach a level in the same pixels."""
    both = any_one = 0
    for members in set_members(patterns):
        shifts = np.array([patterns[k].phase_shift_rad for k in members])
        apart = np.abs(np.angle(np.exp(1j * (shifts[:, None] - shifts)))) >= FAR_APART_RAD
        for exposure, works in zip(frames, working, strict=True):
            at = np.stack([exposure[k][works] >= level for k in members])
            any_one += int(at.any(axis=0).sum())
            pairs = np.zeros(at.shape[1], np.bool_)
            for i, j in zip(*np.nonzero(np.triu(apart)), strict=True):
                pairs |= at[i] & at[j]
            both += int(pairs.sum())
    return both >= MIN_SAMPLES and both > TOGETHER * any_one
