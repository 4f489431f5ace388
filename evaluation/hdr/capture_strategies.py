"""Strategies for high dynamic range: an acquisition plan and a fusion rule, at a given budget.

A plan takes its pictures through a function passed to it, so it works with a renderer and with a camera. Plans that need
less than the budget repeat their pictures until it is used, and the repeats are decoded together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

import decode
from decode import FusionRule, Reconstruction
from decode.fusion.choosing import AutoExposureRule
from decode.fusion.merging import MeanOfSets
from evaluation.hdr.light_budget import LightBudget, Reference, Shoot, Shot
from scenes.acquisition.patterns import Patterns, PhaseShift
from scenes.files.stack import Stack

MOST_STEPS = 64


@dataclass(frozen=True, eq=False)
class PlannedCapture:
    """Pictures taken under a plan."""

    stack: Stack
    """Frames (exposure, frame, row, col), DN."""
    shot: Shot
    """How the stack was taken."""
    frames: int
    """Number of pictures, including a plan's own test pictures."""
    exposure_ms: float
    """Total exposure time of all pictures."""
    cycle_ms: float
    """Time that the machine takes for all pictures."""


CapturePlan = Callable[[Shoot, Reference, LightBudget], PlannedCapture]


@dataclass(frozen=True)
class Strategy:
    """An acquisition plan, and a fusion rule or a whole decoder."""

    name: str
    plan: CapturePlan
    """Takes the pictures that the light budget allows."""
    fusion: str | FusionRule
    source: str
    """The paper."""
    saturation: Literal["reject", "ignore"] = "reject"
    decoder: Callable[[Stack], Reconstruction] | None = None
    """Decodes in place of `decode.reconstruct`."""

    @property
    def decoded_by(self) -> str:
        """Name of the fusion rule or decoder."""
        if self.decoder is not None:
            return self.name
        return self.fusion if isinstance(self.fusion, str) else type(self.fusion).__name__

    def reconstruct(self, stack: Stack) -> Reconstruction:
        """Decode pictures of the plan.

        Parameters
        ----------
        stack
            Frames (exposure, frame, row, col) in DN.

        Returns
        -------
        reconstruction
            Heights and their standard deviations in mm, per pixel (row, col).
        """
        if self.decoder is not None:
            return self.decoder(stack)
        return decode.reconstruct(stack, fusion=self.fusion, saturation=self.saturation)


def ladder(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The reference's own exposures, which use every budget exactly."""
    return take(shoot, reference, reference.filled(budget, reference.shot))


def fixed(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The middle exposure alone, repeated."""
    return _at_middle(shoot, reference, budget, reference.patterns)


def metered(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The reference exposure that the histogram selects, repeated. Metering is not counted: it is done once for many
    pictures.
    """
    seen = shoot(reference.shot)
    chosen = AutoExposureRule().prepare(seen).exposure
    assert chosen is not None
    shot = Shot(reference.patterns, (reference.times_ms[chosen],))
    return take(shoot, reference, reference.filled(budget, shot))


def inverted(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """Three steps and the same three inverted (shifted by pi), at the middle exposure: where one is clipped, its inverse is
    not. An even number of steps would only repeat its patterns.
    """
    return _at_middle(shoot, reference, budget, _two_sets(_fringes(reference), 3, np.pi))


def complementary(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The N steps and a second set shifted by pi / N, at the middle exposure: the ripple of the clipped wave has N-fold
    symmetry and the opposite sign in the second set.
    """
    patterns = _fringes(reference)
    steps = patterns.steps
    each = int(len(reference.times_ms) * steps * reference.share)
    if budget == "equal-frames" and each % (2 * steps):
        # Two sets of more steps use the frames that whole repeats leave over.
        steps = max(3, each // 2)
    return _at_middle(shoot, reference, budget, _two_sets(patterns, steps, np.pi / steps))


def more_steps(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """As many steps as the budget allows, at the middle exposure: fewer harmonics of a clipped wave alias."""
    base = _fringes(reference)
    shot = reference.filled(budget, Shot(base, (reference.middle_ms,)))
    steps = min(base.steps * len(shot.times_ms), MOST_STEPS)
    patterns = base.model_copy(update={"steps": steps, "shifts_rad": None})
    return _at_middle(shoot, reference, budget, patterns)


def _two_sets(patterns: PhaseShift, steps: int, shift_rad: float) -> PhaseShift:
    one = 2.0 * np.pi * np.arange(steps) / steps
    shifts = tuple(float(s) for s in np.concatenate([one, one + shift_rad]))
    return patterns.model_copy(update={"steps": 2 * steps, "shifts_rad": shifts})


def _fringes(reference: Reference) -> PhaseShift:
    assert isinstance(reference.patterns, PhaseShift)
    return reference.patterns


def _at_middle(
    shoot: Shoot, reference: Reference, budget: LightBudget, patterns: Patterns
) -> PlannedCapture:
    """Patterns at the middle exposure, repeated."""
    shot = Shot(patterns, (reference.middle_ms,))
    return take(shoot, reference, reference.filled(budget, shot))


def take(shoot: Shoot, reference: Reference, shot: Shot, *spent: Shot) -> PlannedCapture:
    """Pictures of a shot, and what they and those before them cost."""
    n, shots = reference.projectors, (shot, *spent)
    return PlannedCapture(
        shoot(shot),
        shot,
        sum(s.frames(n) for s in shots),
        sum(s.light_ms(n) for s in shots),
        reference.cycle_ms(*shots),
    )


# The repeats of a single exposure are averaged, which `phasor-sum` does. The baseline ignores saturation, as a mask of
# modulation alone does; so do the plans that rely on clipping errors cancelling.
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
    Strategy("complementary", complementary, MeanOfSets(), "Wan et al. 2023", "ignore"),
    Strategy("2n-step", complementary, "phasor-sum", "2N steps decoded as one set", "ignore"),
    Strategy("more-steps", more_steps, "phasor-sum", "Chen & Zhang 2016", "ignore"),
    Strategy("unsaturated-steps", more_steps, "masked-least-squares", "Chen, He & Hu 2008"),
)
