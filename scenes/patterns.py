"""Projected patterns: which frames are shown, and what each commands of the projector."""

from dataclasses import dataclass
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, model_validator

from scenes.errors import ImpossibleError
from scenes.frozen import Frozen

Axis = Literal["column", "row"]
FrameKind = Literal["fringe", "gray", "white", "black"]
# A phase in float32 needs no more; no projector is a thousandth as wide.
WIDEST_PX = 1e8


@dataclass(frozen=True)
class Frame:
    """One projected frame along `axis`, from projector `projector`; u is the projector's continuous coordinate.

    A ``fringe`` is step `step` of `steps`: ``I = A + B cos(2 pi u / period_px + phase_shift_rad)``. A ``gray`` frame is
    bit `step`, 0 the most significant, of the `steps`-bit reflected Gray code of ``floor(u / period_px)``, dark and
    bright exchanged where `inverted`. ``white`` and ``black`` are uniform and serve both axes.
    """

    axis: Axis
    period_px: float
    step: int
    steps: int
    phase_shift_rad: float
    projector: int = 0
    kind: FrameKind = "fringe"
    inverted: bool = False

    def __post_init__(self) -> None:
        """Raises `ImpossibleError` for numbers that no frame has."""
        uniform = self.kind in ("white", "black")
        if not (uniform or 0.0 < self.period_px <= WIDEST_PX):
            raise ImpossibleError(
                f"a {self.kind} frame's period_px is {self.period_px}: use more than 0, at most {WIDEST_PX:g} px"
            )
        if not np.isfinite(self.phase_shift_rad):
            raise ImpossibleError(
                f"phase_shift_rad is {self.phase_shift_rad}: give a finite number"
            )
        if not 0 <= self.step < self.steps or self.projector < 0:
            raise ImpossibleError(
                f"a frame is step {self.step} of {self.steps}, of projector {self.projector}: count steps and "
                "projectors from 0, steps to one less than their number"
            )

    def commanded(
        self, coordinate_px: NDArray[np.float64], amplitude: float = 1.0
    ) -> NDArray[np.float64]:
        """Commanded value in [0, 1] at continuous coordinates along `axis`; a fringe has that amplitude about mid-grey."""
        if self.kind == "fringe":
            phase = 2.0 * np.pi * coordinate_px / self.period_px + self.phase_shift_rad
            return 0.5 + 0.5 * amplitude * np.cos(phase)
        if self.kind == "gray":
            code = np.floor(coordinate_px / self.period_px).astype(np.int64)
            bit = ((code ^ (code >> 1)) >> (self.steps - 1 - self.step)) & 1
            return (1 - bit if self.inverted else bit).astype(np.float64)
        return np.full(np.shape(coordinate_px), float(self.kind == "white"))


def gray_frames(
    axis: Axis, bits: int, cell_px: float, inverted: bool, projector: int = 0
) -> list[Frame]:
    """Gray code of one axis, most significant bit first, each followed by its inverse if asked for."""
    return [
        Frame(axis, cell_px, bit, bits, 0.0, projector, "gray", flip)
        for bit in range(bits)
        for flip in ((False, True) if inverted else (False,))
    ]


def flat_frames(projector: int = 0) -> list[Frame]:
    """A white frame, then a black one."""
    return [Frame("column", 0.0, 0, 1, 0.0, projector, kind) for kind in ("white", "black")]


Bits = Annotated[int, Field(ge=1, le=16)]
Period = Annotated[float, Field(gt=0.0, le=WIDEST_PX)]


class GrayBits(Frozen):
    """A Gray code that numbers the fringes.

    With a cell of half a period, one bit more than there are fringes (the complementary bit), an error of up to a
    quarter period at a border does no harm (Zhang, Su, Xiang & Sun, Opt. Lasers Eng. 50, 574 (2012)).
    """

    bits: Bits
    cell_px: PositiveFloat | None = None
    """Projector pixels that share a code; absent: half the coarsest period."""
    inverted: bool = True
    """Show each bit's inverse too."""
    flat: bool = False
    """Show white and black at the end: thresholds where there are no inverses."""

    def cell(self, periods_px: tuple[float, ...]) -> float:
        """Width of a cell in projector px for these periods."""
        return max(periods_px) / 2.0 if self.cell_px is None else self.cell_px


