"""Mitsuba's own `path` integrator as the reference for the fast pass: per-pixel and whole-image tests of equal means.

Both estimates are repeated with independent seeds, so each variance is measured, not modelled (the fast pass's samples
are stratified: the scatter inside one run would overstate its variance).
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from render.plugins.variant import mi
from scenes import Scene

# Radiances are sums of some tens of float32 terms; rounding alone makes two of them differ by about this much.
ROUNDING = 1e-5


@dataclass(frozen=True)
class Comparison:
    """Repeated estimates of one frame, (repeat, row, col)."""

    ours: NDArray[np.float64]
    oracle: NDArray[np.float64]

    def pixel_p_values(self) -> NDArray[np.float64]:
        """Welch's test in every pixel: the chance of a difference this large if the means are equal."""
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
        """Smallest pixel p-value, corrected for the number of pixels (Sidak)."""
        p = self.pixel_p_values()
        return float(-np.expm1(p.size * np.log1p(-p.min())))

    def require_equal(self, folder: Path) -> None:
        """Fail if pixels or means differ, and save image, reference and z map as EXR in `folder`."""
        smallest = self.smallest_p()
        bias, error, p = self.mean_bias()
        # One case in a thousand fails by chance (with fresh seeds), and a mean three standard errors off.
        if smallest > 1e-3 and p > 2 * stats.norm.sf(3):
            return
        self.save(folder)
        pytest.fail(
            f"light differs from path: smallest p of a pixel {smallest:.1e}, bias {bias:.1e}, "
            f"standard error {error:.1e}; see image.exr, reference.exr and z.exr in {folder}"
        )

    def save(self, folder: Path) -> None:
        """Write `image.exr`, `reference.exr` (means) and `z.exr` (difference in standard errors) to `folder`."""
        image, reference = self.ours.mean(axis=0), self.oracle.mean(axis=0)
        z = np.sign(image - reference) * stats.norm.isf(
            np.maximum(self.pixel_p_values(), 1e-300) / 2
        )
        save_images(folder, image=image, reference=reference, z=z)

    def mean_bias(self) -> tuple[float, float, float]:
        """Relative difference of the images' means, its standard error, and Welch's p-value."""
        a, b = self.ours.mean(axis=(1, 2)), self.oracle.mean(axis=(1, 2))
        error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
        p = stats.ttest_ind(a, b, equal_var=False).pvalue
        return float((a.mean() - b.mean()) / b.mean()), float(error / b.mean()), float(p)


def save_images(folder: Path, **images: NDArray[Any]) -> None:
    """Write each image (row, col) as ``NAME.exr`` to `folder`."""
    for name, values in images.items():
        mi.Bitmap(values.astype(np.float32)).write(str(folder / f"{name}.exr"))


def require_same(
    image: NDArray[Any], reference: NDArray[Any], where: NDArray[np.bool_], folder: Path
) -> None:
    """Fail if an image differs from its reference at those pixels, and save both and the difference in `folder`."""
    differs = where & (image != reference)
    if differs.any():
        save_images(folder, image=image, reference=reference, difference=differs)
        pytest.fail(
            f"{differs.sum()} pixels differ; see image.exr, reference.exr and difference.exr in {folder}"
        )


def fast_pass(
    scene: Scene, frame: int, projector: int = 0, repeats: int = 16, samples: int = 256
) -> NDArray[np.float64]:
    """Repeated estimates of one frame by the fast pass, (repeat, row, col)."""
    surfaces = render.surfaces(scene)
    traced = [
        render.trace(scene, seed=int(seed), samples=samples, surfaces=surfaces)
        for seed in _seeds(repeats)[0]
    ]
    return np.stack([light.frames(projector)[frame] for light in traced]).astype(np.float64)


def compare(
    scene: Scene, frame: int, projector: int = 0, repeats: int = 16, samples: int = 256
) -> Comparison:
    """Estimate one frame with the fast pass and with `path`."""
    judge = render.mitsuba_scene(scene, frame, projector)
    renders = [np.array(mi.render(judge, spp=samples, seed=int(i))) for i in _seeds(repeats)[1]]
    oracle = np.stack(renders)[..., 0].astype(np.float64)
    return Comparison(fast_pass(scene, frame, projector, repeats, samples), oracle)


def _seeds(repeats: int) -> NDArray[np.int64]:
    """Seeds of the fast pass and of `path`.

    Mitsuba's random streams of neighbouring seeds are not independent: with seeds 1000 to 1047 one pixel of
    768 is six standard errors off its mean over 32768 samples; with random seeds none is.
    """
    return np.random.default_rng(0).integers(0, 2**31, (2, repeats))
