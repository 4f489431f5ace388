"""Exposure fusion: one phase per pixel out of several exposures of the same fringes.

A rule sees all samples of one fringe set of one pixel, inside the kernel, and returns one `Phasor`. `decode.registry`
finds rules by name.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from decode.device import Device, Lanes
from decode.phase import FringeSet, Phasor, across_dn2, solution, variance_rad2, weighted_sum
from scenes.errors import DecodeError
from scenes.stack import Stack

# `Phasor.exposure` where more than one exposure made the phase.
MERGED = 255


def middle_exposure(exposure_ms: Sequence[float]) -> int:
    """Index of the middle exposure by time, of an even number the longer one: what one takes who takes only one."""
    return _by_time(exposure_ms)[len(exposure_ms) // 2]


def _by_time(exposure_ms: Sequence[float]) -> list[int]:
    return sorted(range(len(exposure_ms)), key=lambda k: exposure_ms[k])


@dataclass(frozen=True)
class Samples:
    """All samples of one fringe set of every pixel, as lanes, and what is known of the sensor."""

    device: Device
    fringes: FringeSet
    dn: tuple[tuple[Lanes, ...], ...]
    """Digital numbers, black level included: ``dn[exposure][step]``."""
    exposure_ms: tuple[float, ...]
    black_level_dn: float
    saturation_dn: float
    """A sample is saturated from here up; infinite when saturation is ignored."""
    whole: bool
    """Whether digital numbers are whole numbers, among which there is no NaN."""
    noise: tuple[tuple[float, float], ...]
    """Per exposure (constant, slope) of the variance ``constant + slope (DN - black level)`` in DN^2."""

    @property
    def by_time(self) -> list[int]:
        """Exposure indices, shortest first."""
        return _by_time(self.exposure_ms)

    @cached_property
    def _cache(self) -> dict[int, Phasor]:
        return {}

    def phasor(self, exposure: int) -> Phasor:
        """Least-squares phasor of one exposure; `usable` where no step is saturated."""
        if exposure not in self._cache:
            self._cache[exposure] = self._phasor(exposure)
        return self._cache[exposure]

    def _phasor(self, exposure: int) -> Phasor:
        steps = self.dn[exposure]
        mean, cosine, sine = (weighted_sum(row, steps) for row in solution(self.fringes))
        variance, slope = self.variance_dn2(exposure, mean), self.noise[exposure][1]
        return Phasor(
            cosine=cosine,
            sine=sine,
            offset=mean,
            variance_rad2=variance_rad2(self.fringes, cosine, sine, variance, slope),
            usable=self.unsaturated(exposure),
            exposure=self.device.types.UInt32(exposure),
        )

    def variance_dn2(self, exposure: int, mean: Lanes) -> Lanes:
        """Variance of one exposure's samples in DN^2 at their mean, by the sensor's noise model."""
        constant, slope = self.noise[exposure]
        return constant + slope * self.device.positive(mean - self.black_level_dn)

    def modulation_variance_dn2(self, exposure: int) -> Lanes:
        """Predicted variance of one exposure's modulation: for even steps that across the phasor, ``(B sigma_phi)^2``."""
        phasor, slope = self.phasor(exposure), self.noise[exposure][1]
        variance = self.variance_dn2(exposure, phasor.offset)
        return across_dn2(self.fringes, phasor.cosine, phasor.sine, variance, slope)

    def unsaturated(self, exposure: int) -> Lanes:
        """Where every step of one exposure is below saturation."""
        if self.saturation_dn == float("inf"):
            return self.device.types.Bool(True)
        first, *others = self.dn[exposure]
        if self.whole:
            for dn in others:
                first = self.device.dr.select(dn > first, dn, first)
            return first < self.saturation_dn
        below = first < self.saturation_dn
        for dn in others:
            below = below & (dn < self.saturation_dn)
        return below

    def select(self, condition: Lanes, yes: Phasor, no: Phasor) -> Phasor:
        """Per pixel one of two phasors."""
        pick = self.device.dr.select
        return Phasor(
            **{
                name: pick(condition, getattr(yes, name), getattr(no, name))
                for name in Phasor.__dataclass_fields__
            }
        )


class FusionRule(ABC):
    """How several exposures of a pixel become one phase."""

    def prepare(self, stack: Stack) -> Self:
        """The rule for this stack: where a rule needs the whole image first, such as its histogram."""
        return self

    @abstractmethod
    def fuse(self, samples: Samples) -> Phasor:
        """One phasor per pixel, `usable` False where no exposure serves."""


@dataclass(frozen=True)
class Single(FusionRule):
    """One fixed exposure, the baseline: index `exposure`, or the middle one by exposure time."""

    exposure: int | None = None

    def prepare(self, stack: Stack) -> Self:
        """Raises `DecodeError` if the stack has no such exposure."""
        count = len(stack.exposure_ms)
        if self.exposure is not None and not 0 <= self.exposure < count:
            raise DecodeError(
                f"exposure {self.exposure} does not exist: the stack has {count} exposures, 0 to {count - 1}"
            )
        return self

    def fuse(self, samples: Samples) -> Phasor:
        """The chosen exposure's phasor."""
        chosen = middle_exposure(samples.exposure_ms) if self.exposure is None else self.exposure
        return samples.phasor(chosen)


@dataclass(frozen=True)
class MaxModulation(FusionRule):
    """Among the exposures in which no step is saturated, the one with the largest modulation (Jiang et al. 2012)."""

    def fuse(self, samples: Samples) -> Phasor:
        """The best usable exposure's phasor; the shortest exposure's where all are saturated."""
        shortest, *longer = samples.by_time
        best = samples.phasor(shortest)
        for exposure in longer:
            other = samples.phasor(exposure)
            better = other.usable & (~best.usable | (_power(other) > _power(best)))
            best = samples.select(better, other, best)
        return best


def _power(phasor: Phasor) -> Lanes:
    return phasor.cosine * phasor.cosine + phasor.sine * phasor.sine
