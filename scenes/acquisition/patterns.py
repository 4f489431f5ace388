"""Projected patterns: which frames are shown, and the values each commands."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from scenes.acquisition.codings import ModulatedPhaseShift, UnevenSteps
from scenes.acquisition.frames import (
    WIDEST_PX,
    Axis,
    Frame,
    ShownPatterns,
    flat_frames,
    gray_frames,
    require_each_once,
)
from scenes.acquisition.stereo_light import EvenLight, RandomDots
from scenes.support.frozen import Frozen

__all__ = [
    "WIDEST_PX", "Axis", "Bits", "EvenLight", "Frame", "GrayBits", "GrayCode", "ModulatedPhaseShift", "OnePatterns", "PatternSeries",
    "Patterns", "PhaseShift", "RandomDots", "UnevenSteps", "flat_frames", "gray_frames",
]  # fmt: skip

Bits = Annotated[int, Field(ge=1, le=16)]
Period = Annotated[float, Field(gt=0.0, le=WIDEST_PX)]


class GrayBits(Frozen):
    """A Gray code that numbers the fringes.

    With a cell of half a period, which takes one bit more than the number of fringes (the complementary bit), an error
    of up to a quarter period at a border is harmless (Zhang, Su, Xiang & Sun, Opt. Lasers Eng. 50, 574 (2012)).
    """

    bits: Bits
    cell_px: PositiveFloat | None = None
    """Projector pixels that share a code; absent: half the coarsest period."""
    inverted: bool = True
    """Show each bit's inverse too."""
    flat: bool = False
    """Show white and black at the end: thresholds for bits without inverses."""
    xor: bool = False
    """Exchange dark and bright of every other bit where the last is set, so that all stripes are narrow and indirect light, which
    is smooth, lights a bit and its inverse alike (Gupta, Agrawal, Veeraraghavan & Narasimhan, CVPR 2011)."""

    @model_validator(mode="after")
    def _has_inverses(self) -> Self:
        if self.xor and not self.inverted:
            raise ValueError("xor needs inverted = true: a bit is compared with its inverse")
        return self

    def cell(self, periods_px: tuple[float, ...]) -> float:
        """Width of a cell in projector px, given these periods."""
        return max(periods_px) / 2.0 if self.cell_px is None else self.cell_px


class PhaseShift(ShownPatterns):
    """N-step phase-shifted sinusoids of one or more periods along one or both projector axes.

    Frames are in the order axis, period, step; ``I_k = A + B cos(2 pi u / P + 2 pi k / N)``.

    Examples
    --------
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
    """Phase shift of each step, for unequal steps; absent: 2 pi k / steps."""
    gray: GrayBits | None = None
    """Gray code that gives the fringe order, shown after the fringes of each axis."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        require_each_once(self.periods_px, self.axes)
        if min(self.periods_px) <= 2.0:
            raise ValueError(
                f"period {min(self.periods_px)} px: a fringe needs more than 2 projector pixels"
            )
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
                "cannot distinguish neighbouring fringes: use half of that period, which also tolerates errors at borders"
            )
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; several projectors show theirs one after the other."""
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
                    code = self.gray.bits, cell, self.gray.inverted
                    shown += gray_frames(axis, *code, projector, self.gray.xor)
            if self.gray and self.gray.flat:
                shown += flat_frames(projector)
        return tuple(shown)


class GrayCode(ShownPatterns):
    """Reflected Gray code of the projector pixel, bit by bit, along one or both axes.

    Frames are in the order axis, bit (most significant first), inverse; then white and black if `flat`.

    Examples
    --------
    >>> [f.step for f in GrayCode(bits=(3,), inverted=False, flat=False).frames()]
    [0, 1, 2]
    """

    kind: Literal["gray-code"] = "gray-code"
    axes: Annotated[tuple[Axis, ...], Field(min_length=1, max_length=2)] = ("column",)
    bits: Annotated[tuple[Bits, ...], Field(min_length=1, max_length=2)]
    """Bits of each axis; ``2 ** bits`` cells must span the projector's image."""
    cell_px: PositiveFloat = 1.0
    """Projector pixels per code."""
    inverted: bool = True
    """Show each bit's inverse too: a bit is then the sign of a difference, for any reflectance."""
    flat: bool = True
    """Show white and black at the end: they give each pixel a threshold and show what is lit."""

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        require_each_once((), self.axes)
        if len(self.bits) != len(self.axes):
            raise ValueError(
                f"bits {list(self.bits)} for axes {list(self.axes)}: give one number of bits for each axis"
            )
        return self

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; several projectors show theirs one after the other."""
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


OnePatterns = Annotated[
    PhaseShift | GrayCode | UnevenSteps | ModulatedPhaseShift, Field(discriminator="kind")
]


class PatternSeries(ShownPatterns):
    """Several patterns, one after the other: light that is traced for all of them is enough for each (`render.expose`).

    Examples
    --------
    >>> fringes = PhaseShift(steps=3, periods_px=(16.0,))
    >>> len(PatternSeries(parts=(fringes, GrayCode(bits=(3,)))).frames())
    11
    """

    kind: Literal["series"] = "series"
    parts: Annotated[tuple[OnePatterns, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _is_even(self) -> Self:
        amplitudes = {p.amplitude for p in self.parts if p.kind != "gray-code"}
        if len(amplitudes) > 1:
            raise ValueError(f"the parts have amplitudes {sorted(amplitudes)}: give all the same")
        return self

    @property
    def amplitude(self) -> float:
        """That of every fringe."""
        return next((p.amplitude for p in self.parts if p.kind != "gray-code"), 1.0)

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """Every frame in the order shown; several projectors show theirs one after the other."""
        each = [part.frames(projectors) for part in self.parts]
        return tuple(
            f for p in range(projectors) for part in each for f in part if f.projector == p
        )


Patterns = Annotated[
    PhaseShift
    | GrayCode
    | UnevenSteps
    | ModulatedPhaseShift
    | PatternSeries
    | RandomDots
    | EvenLight,
    Field(discriminator="kind"),
]
