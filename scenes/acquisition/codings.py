"""Patterns against indirect light: every frame is of high frequency, so that light which bounced or scattered, smooth as it is,
adds to the offset alone.
"""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from scenes.acquisition.frames import WIDEST_PX, Axis, Frame, ShownPatterns, require_each_once

Period = Annotated[float, Field(gt=2.0, le=WIDEST_PX)]


class FringeCoding(ShownPatterns):
    """What all codings have."""

    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=2)] = ("column",)
    amplitude: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Commanded fringe amplitude as a fraction of the full range around mid-grey."""


class UnevenSteps(FringeCoding):
    """Fringes of several close periods with a number of steps of their own, which share their offset.

    Steps of 3, 1, 1, ...: micro phase shifting (Gupta & Nayar, CVPR 2012), for which all periods also share their amplitude. Steps
    of 3, 2, 2, ...: embedded phase shifting (Moreno, Son & Taubin, CVPR 2015). One step has shift 0, two have 0 and pi / 2.

    Examples
    --------
    >>> len(UnevenSteps(periods_px=(14.57, 16.09, 16.24), steps=(3, 1, 1)).frames())
    5
    """

    kind: Literal["uneven-steps"] = "uneven-steps"
    periods_px: Annotated[tuple[Period, ...], Field(min_length=2, max_length=16)]
    """Fringe periods in projector pixels, finest first."""
    steps: Annotated[tuple[Annotated[int, Field(ge=1, le=64)], ...], Field(min_length=2)]
    """Number of steps of each period; 3 or more of the first."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        require_each_once(self.periods_px, self.axes)
        if len(self.steps) != len(self.periods_px) or self.steps[0] < 3:
            raise ValueError(
                f"steps {list(self.steps)} for {len(self.periods_px)} periods: give one number for each, 3 or more first"
            )
        if 1 in self.steps and len(self.steps) < 3:
            raise ValueError("periods of one step: use at least two of them")
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order axis, period, step; several projectors show theirs one after the other."""
        return tuple(
            Frame(axis, period, k, steps, 2.0 * np.pi * k / (4 if steps == 2 else steps), projector)
            for projector in range(projectors)
            for axis in self.axes
            for period, steps in zip(self.periods_px, self.steps, strict=True)
            for k in range(steps)
        )


class ModulatedPhaseShift(FringeCoding):
    """Coarse fringes times a fine carrier that is shifted too (Chen, Seidel & Lensch, CVPR 2008).

    The carrier measures; its amplitude carries the coarse fringes, which number it. It runs along the same axis.

    Examples
    --------
    >>> len(ModulatedPhaseShift(periods_px=(128.0, 1024.0)).frames())
    18
    """

    kind: Literal["modulated-phase-shift"] = "modulated-phase-shift"
    periods_px: Annotated[tuple[Period, ...], Field(min_length=1, max_length=8)]
    """Periods of the coarse fringes in projector pixels, finest first."""
    carrier_px: Period = 16.0
    """Period of the carrier, less than a third of every other."""
    steps: Annotated[int, Field(ge=3, le=64)] = 3
    """Shifts of each fringe, each shown with all shifts of the carrier."""
    carrier_steps: Annotated[int, Field(ge=3, le=64)] = 3

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        require_each_once(self.periods_px, self.axes)
        if 3.0 * self.carrier_px > self.periods_px[0]:
            raise ValueError(
                f"carrier_px {self.carrier_px} is not below a third of period {self.periods_px[0]}: use a finer carrier"
            )
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order axis, period, step, carrier step; projectors one after the other."""
        return tuple(
            Frame(
                axis,
                period,
                k,
                self.steps,
                2.0 * np.pi * k / self.steps,
                projector,
                "modulated",
                carrier_px=self.carrier_px,
                carrier_shift_rad=2.0 * np.pi * m / self.carrier_steps,
            )
            for projector in range(projectors)
            for axis in self.axes
            for period in self.periods_px
            for k in range(self.steps)
            for m in range(self.carrier_steps)
        )
