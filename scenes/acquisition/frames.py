"""One projected frame: the values it commands, and the sinusoids it is made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from scenes.support.errors import ImpossibleError
from scenes.support.frozen import Frozen

Axis = Literal["column", "row"]
FrameKind = Literal["fringe", "modulated", "line", "gray", "xor", "white", "grey", "black", "dots"]
UNIFORM: dict[str, float] = {"white": 1.0, "grey": 0.5, "black": 0.0}
"""Frames without stripes, and what they command."""
Wave = tuple[float, float, float]
"""Period in px, amplitude, and phase at u = 0 in rad of one sinusoid."""
# Beyond the reach of a phase in float32; real projectors are less than a thousandth as wide.
WIDEST_PX = 1e8


@dataclass(frozen=True)
class Frame:
    """One projected frame along `axis`, from projector `projector`; u is the projector's continuous coordinate.

    A ``fringe`` is step `step` of `steps`: ``I = A + B cos(2 pi u / period_px + phase_shift_rad)``. A ``gray`` frame is
    bit `step`, 0 the most significant, of the `steps`-bit reflected Gray code (plain binary if `plain`) of
    ``floor(u / period_px + phase_shift_rad / (2 pi))``, dark and bright exchanged where `inverted`.
    An ``xor`` frame is that bit, dark and bright exchanged where the least significant bit is set. A ``modulated`` frame is a fringe
    times a carrier ``0.5 + 0.5 cos(2 pi u / carrier_px + carrier_shift_rad)``. A ``line`` frame has lines as wide as one of its
    `steps` where a fringe is brightest. ``white``, ``grey`` (the fringes' mean) and ``black`` are uniform, for both axes.
    ``dots`` are random squares of `period_px`, no function of `axis` alone. `camera` 1 is the second camera of a pair.
    """

    axis: Axis
    period_px: float
    step: int
    steps: int
    phase_shift_rad: float
    projector: int = 0
    kind: FrameKind = "fringe"
    inverted: bool = False
    plain: bool = False
    carrier_px: float = 0.0
    carrier_shift_rad: float = 0.0
    camera: int = 0

    def __post_init__(self) -> None:
        """Raises `ImpossibleError` for numbers that no frame can have."""
        uniform = self.kind in UNIFORM
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
        """Commanded values of the frame.

        Parameters
        ----------
        coordinate_px
            Continuous projector coordinates (...) along `axis`, px.
        amplitude
            Amplitude of a fringe relative to full modulation, 0 to 1.

        Returns
        -------
        ndarray of float64, (...)
            Values in [0, 1].
        """
        if self.kind == "fringe":
            phase = 2.0 * np.pi * coordinate_px / self.period_px + self.phase_shift_rad
            return 0.5 + 0.5 * amplitude * np.cos(phase)
        if self.kind == "modulated":
            mean, waves = self.waves(amplitude)
            terms = [a * np.cos(2.0 * np.pi * coordinate_px / p + d) for p, a, d in waves]
            return np.asarray(mean + np.sum(terms, axis=0))
        if self.kind == "line":
            turns = coordinate_px / self.period_px + self.phase_shift_rad / (2.0 * np.pi)
            return (np.abs(turns - np.round(turns)) < 0.5 / self.steps).astype(np.float64)
        if self.kind in ("gray", "xor"):
            cell = coordinate_px / self.period_px + self.phase_shift_rad / (2.0 * np.pi)
            code = np.floor(cell).astype(np.int64)
            bits = code if self.plain else code ^ (code >> 1)
            bit = (bits >> (self.steps - 1 - self.step)) & 1
            if self.kind == "xor":
                bit ^= bits & 1
            return (1 - bit if self.inverted else bit).astype(np.float64)
        if self.kind == "dots":
            raise ImpossibleError(
                "random dots are no function of one axis: read them as camera frames"
            )
        return np.full(np.shape(coordinate_px), UNIFORM[self.kind])

    def waves(self, amplitude: float = 1.0) -> tuple[float, list[Wave]]:
        """Mean and sinusoids that sum up to a ``fringe``, ``modulated`` or uniform frame.

        Parameters
        ----------
        amplitude
            Amplitude of a fringe relative to full modulation, 0 to 1.

        Returns
        -------
        tuple of float and list
            Mean, and (period in px, amplitude, phase in rad) of each sinusoid; at the left edge, u = 0.
        """
        own = self.period_px, 0.5 * amplitude, self.phase_shift_rad
        if self.kind == "fringe":
            return 0.5, [own]
        if self.kind == "modulated":
            carrier = self.carrier_px, self.carrier_shift_rad
            sum_px = 1.0 / (1.0 / carrier[0] + 1.0 / own[0])
            difference_px = 1.0 / (1.0 / carrier[0] - 1.0 / own[0])
            return 0.25, [
                (own[0], own[1] / 2.0, own[2]),
                (carrier[0], 0.25, carrier[1]),
                (sum_px, own[1] / 4.0, carrier[1] + own[2]),
                (difference_px, own[1] / 4.0, carrier[1] - own[2]),
            ]
        return UNIFORM[self.kind], []


class HasAmplitude(Protocol):
    """Patterns whose fringes have one amplitude."""

    @property
    def amplitude(self) -> float:
        """Of a fringe, as a fraction of the full range around mid-grey."""


class ShownPatterns(Frozen):
    """What all kinds of patterns have."""

    def commanded(
        self: HasAmplitude, frame: Frame, coordinate_px: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Commanded values of a frame.

        Parameters
        ----------
        frame
            One of the frames of these patterns.
        coordinate_px
            Continuous projector coordinates (...) along the axis of the frame, px.

        Returns
        -------
        ndarray of float64, (...)
            Values in [0, 1].
        """
        return frame.commanded(coordinate_px, self.amplitude)


def require_each_once(periods_px: Sequence[float], axes: Sequence[Axis]) -> None:
    """Raise `ValueError` for periods that are not each listed once, finest first, and for an axis named twice."""
    if list(periods_px) != sorted(set(periods_px)):
        raise ValueError(
            f"periods_px {list(periods_px)}: list each once, finest first, e.g. {sorted(set(periods_px))}"
        )
    if len(set(axes)) != len(axes):
        raise ValueError(f"axes {list(axes)}: name each axis once")


def gray_frames(
    axis: Axis, bits: int, cell_px: float, inverted: bool, projector: int = 0, xor: bool = False
) -> list[Frame]:
    """Gray code of one axis, most significant bit first, each bit followed by its inverse if `inverted`.

    With `xor`, all bits but the last are exchanged where the last is set.
    """
    return [
        Frame(
            axis,
            cell_px,
            bit,
            bits,
            0.0,
            projector,
            "xor" if xor and bit < bits - 1 else "gray",
            flip,
        )
        for bit in range(bits)
        for flip in ((False, True) if inverted else (False,))
    ]


def flat_frames(projector: int = 0) -> list[Frame]:
    """A white frame, then a black one."""
    return [Frame("column", 0.0, 0, 1, 0.0, projector, kind) for kind in ("white", "black")]
