"""What pictures cost, and how many of them a budget allows.

The reference is the scene's own acquisition: every exposure of every frame. A budget is a share of the reference's total
exposure time (``equal-time``), of its number of frames (``equal-frames``), or of the time the machine takes for it
(``cycle-time``): exposures, and the overhead of each frame for readout and pattern switching.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Literal

import numpy as np
from numpy.typing import NDArray

import decode
from scenes.acquisition.patterns import Patterns
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError, nearest

LightBudget = Literal["equal-time", "equal-frames", "cycle-time"]
BUDGETS: tuple[LightBudget, ...] = ("equal-time", "equal-frames", "cycle-time")
# Relative rounding of sums of times.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Shot:
    """Pictures to be taken: everything that their information depends on."""

    patterns: Patterns
    times_ms: tuple[float, ...]
    levels: tuple[float, ...] = ()
    """The projectors' white in each exposure, in (0, 1]; empty: 1."""
    masks: tuple[NDArray[np.float64], ...] = ()
    """Of each projector, levels (row, col) of its pixels, in (0, 1], by which all patterns are multiplied; empty: 1."""
    projectors: int | None = None
    """How many of the projectors show the patterns, the first ones; None: all."""

    def frames(self, projectors: int) -> int:
        """Number of pictures, in a machine of so many projectors."""
        return len(self.times_ms) * self._shown(projectors)

    def light_ms(self, projectors: int) -> float:
        """Sum of all pictures' exposure times."""
        return sum(self.times_ms) * self._shown(projectors)

    def _shown(self, projectors: int) -> int:
        return len(self.patterns.frames(self.projectors or projectors))


Shoot = Callable[[Shot], Stack]
"""Takes every exposure of every frame."""


@dataclass(frozen=True)
class Reference:
    """The acquisition whose cost is the budget of all others, and the machine that takes it."""

    patterns: Patterns
    times_ms: tuple[float, ...]
    projectors: int = 1
    overhead_ms: float = 0.0
    """Time of a frame besides its exposure."""
    min_exposure_ms: float = 0.0
    """Shortest exposure of the camera."""
    field_px: float = 1024.0
    """Projector pixels along the axis of the patterns, which codes must distinguish."""
    share: float = 1.0
    """Share of the reference's cost that a plan may use."""

    @property
    def shot(self) -> Shot:
        """The reference itself."""
        return Shot(self.patterns, self.times_ms)

    @property
    def middle_ms(self) -> float:
        """The middle exposure, by time."""
        return self.times_ms[decode.middle_exposure(self.times_ms)]

    def cycle_ms(self, *shots: Shot) -> float:
        """Time that the machine takes for some shots, one after the other."""
        n = self.projectors
        return sum(s.light_ms(n) + self.overhead_ms * s.frames(n) for s in shots)

    def cost(self, budget: LightBudget, *shots: Shot) -> float:
        """What shots cost under a budget: milliseconds or frames."""
        if budget == "cycle-time":
            return self.cycle_ms(*shots)
        n = self.projectors
        return sum(s.frames(n) if budget == "equal-frames" else s.light_ms(n) for s in shots)

    def filled(self, budget: LightBudget, shot: Shot, *spent: Shot) -> Shot:
        """The shot repeated as often as a budget allows, besides the shots `spent`; `ScoreError` if not even one repeat
        fits.

        ``equal-frames``: as many whole repeats as fit. Others: exposures are shortened, all by one factor, until a
        whole number of repeats uses the budget exactly, as far as the shortest exposure allows; they are never
        lengthened.
        """
        left = self.share * self.cost(budget, self.shot) - self.cost(budget, *spent)
        frames, light_ms = shot.frames(self.projectors), shot.light_ms(self.projectors)
        scale, slack = 1.0, 1.0 + ROUNDING
        if budget == "equal-frames":
            count = int(left * slack // frames)
        else:
            fixed_ms = self.overhead_ms * frames if budget == "cycle-time" else 0.0
            # A shortest exposure of 0 still leaves each picture some light.
            minimum_ms = max(self.min_exposure_ms, 1e-6 * min(shot.times_ms))
            count = max(0, ceil(left / (light_ms + fixed_ms) - ROUNDING))
            while count:
                scale = min((left / count - fixed_ms) / light_ms, 1.0)
                if scale * min(shot.times_ms) * slack >= minimum_ms:
                    break
                count -= 1
        if not count or min(shot.times_ms) * scale * slack < self.min_exposure_ms:
            unit = "frames" if budget == "equal-frames" else "ms"
            raise ScoreError(
                f"{frames} frames of at least {self.min_exposure_ms:g} ms exposure do not fit: {budget} leaves {left:.4g} "
                f"{unit}, and a frame takes {self.overhead_ms:g} ms besides its exposure"
            )
        return replace(shot, times_ms=tuple(t * scale for t in shot.times_ms) * count)


def known_budgets(names: Sequence[str]) -> tuple[LightBudget, ...]:
    """Budgets by name, each once; raises `ScoreError` for an unknown name or none at all."""
    for name in names:
        if name not in BUDGETS:
            raise ScoreError(f"unknown budget '{name}': {nearest(name, BUDGETS)}")
    if not names:
        raise ScoreError(f"no budget is named: use some of {', '.join(BUDGETS)}")
    return tuple(budget for budget in BUDGETS if budget in names)
