"""Projected patterns: which frames are shown, and what each commands of the projector."""

from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from scenes.frozen import Frozen

Axis = Literal["column", "row"]


@dataclass(frozen=True)
class Frame:
    """One projected frame: step `step` of `steps` of a fringe along `axis`, from projector `projector`.

    Its fringe is ``I = A + B cos(2 pi u / period_px + phase_shift_rad)`` with u the projector's continuous coordinate.
    """

    axis: Axis
    period_px: float
    step: int
    steps: int
    phase_shift_rad: float
    projector: int = 0


class PhaseShift(Frozen):
    """N-step phase-shifted sinusoids of one or more periods along one or both projector axes.

    Frames come in the order axis, period, step; ``I_k = A + B cos(2 pi u / P + 2 pi k / N)``.

    >>> [f.step for f in PhaseShift(steps=3, periods_px=(16.0,)).frames()]
    [0, 1, 2]
    """

    kind: Literal["phase-shift"] = "phase-shift"
    steps: Annotated[int, Field(ge=3, le=64)] = 4
    periods_px: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    """Fringe periods in projector pixels, finest first; the finest measures, the others give the fringe order."""
    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=2)] = ("column",)
    amplitude: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Commanded fringe amplitude as a fraction of the full range around mid-grey."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if list(self.periods_px) != sorted(set(self.periods_px)):
            raise ValueError(
                f"periods_px {list(self.periods_px)}: list each once, finest first, e.g. "
                f"{sorted(set(self.periods_px))}"
            )
        if min(self.periods_px) <= 2.0:
            raise ValueError(
                f"period {min(self.periods_px)} px: a fringe needs more than 2 projector pixels"
            )
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes {list(self.axes)}: name each axis once")
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; with several projectors, one after the other."""
        return tuple(
            Frame(axis, period, k, self.steps, 2.0 * np.pi * k / self.steps, projector)
            for projector in range(projectors)
            for axis in self.axes
            for period in self.periods_px
            for k in range(self.steps)
        )

    def commanded(self, frame: Frame, coordinate_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commanded value in [0, 1] at continuous projector coordinates along the frame's axis."""
        phase = 2.0 * np.pi * coordinate_px / frame.period_px + frame.phase_shift_rad
        return 0.5 + 0.5 * self.amplitude * np.cos(phase)


Patterns = PhaseShift
