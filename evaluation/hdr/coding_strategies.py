"""Codings compared like for like: each at the scene's exposures, repeated until the budget is used, and fused by one rule."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import ceil, log2

from decode.fusion.merging import MaxModulationOfRepeats
from evaluation.hdr.capture_strategies import PlannedCapture, Strategy, take
from evaluation.hdr.light_budget import LightBudget, Reference, Shoot, Shot
from scenes.acquisition.patterns import (
    GrayBits,
    ModulatedPhaseShift,
    OnePatterns,
    PhaseShift,
    UnevenSteps,
)

# Periods over the finest one's nominal 16 px: heterodyne, and micro phase shifting of five frequencies.
HETERODYNE = (14.5, 15.2, 16.0)
MICRO = (14.57, 16.09, 16.24, 16.47, 16.6)
NOMINAL_PX = 16.0


@dataclass(frozen=True)
class Coding:
    """A plan: other patterns of about the reference's finest period, at the reference's exposures."""

    name: str
    make: Callable[[PhaseShift, float], OnePatterns]
    """Patterns from the reference's, and the number of projector pixels that need different codes."""

    @property
    def __name__(self) -> str:
        """The coding's name, as a function has one."""
        return self.name

    def patterns(self, reference: Reference) -> OnePatterns:
        """What is shown."""
        assert isinstance(reference.patterns, PhaseShift)
        return self.make(reference.patterns, reference.field_px)

    def __call__(self, shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
        """Take the pictures."""
        shot = Shot(self.patterns(reference), reference.times_ms)
        return take(shoot, reference, reference.filled(budget, shot))


def _n_step(base: PhaseShift, field_px: float) -> OnePatterns:
    return base


def _heterodyne(base: PhaseShift, field_px: float) -> OnePatterns:
    return base.model_copy(update={"periods_px": _scaled(base, HETERODYNE), "gray": None})


def _scaled(base: PhaseShift, relative: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(r * min(base.periods_px) / NOMINAL_PX for r in relative)


def _with_code(base: PhaseShift, field_px: float, cells: int, xor: bool) -> OnePatterns:
    """The finest fringes, and a code of so many cells a fringe."""
    fine = min(base.periods_px)
    code = GrayBits(bits=ceil(log2(field_px * cells / fine)), cell_px=fine / cells, xor=xor)
    return base.model_copy(update={"periods_px": (fine,), "gray": code})


def _micro(base: PhaseShift, field_px: float) -> OnePatterns:
    return _uneven(base, _scaled(base, MICRO), (3,) + (1,) * (len(MICRO) - 1))


def _embedded(base: PhaseShift, field_px: float) -> OnePatterns:
    fine = min(base.periods_px)
    # The beats with the finest fringe are as wide as the field, and its geometric mean with the fringe.
    beats = (field_px, (field_px * fine) ** 0.5)
    return _uneven(base, (fine, *(1.0 / (1.0 / fine - 1.0 / beat) for beat in beats)), (3, 2, 2))


def _uneven(base: PhaseShift, periods: tuple[float, ...], steps: tuple[int, ...]) -> OnePatterns:
    return UnevenSteps(periods_px=periods, steps=steps, axes=base.axes, amplitude=base.amplitude)


def _modulated(base: PhaseShift, field_px: float) -> OnePatterns:
    fine = min(base.periods_px)
    return ModulatedPhaseShift(
        periods_px=((field_px * fine) ** 0.5, field_px),
        carrier_px=fine,
        axes=base.axes,
        amplitude=base.amplitude,
    )


CODINGS = tuple(
    Strategy(name, Coding(name, make), MaxModulationOfRepeats(), source)
    for name, make, source in (
        ("n-step", _n_step, "the scene's own patterns: what codings are compared with"),
        ("heterodyne", _heterodyne, "Reich, Ritter & Thesing 1997"),
        ("gray-code", partial(_with_code, cells=2, xor=False), "Sansoni, Carocci & Rodella 1999"),
        # The last bit's stripes have four cells a period: as fine as the fringes.
        ("xor-gray-code", partial(_with_code, cells=4, xor=True), "Gupta et al. 2011"),
        ("micro-phase-shift", _micro, "Gupta & Nayar 2012"),
        ("modulated-phase-shift", _modulated, "Chen, Seidel & Lensch 2008"),
        ("embedded-phase-shift", _embedded, "Moreno, Son & Taubin 2015"),
    )
)
