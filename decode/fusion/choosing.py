"""Fusion that takes one exposure as it is: one for the whole image, or one for each pixel."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from decode.fusion.interface import FusionRule, Samples, Single
from decode.phase.n_step import Phasor
from scenes.files.stack import Stack


@dataclass(frozen=True)
class AutoExposureRule(FusionRule):
    """One exposure for the whole image, chosen from its histogram (Ekstrand & Zhang 2011): the longest in which at most
    `clipped_fraction` of the pixels have a saturated step; the shortest if none is so.
    """

    clipped_fraction: float = 0.01
    exposure: int | None = None
    """The choice, once `prepare` has seen the stack."""

    def prepare(self, stack: Stack) -> Self:
        """Choose the exposure."""
        order = np.argsort(stack.exposure_ms, kind="stable")
        chosen = int(order[0])
        for k in order:
            peak = stack.frames[k].max(axis=0)
            if np.mean(peak >= stack.saturation_dn) <= self.clipped_fraction:
                chosen = int(k)
        return replace(self, exposure=chosen)

    def fuse(self, samples: Samples) -> Phasor:
        """The chosen exposure's phasor."""
        return Single(self.exposure).fuse(samples)


@dataclass(frozen=True)
class BrightestUnsaturated(FusionRule):
    """Per pixel the longest exposure in which no step is saturated (Zhang & Yau 2009)."""

    def fuse(self, samples: Samples) -> Phasor:
        """The chosen exposures' phasors; the shortest exposure's where all are saturated."""
        return samples.best(map(samples.phasor, samples.by_time), lambda longer, _: longer.usable)
