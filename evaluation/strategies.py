"""Strategies against high dynamic range: a plan of acquisition and a fusion rule, at a stated budget of light.

A plan takes its pictures through a function handed to it, so nothing here knows whether a renderer or a camera does it.
The reference is the scene's own acquisition: every exposure of every frame. A budget is the reference's total exposure
time (``equal-time``) or its number of frames (``equal-frames``); plans that need less repeat their pictures until it is
used, and repeats are decoded together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

import decode
from decode.exposure_choice import AutoExposure
from scenes.errors import ScoreError, nearest
from scenes.patterns import PhaseShift
from scenes.stack import Stack

Budget = Literal["equal-time", "equal-frames"]
BUDGETS: tuple[Budget, ...] = ("equal-time", "equal-frames")
Level = float | NDArray[np.float64]

MOST_STEPS = 64
# Adaptive projection: grey levels it dims by, and how near to saturation it lets the brightest sample come.
LEVELS = 16
HEADROOM = 0.9


class Shoot(Protocol):
    """Takes the pictures of one set of patterns."""

    def __call__(
        self, patterns: PhaseShift, times_ms: Sequence[float], level: Level = 1.0
    ) -> Stack:
        """Every exposure of every frame, the projector dimmed to `level` in (0, 1], a number or an image (row, col)."""


@dataclass(frozen=True, eq=False)
class Shot:
    """What was shown, how long, how bright: all that the frames' information depends on."""

    patterns: PhaseShift
    times_ms: tuple[float, ...]
    level: Level = 1.0

    def frames(self, projectors: int) -> int:
        """Pictures taken."""
        return len(self.times_ms) * len(self.patterns.frames(projectors))

    def light_ms(self, projectors: int) -> float:
        """Sum of all pictures' exposure times."""
        return sum(self.times_ms) * len(self.patterns.frames(projectors))


@dataclass(frozen=True)
class Reference:
    """The acquisition whose light or frames all others are given."""

    patterns: PhaseShift
    times_ms: tuple[float, ...]
    projectors: int = 1

    @property
    def shot(self) -> Shot:
        """The reference itself."""
        return Shot(self.patterns, self.times_ms)

    @property
    def middle_ms(self) -> float:
        """The middle exposure, by time."""
        return self.times_ms[decode.middle_exposure(self.times_ms)]


@dataclass(frozen=True, eq=False)
class Capture:
    """Pictures taken under a plan."""

    stack: Stack
    shot: Shot
    """How the stack was taken."""
    frames: int
    """All pictures, a plan's own first looks included."""
    exposure_ms: float
    """Total exposure time of all pictures."""


Plan = Callable[[Shoot, Reference, Budget], Capture]


@dataclass(frozen=True)
class Strategy:
    """A plan of acquisition and a fusion rule."""

    name: str
    plan: Plan
    fusion: str
    source: str
    """The paper."""
    saturation: Literal["reject", "ignore"] = "reject"


