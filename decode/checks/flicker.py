"""Brightness of the source from frame to frame of a fringe set: measured, and divided out.

A frame k that is brighter by a factor ``g_k`` bends the phase of the whole set. Averaged over whole fringes, ``I_k / A`` is
``g_k`` whatever the reflectance, because the fringe's cosine averages out. The average is taken along lines across the
fringes, over one turn of phase and again over whole turns, so that a steady change of the fringes' contrast cancels too; it
takes runs of pixels two turns long. The factors are found by iteration, because A and the phase are fitted to frames that
the factors have changed; their uncertainty is the scatter from run to run.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decode.phase.gamma import CLEAR
from decode.phase.n_step import TURN, FringeSet, fringe_sets, solution, wrap
from scenes.files.stack import Stack
from scenes.support.finding import Finding, graded

MAX_LINES = 96
# Parts of the image, bands of lines by parts of a line, whose medians give the scatter: neighbouring lines see the same
# surface, so that their runs are no independent measurements.
BANDS, PARTS, MIN_PARTS = 6, 3, 5
# Phase from sample to sample of a run: above noise, and below half a turn.
STEP_RAD = 0.3
MAX_STEP_RAD = 2.0
STARTS = 16
# The error of the factors shrinks to a half or less with each one.
ITERATIONS = 10
# Standard errors that a factor must differ from 1.
SIGNIFICANT = 4.0
# Largest phase error over predicted standard deviations of the best pixels.
ERROR_SIGMAS = (2.0, 8.0)
# Changes of brightness below this are not reported; the method itself is good to a tenth of it.
SMALLEST = 0.003


@dataclass(frozen=True)
class Flicker:
    """Brightness of the frames of one fringe set in one exposure."""

    gains: NDArray[np.float64]
    """(step,) relative to their mean."""
    uncertainty: float
    """Standard error of a factor."""
    error_rad: float
    """Largest phase error that they make."""
    sigma_rad: float
    """Predicted standard deviation of the phase where the modulation is highest (95th percentile)."""

    @property
    def significant(self) -> bool:
        """Whether a frame's brightness differs from the mean beyond doubt."""
        off = float(np.abs(self.gains - 1.0).max())
        return off > max(SMALLEST, SIGNIFICANT * self.uncertainty)


def measured_flicker(stack: Stack, fringes: FringeSet, exposure: int) -> Flicker | None:
    """Brightness of each frame of a fringe set; None where too few runs of modulated, unsaturated pixels show two
    fringes side by side.
    """
    samples, good = _lines(stack, fringes, exposure)
    rows, steps = solution(fringes), len(fringes.frames)
    gains, means = np.ones(steps), np.empty((0, steps))
    for _ in range(ITERATIONS):
        means = _part_means(samples / gains[:, None, None], good, rows)
        if len(means) < MIN_PARTS:
            return None
        gains *= np.median(means, axis=0)
        gains /= gains.mean()
    scatter = 1.4826 * np.median(np.abs(means - np.median(means, axis=0)), axis=0)
    level, cosine, sine = np.tensordot(rows, samples, axes=1)[:, good]
    modulation = np.hypot(cosine, sine)
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    variance = constant + slope * float(np.median(level))
    return Flicker(
        gains,
        # A median of Gaussian numbers scatters pi / 2 times as much as their mean, and the iteration doubles it.
        float(2.0 * np.sqrt(0.5 * np.pi / len(means)) * scatter.max()),
        _error(gains, float(np.median(modulation / level)), fringes),
        float(np.sqrt(2.0 * variance / steps) / np.percentile(modulation, 95.0)),
    )


