"""Mitsuba's own `path` integrator as the judge of the fast pass: per-pixel and whole-image tests of equality in mean.

Both estimates are repeated with independent seeds, so each variance is measured, not modelled (the fast pass's samples
are stratified: the scatter inside one run would overstate its variance).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import render
from render.variant import mi
from scenes import Scene

# Radiances are sums of some tens of float32 terms; two that are equal but for rounding differ by about this much.
ROUNDING = 1e-5


@dataclass(frozen=True)
class Comparison:
    """Repeated estimates of one frame, (repeat, row, col)."""

    ours: NDArray[np.float64]
    oracle: NDArray[np.float64]

    def pixel_p_values(self) -> NDArray[np.float64]:
        """Welch's test in every pixel: the chance of a difference this large were the means equal."""
        a, b = (
            self.ours.var(axis=0, ddof=1) / len(self.ours),
            (self.oracle.var(axis=0, ddof=1) / len(self.oracle)),
        )
        difference = self.ours.mean(axis=0) - self.oracle.mean(axis=0)
        rounding = (ROUNDING * self.oracle.mean(axis=0)) ** 2 + 1e-30
        freedom = (a + b + rounding) ** 2 / (
            (a + rounding) ** 2 / (len(self.ours) - 1)
            + (b + rounding) ** 2 / (len(self.oracle) - 1)
        )
        p: NDArray[np.float64] = 2 * stats.t.sf(
            np.abs(difference) / np.sqrt(a + b + rounding), freedom
        )
        return p

    def smallest_p(self) -> float:
        """Smallest pixel p-value, corrected for having looked at all pixels (Sidak)."""
        p = self.pixel_p_values()
        return float(-np.expm1(p.size * np.log1p(-p.min())))

    def mean_bias(self) -> tuple[float, float, float]:
        """Relative difference of the images' means, its standard error, and Welch's p-value."""
        a, b = self.ours.mean(axis=(1, 2)), self.oracle.mean(axis=(1, 2))
        error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
        p = stats.ttest_ind(a, b, equal_var=False).pvalue
        return float((a.mean() - b.mean()) / b.mean()), float(error / b.mean()), float(p)


def compare(
    scene: Scene, frame: int, projector: int = 0, repeats: int = 24, samples: int = 128
) -> Comparison:
    """Estimate one frame with the fast pass and with `path`."""
    judge = render.mitsuba_scene(scene, frame, projector)
    # Mitsuba's random streams of neighbouring seeds are not independent: seeds 1000 to 1047 put one pixel of 768 six
    # standard errors off its mean over 32768 samples, which seeds drawn at random do not.
    seeds = np.random.default_rng(0).integers(0, 2**31, (2, repeats))
    return Comparison(
        np.stack(
            [
                render.trace(scene, seed=int(i), samples=samples).frames(projector)[frame]
                for i in seeds[0]
            ]
        ).astype(np.float64),
        np.stack(
            [np.array(mi.render(judge, spp=samples, seed=int(i)))[..., 0] for i in seeds[1]]
        ).astype(np.float64),
    )
