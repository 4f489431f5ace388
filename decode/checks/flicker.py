"""Brightness of the source from frame to frame of a fringe set: measured, and divided out.

A frame k that is brighter by a factor ``g_k`` bends the phase of the whole set, and two things show it. Relative to the mean A of the
steps, modulation B/A then depends on the phase, as ``cos phi`` and ``sin phi``; no texture, gamma or ambient light makes it do so. And
with four steps or more, what a sinusoid leaves of the samples no longer has the mean 0. Both are averaged in small parts of
the image, each about one fringe long, in which the contrast may change with the place; the median of the parts counts, so that parts
with an edge do not. The factors are found by Newton's iteration.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decode.checks.flicker_residual import residual_gains
from decode.phase.gamma import CLEAR
from decode.phase.n_step import TURN, FringeSet, fringe_sets, solution, wrap
from scenes.acquisition.fringe_fit import fringe_design
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.finding import Finding, graded

Floats = NDArray[np.float64]
Part = tuple[tuple[int, int], Floats, Floats]

MAX_PIXELS = 40_000
# Fringes along a part of the image, parts at most each way, and pixels of one that are few for its unknowns.
TURNS, MOST_PARTS, FEWEST_PIXELS = 1.4, (16, 8), 40
# Where fewer parts of an exposure show fringes, what they have in common may be of the surface.
FEWEST_PARTS = 12
# Neighbouring parts see the same surface: their scatter is taken between groups of them, so many each way.
GROUPS = 6
# Smallest share of the variance of ``cos phi`` and ``sin phi`` that place and contrast may leave.
INDEPENDENT = 0.15
# Residuals in standard deviations from which a pixel, such as one at an edge, counts less.
OUTLIER = 1.5
# Change of a factor that is tried, and parts on which.
CHANGE, JACOBIAN_PARTS = 0.02, 40
ITERATIONS = 6
# Standard errors that a factor must differ from 1.
SIGNIFICANT = 4.0
# Largest phase error over predicted standard deviations of the best pixels.
ERROR_SIGMAS = (2.0, 8.0)
# Largest error of the order that coarser fringes give, in periods of the next finer ones.
ORDER_TURNS = (0.1, 0.25)
# Changes of brightness below this are not reported; the method itself is good to a tenth of it.
SMALLEST = 0.003


@dataclass(frozen=True)
class Flicker:
    """Brightness of the frames of one fringe set in one exposure."""

    gains: Floats
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
    """Brightness of each frame of a fringe set; None where too few modulated, unsaturated pixels or phases show it."""
    samples, good = _pixels(stack, fringes, exposure)
    if not good.any():
        return None
    parts = _parts(samples, good, fringes)
    level, cosine, sine = np.tensordot(solution(fringes), samples, axes=1)[:, good]
    modulation = np.hypot(cosine, sine)
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    variance = constant + slope * float(np.median(level))
    if len(parts) >= FEWEST_PARTS:
        gains, uncertainty = _contrast_gains(parts, fringes)
    else:
        lines, pixels = np.nonzero(good)
        tile = lines * GROUPS // good.shape[0] * GROUPS + pixels * GROUPS // good.shape[1]
        found = residual_gains(samples[:, good], tile, fringes.shifts_rad, variance)
        if found is None:
            return None
        gains, uncertainty = found
    return Flicker(
        gains,
        uncertainty,
        _error(gains, float(np.median(modulation / level)), fringes),
        float(np.sqrt(2.0 * variance / len(gains)) / np.percentile(modulation, 95.0)),
    )


def _contrast_gains(parts: Sequence[Part], fringes: FringeSet) -> tuple[Floats, float]:
    """Brightness of each frame from contrast by phase, and its standard error."""
    gains = np.ones(len(fringes.frames))
    few = parts[:: max(1, len(parts) // JACOBIAN_PARTS)]
    # How each factor changes what is measured depends on contrast, gamma and the phases in view, so it is tried on the data.
    changed = [_measured(few, gains + CHANGE * one, fringes) for one in np.eye(len(gains))]
    inverse = np.linalg.pinv(
        (np.array(changed) - _measured(few, gains, fringes)).T / CHANGE, rcond=1e-2
    )
    for _ in range(ITERATIONS):
        gains -= gains * (inverse @ _measured(parts, gains, fringes))
        gains /= gains.mean()
    groups: dict[tuple[int, int], list[Floats]] = {}
    for group, part, place in parts:
        groups.setdefault(group, []).append(inverse @ _signs(part / gains[:, None], place, fringes))
    means = np.array([np.median(each, axis=0) for each in groups.values()])
    scatter = 1.4826 * np.median(np.abs(means - np.median(means, axis=0)), axis=0)
    # A median of Gaussian numbers scatters pi / 2 times as much as their mean.
    return gains, float(np.sqrt(0.5 * np.pi / len(means)) * scatter.max())


def _measured(parts: Sequence[Part], gains: Floats, fringes: FringeSet) -> Floats:
    """Median of the parts' signs of flicker that are left after dividing by `gains`."""
    signs = [_signs(part / gains[:, None], place, fringes) for _, part, place in parts]
    return np.asarray(np.median(signs, axis=0))