def ladder(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """The reference's own exposures: alike under both budgets."""
    return _take(shoot, reference, reference.shot)


def fixed(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """The middle exposure alone, repeated."""
    shot = _filled(reference, budget, reference.patterns, reference.middle_ms)
    return _take(shoot, reference, shot)


def metered(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """The exposure of the ladder that the histogram asks for, repeated. Metering is not counted: it is done once, for
    many pictures.
    """
    seen = shoot(reference.patterns, reference.times_ms)
    chosen = AutoExposure().prepare(seen).exposure
    assert chosen is not None
    shot = _filled(reference, budget, reference.patterns, reference.times_ms[chosen])
    return _take(shoot, reference, shot)


def inverted(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """Three steps and the same three inverted (shifted by pi), at the middle exposure: where one clips, its inverse does
    not. An even number of steps would only repeat its patterns.
    """
    patterns = _two_sets(reference.patterns, 3, np.pi)
    return _take(shoot, reference, _filled(reference, budget, patterns, reference.middle_ms))


def complementary(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """The N steps and a second set shifted by pi / N, at the middle exposure: the clipped wave's ripple has N-fold symmetry
    and opposite sign in the second set. Decoded together, which is the mean of both sets' phases to first order.
    """
    steps = reference.patterns.steps
    each = len(reference.times_ms) * steps
    if budget == "equal-frames" and each % (2 * steps):
        steps = max(
            3, each // 2
        )  # two sets of more steps use up the frames that whole repeats cannot
    patterns = _two_sets(reference.patterns, steps, np.pi / steps)
    return _take(shoot, reference, _filled(reference, budget, patterns, reference.middle_ms))


def more_steps(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """As many steps as the budget pays for, at the middle exposure: harmonics of a clipped wave fold back less."""
    base = reference.patterns
    times = len(_filled(reference, budget, base, reference.middle_ms).times_ms)
    steps = min(base.steps * times, MOST_STEPS)
    patterns = base.model_copy(update={"steps": steps, "shifts_rad": None})
    return _take(shoot, reference, _filled(reference, budget, patterns, reference.middle_ms))


def adaptive_projection(shoot: Shoot, reference: Reference, budget: Budget) -> Capture:
    """The longest exposure, the projector dimmed for each pixel (in 1/16 of white) so that no sample clips.

    A first look, three steps of the finest period at the shortest exposure, tells how bright each pixel is; it is
    counted. Each camera pixel's light is dimmed as a whole, interreflection from neighbours included and projector
    pixels seen as sharp as the camera's: a real mask also blurs at its edges and dims neighbours by their own level.
    """
    base = reference.patterns
    look = base.model_copy(
        update={"steps": 3, "shifts_rad": None, "periods_px": base.periods_px[:1], "gray": None}
    )
    probe = Shot(look, (min(reference.times_ms),))
    seen = shoot(probe.patterns, probe.times_ms)
    shot = _filled(reference, budget, base, max(reference.times_ms), probe)
    black, top = seen.sensor.black_level_dn, seen.saturation_dn
    steps = seen.frames[0].reshape(-1, 3, *seen.frames.shape[2:]).astype(np.float64)
    turn = np.exp(-2j * np.pi * np.arange(3) / 3.0)
    modulation = np.abs(np.tensordot(turn, steps, axes=(0, 1))) * 2.0 / 3.0
    peak = (steps.mean(axis=1) - black + modulation).max(axis=0)
    there = peak * (max(shot.times_ms) / probe.times_ms[0])
    wanted = HEADROOM * (top - black) / np.maximum(there, 1.0)
    level = np.clip(np.floor(wanted * LEVELS), 1, LEVELS) / LEVELS
    return _take(shoot, reference, Shot(shot.patterns, shot.times_ms, level), probe)


def _two_sets(patterns: PhaseShift, steps: int, shift_rad: float) -> PhaseShift:
    one = 2.0 * np.pi * np.arange(steps) / steps
    shifts = tuple(float(s) for s in np.concatenate([one, one + shift_rad]))
    return patterns.model_copy(update={"steps": 2 * steps, "shifts_rad": shifts})


def _filled(
    reference: Reference,
    budget: Budget,
    patterns: PhaseShift,
    time_ms: float,
    spent: Shot | None = None,
) -> Shot:
    """As many exposures of the patterns as the budget pays for.

    ``equal-time``: the time is shortened until a whole number of exposures uses the budget exactly. ``equal-frames``:
    as many whole sets as fit, at least one.
    """
    n = reference.projectors
    each = len(patterns.frames(n))
    if budget == "equal-time":
        left_ms = reference.shot.light_ms(n) - (spent.light_ms(n) if spent else 0.0)
        count = max(1, ceil(left_ms / (each * time_ms) - 1e-9))
        return Shot(patterns, (left_ms / (each * count),) * count)
    left = reference.shot.frames(n) - (spent.frames(n) if spent else 0)
    return Shot(patterns, (time_ms,) * max(1, left // each))


def _take(shoot: Shoot, reference: Reference, shot: Shot, spent: Shot | None = None) -> Capture:
    n = reference.projectors
    frames, light_ms = shot.frames(n), shot.light_ms(n)
    if spent:
        frames, light_ms = frames + spent.frames(n), light_ms + spent.light_ms(n)
    return Capture(shoot(shot.patterns, shot.times_ms, shot.level), shot, frames, light_ms)


# A single exposure's repeats are averaged, which `phasor-sum` does. The baseline looks away from saturation, as a mask
# made of modulation alone does; so do the plans whose point is that clipping should cancel.
BUILT_IN = (
    Strategy("single", fixed, "phasor-sum", "one fixed exposure: the baseline", "ignore"),
    Strategy("auto-exposure", metered, "phasor-sum", "Ekstrand & Zhang 2011"),
    Strategy("brightest-unsaturated", ladder, "brightest-unsaturated", "Zhang & Yau 2009"),
    Strategy("max-modulation", ladder, "max-modulation", "Jiang et al. 2012"),
    Strategy("radiance-merge", ladder, "radiance-merge", "Debevec & Malik 1997"),
    Strategy("phasor-sum", ladder, "phasor-sum", "sum of phasors"),
    Strategy("inverse-variance", ladder, "inverse-variance", "Granados et al. 2010"),
    Strategy("masked-least-squares", ladder, "masked-least-squares", "Chen, He & Hu 2008"),
    Strategy("censored-ml", ladder, "censored-ml", "Tobin 1958"),
    Strategy("inverted", inverted, "masked-least-squares", "Jiang et al. 2016"),
    Strategy("complementary", complementary, "phasor-sum", "Wan et al. 2023", "ignore"),
    Strategy("more-steps", more_steps, "phasor-sum", "Chen & Zhang 2016", "ignore"),
    Strategy("adaptive-projection", adaptive_projection, "censored-ml", "Li & Kofman 2014"),
)


def strategies(names: Sequence[str] | None = None) -> tuple[Strategy, ...]:
    """The strategies of those names, all by default: the built-in ones, and every foreign fusion rule on the reference's
    exposures. Raises `ScoreError` for an unknown name, or for no name at all.
    """
    known = {strategy.name: strategy for strategy in BUILT_IN}
    for rule in decode.rules():
        known.setdefault(rule, Strategy(rule, ladder, rule, "another distribution's rule"))
    chosen = dict.fromkeys(known if names is None else names)
    if not chosen:
        raise ScoreError(
            f"no strategy is named: leave the choice out for all, or name some of {', '.join(known)}"
        )
    for name in chosen:
        if name not in known:
            raise ScoreError(f"unknown strategy '{name}': {nearest(name, known)}")
    return tuple(known[name] for name in chosen)
