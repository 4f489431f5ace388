"""Exposure fusion: one phase per pixel out of several exposures of the same fringes.

A rule sees all samples of one fringe set of one pixel, inside the kernel, and returns one `Phasor`. `decode.fusion.registry`
finds rules by name.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from decode.device import Device, Lanes
from decode.phase.n_step import FringeSet, Phasor, across_dn2, solution, variance_rad2, weighted_sum
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# `Phasor.exposure` where more than one exposure made the phase.
MERGED = 255


def middle_exposure(
    exposure_ms: Sequence[float], of_two: Literal["longer", "shorter"] = "longer"
) -> int:
    """Index of the median exposure.

    Parameters
    ----------
    exposure_ms
        Exposure times in any order, ms.
    of_two
        Which of the middle two to take for an even count.

    Returns
    -------
    int
        Index into `exposure_ms`.

    Examples
    --------
    >>> middle_exposure((4.0, 1.0, 2.0))
    2
    >>> middle_exposure((8.0, 1.0)), middle_exposure((8.0, 1.0), of_two="shorter")
    (0, 1)
    """
    count = len(exposure_ms)
    return _by_time(exposure_ms)[count // 2 if of_two == "longer" else (count - 1) // 2]


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
    at: Lanes | None = None
    """Flat indices of the pixels, uint32; None: the whole image."""

    def image(self, values: NDArray[Any]) -> Lanes:
        """A whole image as the pixels' own values: how a rule uses what `FusionRule.prepare` found in the stack.

        Parameters
        ----------
        values
            Image (row, col) of the stack's size, any real type.

        Returns
        -------
        Lanes
            Float32, one per pixel.
        """
        return self.device.plane(np.asarray(values, np.float32), self.at)

    @classmethod
    def of(
        cls,
        device: Device,
        stack: Stack,
        fringes: FringeSet,
        reject_saturated: bool = True,
        at: Lanes | None = None,
    ) -> Self:
        """Samples of one fringe set, read from a stack.

        Parameters
        ----------
        device
            Backend that decodes.
        stack
            Frames (exposure, frame, row, col) in DN.
        fringes
            Which frames, and their phase shifts.
        reject_saturated
            False: no sample counts as saturated.
        at
            Flat pixel indices, uint32 lanes; None: the whole image.

        Returns
        -------
        Samples
            ``dn[exposure][step]`` as float32 lanes.
        """
        return cls(
            device=device,
            fringes=fringes,
            dn=tuple(
                tuple(device.plane(exposure[k], at) for k in fringes.frames)
                for exposure in stack.frames
            ),
            exposure_ms=stack.exposure_ms,
            black_level_dn=stack.sensor.black_level_dn,
            saturation_dn=stack.saturation_dn if reject_saturated else float("inf"),
            whole=bool(np.issubdtype(stack.frames.dtype, np.integer)),
            noise=tuple(stack.sensor.noise_model(ms) for ms in stack.exposure_ms),
            at=at,
        )

    @property
    def by_time(self) -> list[int]:
        """Exposure indices, shortest first."""
        return _by_time(self.exposure_ms)

    @cached_property
    def _cache(self) -> dict[int, Phasor]:
        return {}

    def phasor(self, exposure: int) -> Phasor:
        """Least-squares phasor of one exposure, by its index, in DN; `usable` where no step is saturated."""
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
        """Variance of one exposure's samples in DN^2 at their mean (black level included), by the sensor's noise model."""
        constant, slope = self.noise[exposure]
        return constant + slope * self.device.positive(mean - self.black_level_dn)

    def modulation_variance_dn2(self, exposure: int) -> Lanes:
        """Predicted variance of one exposure's modulation in DN^2: for even steps that across the phasor, ``(B
        sigma_phi)^2``.
        """
        phasor, slope = self.phasor(exposure), self.noise[exposure][1]
        variance = self.variance_dn2(exposure, phasor.offset)
        return across_dn2(self.fringes, phasor.cosine, phasor.sine, variance, slope)

    def unsaturated(self, exposure: int) -> Lanes:
        """Where every step of one exposure is below saturation: booleans, one per pixel."""
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
        """Per pixel the phasor `yes` where the condition (booleans) holds, else `no`."""
        pick = self.device.dr.select
        return Phasor(
            **{
                name: pick(condition, getattr(yes, name), getattr(no, name))
                for name in Phasor.__dataclass_fields__
            }
        )

    def best(self, choices: Iterable[Phasor], better: Callable[[Phasor, Phasor], Lanes]) -> Phasor:
        """Per pixel the first of several phasors, or a later one where ``better(later, best before it)``."""
        best, *others = choices
        for other in others:
            best = self.select(better(other, best), other, best)
        return best


class FusionRule(ABC):
    """How several exposures of a pixel become one phase."""

    def prepare(self, stack: Stack) -> Self:
        """The rule adapted to a stack, for rules that need more than a pixel: its histogram, neighbours, all frames.

        Images that it makes are read in `fuse` with `Samples.image`.

        Parameters
        ----------
        stack
            Frames (exposure, frame, row, col) in DN.

        Returns
        -------
        FusionRule
            The rule that `fuse` is then called on.

        Raises
        ------
        DecodeError
            The rule cannot be used with this stack.
        """
        return self

    @abstractmethod
    def fuse(self, samples: Samples) -> Phasor:
        """One phasor per pixel from all its samples.

        Parameters
        ----------
        samples
            Digital numbers by exposure and step, as lanes, with times in ms and the noise model in DN.

        Returns
        -------
        Phasor
            Offset and phasor in DN and the phase's predicted variance in rad^2; `usable` False where no exposure can be used.
        """


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
        return samples.best(map(samples.phasor, samples.by_time), stronger)


def stronger(one: Phasor, other: Phasor) -> Lanes:
    """Where the first of two phasors is usable, and the second is not or has less modulation."""
    return one.usable & (~other.usable | (_power(one) > _power(other)))


def _power(phasor: Phasor) -> Lanes:
    return phasor.cosine * phasor.cosine + phasor.sine * phasor.sine