def _part_means(
    samples: NDArray[np.float64], good: NDArray[np.bool_], rows: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Median (part, step) over the runs of each part of the image."""
    parts: dict[tuple[int, int], list[NDArray[np.float64]]] = {}
    for part, mean in _run_means(samples, good, rows):
        parts.setdefault(part, []).append(mean)
    return np.array([np.median(means, axis=0) for means in parts.values()])


def _run_means(
    samples: NDArray[np.float64], good: NDArray[np.bool_], rows: NDArray[np.float64]
) -> Iterator[tuple[tuple[int, int], NDArray[np.float64]]]:
    """Part of the image, and mean (step,) of ``I_k / A`` over whole fringes of each run of good pixels in which the phase keeps its direction."""
    level, cosine, sine = np.tensordot(rows, samples, axes=1)
    phase = np.arctan2(sine, cosine)
    both = good[:, 1:] & good[:, :-1]
    typical = float(np.median(np.abs(wrap(np.diff(phase, axis=1)))[both])) if both.any() else 0.0
    every = int(np.clip(STEP_RAD / max(typical, 1e-3), 1, 16))
    for line in range(len(good)):
        at, inside = phase[line, ::every], good[line, ::every]
        step = wrap(np.diff(at))
        joined = inside[1:] & inside[:-1]
        if not joined.any():
            continue
        direction = np.sign(np.median(step[joined]))
        joined &= (step * direction > 0.0) & (np.abs(step) < MAX_STEP_RAD)
        ratio = samples[:, line, ::every] / np.maximum(level[line, ::every], 1e-6)
        bounds = np.flatnonzero(np.diff(np.concatenate([[False], joined, [False]]).astype(np.int8)))
        for start, stop in zip(bounds[::2], bounds[1::2], strict=True):
            mean = _whole_turns(ratio[:, start : stop + 1], np.abs(step[start:stop]))
            if mean is not None:
                middle = (start + stop) // 2
                yield (line * BANDS // len(good), middle * PARTS // len(at)), mean


def _whole_turns(
    ratio: NDArray[np.float64], step: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Mean (step,) over one turn of phase, averaged over starts that fill whole turns; None for less than two turns."""
    turns = int(step.sum() / TURN) - 1
    if turns < 1:
        return None
    at = np.concatenate([[0.0], np.cumsum(step)])
    middle = 0.5 * (ratio[:, 1:] + ratio[:, :-1]) * step
    sums = np.concatenate([np.zeros((len(ratio), 1)), np.cumsum(middle, axis=1)], axis=1)
    starts = np.arange(turns * STARTS) * (TURN / STARTS)
    ends = [np.interp(starts + TURN, at, s) - np.interp(starts, at, s) for s in sums]
    return np.asarray(np.mean(ends, axis=1) / TURN)


def flicker_findings(stack: Stack, projector: int = 0) -> Iterator[Finding]:
    """Whether the frames of each fringe set are equally bright; sets that do not show it are left out."""
    for fringes in _sets(stack, projector):
        name = f"{fringes.axis} fringes of {fringes.period_px:g} px, brightness"
        found = [measured_flicker(stack, fringes, e) for e in range(len(stack.exposure_ms))]
        measured = [f for f in found if f is not None]
        if not measured:
            continue
        worst = max(measured, key=lambda f: (f.significant, f.error_rad / f.sigma_rad))
        off = float(np.abs(worst.gains - 1.0).max())
        verdict = graded(worst.error_rad / worst.sigma_rad, *ERROR_SIGMAS)
        said = f"frames differ from their mean brightness by up to {off:.2%}"
        if not worst.significant:
            verdict = "ok"
        if verdict != "ok":
            said += (
                f" (frame {int(np.abs(worst.gains - 1.0).argmax())} of {len(worst.gains)}), which bends the phase by up to "
                f"{worst.error_rad:.3f} rad: the source flickers or drifts; import with --equalise, which divides it out"
            )
        yield Finding(name, verdict, said, off)


def equalise(stack: Stack, projector: int = 0) -> Stack:
    """Divide each fringe frame by its relative brightness, in float32; saturated samples stay saturated, sets that do
    not show their brightness unchanged.
    """
    frames = stack.frames.astype(np.float32)
    black, limit = stack.sensor.black_level_dn, np.float32(stack.saturation_dn)
    below = np.nextafter(limit, np.float32(0.0))
    for fringes in _sets(stack, projector):
        for exposure in range(len(stack.exposure_ms)):
            found = measured_flicker(stack, fringes, exposure)
            if found is None or not found.significant:
                continue
            for frame, gain in zip(fringes.frames, found.gains, strict=True):
                plane = stack.frames[exposure, frame]
                scaled = black + (plane.astype(np.float32) - np.float32(black)) / np.float32(gain)
                # A sample keeps its side of the limit.
                frames[exposure, frame] = np.where(
                    plane >= limit, np.maximum(scaled, limit), np.minimum(scaled, below)
                )
    return replace(stack, frames=frames)


def _sets(stack: Stack, projector: int) -> Iterator[FringeSet]:
    for sets in fringe_sets(stack.patterns, projector).values():
        yield from sets


def _lines(
    stack: Stack, fringes: FringeSet, exposure: int
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Samples (step, line, pixel) above black on lines along the axis, and which pixels are modulated and unsaturated."""
    frames = stack.frames[exposure]
    planes = frames if fringes.axis == "column" else frames.swapaxes(1, 2)
    every = max(1, planes.shape[1] // MAX_LINES)
    raw = planes[list(fringes.frames), ::every].astype(np.float64)
    samples = raw - stack.sensor.black_level_dn
    level, cosine, sine = np.tensordot(solution(fringes), samples, axes=1)
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    sigma = np.sqrt(constant + slope * np.maximum(level, 0.0))
    clear = np.hypot(cosine, sine) > np.maximum(CLEAR * sigma, 0.05 * level)
    return samples, clear & (raw.max(axis=0) < stack.saturation_dn) & (level > 0.0)


def _error(gains: NDArray[np.float64], contrast: float, fringes: FringeSet) -> float:
    """Largest phase error over all phases, rad."""
    phase = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    shifts = np.asarray(fringes.shifts_rad)[:, None]
    _, cosine, sine = solution(fringes) @ (
        gains[:, None] * (1.0 + contrast * np.cos(phase + shifts))
    )
    return float(np.abs(wrap(np.arctan2(sine, cosine) - phase)).max())
