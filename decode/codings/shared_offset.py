"""Fringes of several periods that share one offset: phasors by linear least squares, or by a search over the projector.

Where each period has two steps or more, offset and phasors follow from one linear fit (Moreno, Son & Taubin 2015). Where some have
one step, all must share their amplitude too: then the frames ``A + B cos(2 pi u / P_i + delta_i)`` have three unknowns. The
finest period's own steps leave the coordinate u open by whole periods; the others choose among them over the whole projector, and
Gauss-Newton steps refine it with all frames (Gupta & Nayar 2012).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.frames import Frame
from scenes.acquisition.fringe_fit import fringe_design

Floats = NDArray[np.float64]
TURN = 2.0 * np.pi
# Steps of Gauss-Newton, and how far one may move the phase, rad: beyond, noise would run away.
STEPS = 3
FARTHEST_RAD = 0.4
# A runner-up whose sum of squares is larger by less than this many variances leaves the coordinate open: e^-8 is the likelihood
# ratio of the two. Errors of the model, beyond noise, may have this share of the runner-up's sum of squares: half its distance.
DECIDED, MODEL_ERROR = 16.0, 0.25
# Pixels searched at once: scores of a hundred candidates of some frames fit a cache.
BLOCK = 2048


@dataclass(frozen=True, eq=False)
class Fitted:
    """Phasors of some frames' waves; arrays (pixel,)."""

    offset: Floats
    """DN."""
    phasors: dict[float, NDArray[np.complex128]]
    """Period in px -> ``B exp(j phi)``, DN."""
    variance_rad2: Floats
    """Predicted variance of the phase that measures."""


def fit(
    waves: Sequence[Sequence[tuple[float, float, float]]],
    measured_px: float,
    dn: Floats,
    noise: Floats,
) -> Fitted:
    """One offset and a phasor for each period, by least squares on samples (frame, pixel) in DN of variances `noise` in
    DN^2.

    `waves` are the sinusoids of each frame: period in px, relative amplitude, and phase shift in rad.
    """
    periods = list(dict.fromkeys(period for frame in waves for period, _, _ in frame))
    design = np.zeros((len(waves), 1 + 2 * len(periods)))
    design[:, 0] = 1.0
    for row, frame in zip(design, waves, strict=True):
        for period, amplitude, shift in frame:
            column = 1 + 2 * periods.index(period)
            row[column : column + 2] += amplitude * np.cos(shift), -amplitude * np.sin(shift)
    rows = np.linalg.pinv(design)
    found = rows @ dn
    phasors = {p: found[1 + 2 * i] + 1j * found[2 + 2 * i] for i, p in enumerate(periods)}
    finest = 1 + 2 * periods.index(measured_px)
    c, s = found[finest], found[finest + 1]
    # The phase moves by (c ds - s dc) / B^2.
    across = c * rows[finest + 1][:, None] - s * rows[finest][:, None]
    power = np.maximum(c * c + s * s, 1e-12)
    return Fitted(found[0], phasors, (across**2 * noise).sum(axis=0) / power**2)


def search(frames: Sequence[Frame], dn: Floats, noise: Floats, width_px: float) -> Fitted:
    """The projector coordinate at which frames of shared offset and amplitude, (frame, pixel) in DN, fit best.

    Phasors of the finest period and of one as wide as the range, which contradicts it where the search is undecided.
    """
    periods = np.array([f.period_px for f in frames])
    shifts = np.array([f.phase_shift_rad for f in frames])
    parts = [
        _searched(periods, shifts, dn[:, at], noise[:, at], width_px)
        for at in (slice(i, i + BLOCK) for i in range(0, dn.shape[1], BLOCK))
    ]
    offset, fine, coarse, variance = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Fitted(offset, {float(periods.min()): fine, width_px: coarse}, variance)


def _searched(
    periods: Floats, shifts: Floats, dn: Floats, noise: Floats, width_px: float
) -> tuple[NDArray[Any], ...]:
    """Offset, fine and coarse phasor, and variance of some pixels."""
    finest = periods.min()
    steps = periods == finest
    _, c, s = np.linalg.pinv(fringe_design(shifts[steps])) @ dn[steps]
    orders = np.arange(int(width_px / finest) + 1)[:, None]
    candidates = (np.arctan2(s, c) / TURN % 1.0 + orders) * finest
    # (candidate, frame, pixel)
    templates = np.cos(TURN / periods[:, None] * candidates[:, None] + shifts[:, None])
    templates -= templates.mean(axis=1, keepdims=True)
    centred = dn - dn.mean(axis=0)
    score = np.einsum("kin,in->kn", templates, centred)
    score = (score / np.linalg.norm(templates, axis=1)).clip(0.0)
    score[candidates > width_px] = 0.0
    second, best = np.sort(score, axis=0)[-2:]
    mean = noise.mean(axis=0)
    # Sums of squares without what noise leaves of them, three unknowns being fitted.
    beyond = (centred**2).sum(axis=0) - (len(dn) - 3) * mean
    decided = (best**2 - second**2 > DECIDED * mean) & (
        beyond - best**2 < MODEL_ERROR * (beyond - second**2)
    )
    u = np.take_along_axis(candidates, score.argmax(axis=0)[None], axis=0)[0]
    for _ in range(STEPS):
        angle = TURN * u[:, None] / periods + shifts
        # Unknowns A, B, and B times the finest phase's change.
        design = np.stack(
            [np.ones_like(angle), np.cos(angle), -np.sin(angle) * (finest / periods)], axis=2
        )
        turned = design.transpose(0, 2, 1)
        rows = np.linalg.solve(turned @ design, turned)
        unknown = np.einsum("nij,jn->ni", rows, dn)
        change = unknown[:, 2] / np.maximum(unknown[:, 1], 1e-6)
        u = u + np.clip(change, -FARTHEST_RAD, FARTHEST_RAD) * finest / TURN
    strength = np.maximum(unknown[:, 1], 1e-6)
    variance = np.einsum("nj,jn->n", rows[:, 2] ** 2, noise) / strength**2
    fine = strength * np.exp(1j * TURN * u / finest)
    # A coarse phase half a fine period off makes decoding report a wrong order.
    at_px = u + np.where(decided, 0.0, 0.5 * finest)
    return unknown[:, 0], fine, strength * np.exp(1j * TURN * at_px / width_px), variance