class PhaseShift(Frozen):
    """N-step phase-shifted sinusoids of one or more periods along one or both projector axes.

    Frames come in the order axis, period, step; ``I_k = A + B cos(2 pi u / P + 2 pi k / N)``.

    >>> [f.step for f in PhaseShift(steps=3, periods_px=(16.0,)).frames()]
    [0, 1, 2]
    """

    kind: Literal["phase-shift"] = "phase-shift"
    steps: Annotated[int, Field(ge=3, le=64)] = 4
    periods_px: Annotated[tuple[Period, ...], Field(min_length=1)]
    """Fringe periods in projector pixels, finest first; the finest measures, the others give the fringe order."""
    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=2)] = ("column",)
    amplitude: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    """Commanded fringe amplitude as a fraction of the full range around mid-grey."""
    shifts_rad: tuple[float, ...] | None = None
    """Phase shift of each step where the steps are unequal; absent: 2 pi k / steps."""
    gray: GrayBits | None = None
    """Gray code that tells the fringe order, shown after the fringes of each axis."""

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
        if self.shifts_rad is not None:
            if len(self.shifts_rad) != self.steps:
                raise ValueError(
                    f"shifts_rad has {len(self.shifts_rad)} values for {self.steps} steps: give one for each"
                )
            if len({round(shift % (2.0 * np.pi), 6) for shift in self.shifts_rad}) < 3:
                raise ValueError(
                    f"shifts_rad {list(self.shifts_rad)}: a phase needs at least three different shifts"
                )
        if self.gray and self.gray.cell(self.periods_px) > max(self.periods_px):
            raise ValueError(
                f"gray.cell_px {self.gray.cell_px} is wider than the coarsest period {max(self.periods_px)} px, so it "
                "cannot tell one fringe from the next: use half of that period, which also forgives errors at borders"
            )
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; with several projectors, one after the other."""
        shifts = self.shifts_rad or tuple(2.0 * np.pi * k / self.steps for k in range(self.steps))
        shown: list[Frame] = []
        for projector in range(projectors):
            for axis in self.axes:
                shown += [
                    Frame(axis, period, k, self.steps, shift, projector)
                    for period in self.periods_px
                    for k, shift in enumerate(shifts)
                ]
                if self.gray:
                    cell = self.gray.cell(self.periods_px)
                    shown += gray_frames(axis, self.gray.bits, cell, self.gray.inverted, projector)
            if self.gray and self.gray.flat:
                shown += flat_frames(projector)
        return tuple(shown)

    def commanded(self, frame: Frame, coordinate_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commanded value in [0, 1] at continuous projector coordinates along the frame's axis."""
        return frame.commanded(coordinate_px, self.amplitude)


class GrayCode(Frozen):
    """Reflected Gray code along one or both projector axes: bit by bit, the projector pixel itself.

    Frames come in the order axis, bit (most significant first), inverse; then white and black if `flat`.

    >>> [f.step for f in GrayCode(bits=(3,), inverted=False, flat=False).frames()]
    [0, 1, 2]
    """

    kind: Literal["gray-code"] = "gray-code"
    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=2)] = ("column",)
    bits: Annotated[tuple[Bits, ...], Field(min_length=1, max_length=2)]
    """Bits of each axis; ``2 ** bits`` cells must span the projector's image."""
    cell_px: PositiveFloat = 1.0
    """Projector pixels that share a code."""
    inverted: bool = True
    """Show each bit's inverse too: a bit is then the sign of a difference, whatever the surface's reflectance."""
    flat: bool = True
    """Show white and black at the end: a threshold for each pixel, and what is lit at all."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes {list(self.axes)}: name each axis once")
        if len(self.bits) != len(self.axes):
            raise ValueError(
                f"bits {list(self.bits)} for axes {list(self.axes)}: give one number of bits for each axis"
            )
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; with several projectors, one after the other."""
        shown: list[Frame] = []
        for projector in range(projectors):
            for axis, bits in zip(self.axes, self.bits, strict=True):
                shown += gray_frames(axis, bits, self.cell_px, self.inverted, projector)
            shown += flat_frames(projector) if self.flat else []
        return tuple(shown)

    @property
    def amplitude(self) -> float:
        """Gray code goes from black to white."""
        return 1.0

    def commanded(self, frame: Frame, coordinate_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Commanded value in [0, 1] at continuous projector coordinates along the frame's axis."""
        return frame.commanded(coordinate_px)


Patterns = Annotated[PhaseShift | GrayCode, Field(discriminator="kind")]