def _signs(samples: Floats, place: Floats, fringes: FringeSet) -> Floats:
    """What flicker changes in samples (step, pixel) of one part: how B/A varies with the phase, and the mean of what a sinusoid leaves.

    `place` (term, pixel) are the terms by which B/A changes anyway.
    """
    fit = solution(fringes) @ samples
    level, cosine, sine = fit
    phase = np.arctan2(sine, cosine)
    # Gamma makes B/A depend on multiples of N phi, and on 2 phi.
    steps = len(samples)
    waves = [wave(k * phase) for k in (1, 2, steps, 2 * steps) for wave in (np.cos, np.sin)]
    design = np.concatenate([waves, place]).T
    contrast = np.hypot(cosine, sine) / level
    # Noise of both is inverse to the brightness.
    trust = (level / level.max()) ** 2
    weight = trust
    # Fringes of three or four camera pixels without noise show so few phases that their waves are one.
    ridge = 1e-9 * level.size * np.eye(len(design.T))
    for _ in range(3):
        weighed = (design * weight[:, None]).T
        found = np.linalg.solve(weighed @ design + ridge, weighed @ contrast)
        left = np.abs(contrast - design @ found)
        limit = max(OUTLIER * 1.4826 * float(np.median(left)), 1e-6)
        weight = trust * limit / np.maximum(left, limit)
    left_over = (samples - fringe_design(fringes.shifts_rad) @ fit) / level
    residual = left_over @ trust / trust.sum()
    return np.concatenate([found[:2], residual])


