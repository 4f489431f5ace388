"""The range of a camera's digital numbers, seen in its frames: depth, saturation level, noise.

Files do not say where a camera saturates: 12 bits stored at the upper end of 16 end at 65520, video levels at 235, a full
well anywhere. Clipped samples accumulate at one highest digital number, which shows in two ways. Noise makes the
histogram of unclipped samples fall off at its upper end, while clipped ones give it a spike. And in one pixel, two frames of
a fringe set with shifts far apart cannot both reach the highest level, unless they are clipped.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.fringe_fit import fringe_design, fringe_solution
from scenes.acquisition.patterns import Frame
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
# Mean |x| of the smaller nine tenths of Gaussian numbers, in standard deviations: sqrt(2/pi) (1 - exp(-a^2/2)) / 0.9 with
# a = 1.645 the limit of those nine tenths.
TRIMMED_MEAN = 0.6573
FEWEST_PIXELS = 100
MAX_PIXELS = 200_000


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
    for members in _sets(patterns):
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


def _sets(patterns: Sequence[Frame]) -> Iterator[list[int]]:
    """Indices of the frames of each fringe set."""

    def key(k: int) -> tuple[int, int, str, float]:
        frame = patterns[k]
        return frame.camera, frame.projector, frame.axis, frame.period_px

    fringes = sorted((k for k, f in enumerate(patterns) if f.kind == "fringe"), key=key)
    for _, members in groupby(fringes, key=key):
        yield list(members)


def noise_dn(
    frames: NDArray[Any],
    saturation_dn: float = float("inf"),
    step_dn: float = 1.0,
    patterns: Sequence[Frame] = (),
) -> float:
    """Standard deviation in DN of the noise of frames (exposure, frame, row, col), from their roughness, or what a
    sinusoid leaves of four steps or more; never below rounding noise.

    Weights 1 -2 1 by 1 -2 1 cancel whatever is linear along a row or a column; the mean absolute value over the
    brightest tenth of the pixels gives sigma (Immerkaer, CVIU 64, 300 (1996)), without the roughest tenth, which is
    edges. Where less than a tenth of the image is lit, the lit pixels are used. Saturated samples are left out with
    their neighbours.
    """
    every = max(1, frames.shape[1] // 6)
    planes = [f for f in frames.reshape(-1, *frames.shape[2:])[::every] if min(f.shape) >= 3]
    rough = [s for f in planes if (s := _roughness(f, saturation_dn)) is not None]
    # Texture adds to the first, gamma and flicker to the second, narrow stripes to the third: the smallest is nearest.
    found = (
        rough,
        list(_misfits(frames, patterns, saturation_dn)),
        list(_untextured(frames[:, ::every], saturation_dn)),
    )
    sigmas = [float(np.median(s)) for s in found if s]
    return float(max(min(sigmas, default=0.0), step_dn * np.sqrt(1.0 / 12.0)))


def _misfits(
    frames: NDArray[Any], patterns: Sequence[Frame], saturation_dn: float
) -> Iterator[float]:
    """Noise in DN of each fringe set of four steps or more: what a sinusoid leaves of the bright pixels' samples."""
    every = max(1, int(np.sqrt(frames[0, 0].size / MAX_PIXELS)))
    for members in _sets(patterns):
        shifts = [patterns[k].phase_shift_rad for k in members]
        solution = fringe_solution(shifts)
        if solution is None or len(members) < 4:
            continue
        for exposure in frames:
            samples = exposure[members][:, ::every, ::every].reshape(len(members), -1)
            samples = samples[:, samples.max(axis=0) < saturation_dn].astype(np.float64)
            if samples.shape[1] < FEWEST_PIXELS:
                continue
            level = samples.mean(axis=0)
            samples = samples[:, level >= _bright(level)]
            left = samples - fringe_design(shifts) @ (solution @ samples)
            yield float(np.sqrt((left**2).sum(axis=0).mean() / (len(members) - 3)))


def _untextured(frames: NDArray[Any], saturation_dn: float) -> Iterator[float]:
    """Noise in DN of each exposure from what roughness is not shared by all frames in proportion to their light, as texture is."""
    for exposure in frames:
        if len(exposure) < 4 or min(exposure.shape[1:]) < 3:
            continue
        planes = [plane.astype(np.float32) for plane in exposure]
        rough = np.stack([np.diff(np.diff(p, 2, axis=0), 2, axis=1) for p in planes])
        light = np.stack([cv2.blur(p, (5, 5))[1:-1, 1:-1] for p in planes])
        free = np.stack([cv2.dilate(p, np.ones((3, 3)))[1:-1, 1:-1] for p in planes]).max(axis=0)
        free = free < saturation_dn
        shared = (rough * light).sum(axis=0) / np.maximum((light**2).sum(axis=0), 1e-6)
        left = np.abs(rough - shared * light)[:, free]
        # Where all that the weights reach is lit.
        level = cv2.erode(np.mean(planes, axis=0), np.ones((3, 3)))[1:-1, 1:-1][free]
        if level.size < FEWEST_PIXELS:
            continue
        seen = left[:, level >= _bright(level)].ravel()
        kept = np.sort(seen)[: max(1, int(0.9 * seen.size))]
        share = np.sqrt(1.0 - 1.0 / len(planes))
        yield float(kept.mean()) / (6.0 * TRIMMED_MEAN * share)


def _bright(levels: NDArray[Any]) -> float:
    """Level from which pixels are the brightest tenth, or lit where fewer than a tenth are."""
    tenth, lit = np.percentile(levels, 90.0), 0.5 * np.percentile(levels, 99.9)
    few = tenth < lit and (levels >= lit).sum() >= FEWEST_PIXELS
    return float(lit if few else tenth)


def _roughness(frame: NDArray[Any], saturation_dn: float) -> float | None:
    """Noise of one frame in DN; None if too few pixels are unsaturated."""
    plane = frame.astype(np.float32)
    rough = np.abs(np.diff(np.diff(plane, 2, axis=0), 2, axis=1))
    # Independent of the roughness, so that choosing bright pixels does not choose noisy ones.
    centre = cv2.blur(plane, (3, 3))[1:-1, 1:-1]
    if plane.max() >= saturation_dn:
        clipped = plane >= saturation_dn
        rows = clipped[:-2] | clipped[1:-1] | clipped[2:]
        free = ~(rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])
        rough, centre = rough[free], centre[free]
    if not centre.size:
        return None
    seen = rough[centre >= _bright(centre)]
    kept = np.sort(seen)[: max(1, int(0.9 * seen.size))]
    # The weights' squares sum to 36.
    return float(kept.mean()) / (6.0 * TRIMMED_MEAN)