def _parts(samples: Floats, good: NDArray[np.bool_], fringes: FringeSet) -> list[Part]:
    """Group, samples (step, pixel) and terms of place (3, pixel) of the parts of the image that show all phases."""
    _, cosine, sine = np.tensordot(solution(fringes), samples, axes=1)
    phase = np.arctan2(sine, cosine)
    lines, length = good.shape
    both = good[:, 1:] & good[:, :-1]
    if not both.any():
        return []
    turns = float(np.median(np.abs(wrap(np.diff(phase, axis=1)))[both])) * length / TURN
    count = int(np.clip(turns / TURNS, 1, MOST_PARTS[0])), min(MOST_PARTS[1], max(lines // 4, 1))
    found = []
    for j in range(count[1]):
        across = slice(j * lines // count[1], (j + 1) * lines // count[1])
        for i in range(count[0]):
            at = across, slice(i * length // count[0], (i + 1) * length // count[0])
            inside = good[at]
            if inside.sum() < FEWEST_PIXELS:
                continue
            y, x = (place - place.mean() for place in np.nonzero(inside))
            place = np.stack([np.ones(x.size), x / max(length, 1), y / max(lines, 1)])
            angle = phase[at][inside]
            waves = np.stack([np.cos(angle), np.sin(angle)])
            basis = np.linalg.qr(place.T)[0]
            left = waves - (waves @ basis) @ basis.T
            if np.linalg.eigvalsh(left @ left.T / angle.size)[0] > INDEPENDENT:
                group = j * GROUPS // count[1], i * GROUPS // count[0]
                found.append((group, samples[:, at[0], at[1]][:, inside], place))
    return found


def flicker_findings(stack: Stack, projector: int = 0, axis: Axis = "column") -> Iterator[Finding]:
    """Whether the frames of each fringe set of an axis are equally bright.

    The finest fringes of an axis measure, and are judged by their noise; the others by the order that they give. Coarser sets
    that do not show it are left out, unless the order that they give would be wrong if they flickered as others do.
    """
    sets = fringe_sets(stack.patterns, projector)[axis]
    worst = [_worst(stack, fringes) for fringes in sets]
    bends = [w.error_rad for w in worst if w is not None and w.significant]
    for fringes, finer, seen in zip(sets, (*sets[1:], None), worst, strict=True):
        name = f"{fringes.axis} fringes of {fringes.period_px:g} px, brightness"
        ratio = fringes.period_px / finer.period_px if finer else 0.0
        if seen is None:
            said = "too few fringes in view to see whether the source flickers"
            verdict = graded(ratio * max(bends, default=0.0) / TURN, *ORDER_TURNS)
            if finer is None:
                yield Finding(name, "unknown", said)
            elif verdict != "ok":
                said += (
                    f"; if it does as in the other fringes, orders are wrong by up to {ratio * max(bends) / TURN:.2f} periods of "
                    f"{finer.period_px:g} px, which --equalise cannot correct: take the frames again with a steady source"
                )
                yield Finding(name, verdict, said)
            continue
        off = float(np.abs(seen.gains - 1.0).max())
        verdict = (
            graded(ratio * seen.error_rad / TURN, *ORDER_TURNS)
            if finer
            else graded(seen.error_rad / seen.sigma_rad, *ERROR_SIGMAS)
        )
        said = f"frames differ from their mean brightness by up to {off:.2%}"
        if not seen.significant:
            verdict = "ok"
        if verdict != "ok":
            said += (
                f" (frame {int(np.abs(seen.gains - 1.0).argmax())} of {len(seen.gains)}), which bends the phase by up "
                f"to {seen.error_rad:.3f} rad: the source flickers or drifts; import with --equalise, which divides it out"
            )
        yield Finding(name, verdict, said, off)


def orders_in_doubt(stack: Stack, projector: int = 0) -> Iterator[Finding]:
    """Of `flicker_findings`, those of coarser sets that do not show their flicker."""
    for axis in fringe_sets(stack.patterns, projector):
        found = flicker_findings(stack, projector, axis)
        yield from (f for f in found if f.value is None and f.verdict != "unknown")


def _worst(stack: Stack, fringes: FringeSet) -> Flicker | None:
    """Flicker of the exposure that shows it best; None if none does."""
    found = [measured_flicker(stack, fringes, e) for e in range(len(stack.exposure_ms))]
    measured = [f for f in found if f is not None]
    return max(measured, key=lambda f: (f.significant, f.error_rad / f.sigma_rad), default=None)


def equalise(stack: Stack, projector: int = 0) -> Stack:
    """Divide each fringe frame by its relative brightness, in float32; saturated samples stay saturated, sets that do
    not show their brightness unchanged.
    """
    frames = stack.frames.astype(np.float32)
    black, limit = stack.sensor.black_level_dn, np.float32(stack.saturation_dn)
    below = np.nextafter(limit, np.float32(0.0))
    sets = fringe_sets(stack.patterns, projector).values()
    for fringes in (one for axis in sets for one in axis):
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


def _pixels(stack: Stack, fringes: FringeSet, exposure: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Samples (step, line, pixel) above black, lines along the axis, and which pixels are modulated and unsaturated."""
    frames = stack.frames[exposure]
    planes = frames if fringes.axis == "column" else frames.swapaxes(1, 2)
    every = max(1, int(np.ceil(planes[0].size / MAX_PIXELS)))
    raw = planes[list(fringes.frames), ::every].astype(np.float64)
    samples = raw - stack.sensor.black_level_dn
    level, cosine, sine = np.tensordot(solution(fringes), samples, axes=1)
    constant, slope = stack.sensor.noise_model(stack.exposure_ms[exposure])
    sigma = np.sqrt(constant + slope * np.maximum(level, 0.0))
    modulation = np.hypot(cosine, sine)
    clear = (modulation > np.maximum(CLEAR * sigma, 0.05 * level)) & (level > 0.0)
    return samples, clear & (raw.max(axis=0) < stack.saturation_dn)


def _error(gains: NDArray[np.float64], contrast: float, fringes: FringeSet) -> float:
    """Largest phase error over all phases, rad."""
    phase = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    shifts = np.asarray(fringes.shifts_rad)[:, None]
    _, cosine, sine = solution(fringes) @ (
        gains[:, None] * (1.0 + contrast * np.cos(phase + shifts))
    )
    return float(np.abs(wrap(np.arctan2(sine, cosine) - phase)).max())
