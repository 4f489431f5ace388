"""One scene of the textbook chapter: traced once, captured several times, decoded as the chapter does."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import render
import scenes
from decode.reason import Reason
from evaluation import scored
from evaluation.scoring.feature_fits import features
from evaluation.theory.phase_noise import Fringe, clipped, fringe
from fringebench.progress import StepProgress, Steps

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CAPTURES = 8
MASK_DN = 20.0
# The scan of the chapter has no shadow to cross. Without light, noise reaches 10 DN in 1 of 60 000 pixels, and B = 14.4 is
# below it in 1 of 60; the scan skips such pixels and gives them the order of their neighbour.
SCAN_DN = 10.0
MARGIN_PX = 1
# The apex is a mean over pixels: the true 5.994 mm of the chapter, for a cap of 6 mm, is a mean too.
APEX_PX = 5

METHOD: dict[str, Any] = {
    "fusion": "single",
    "saturation": "ignore",
    "unwrap": "temporal",
    "anchor": "spatial",
    "height": "linear",
    "max_order_residual": 0.5,
}


class ChapterExperiment:
    """One scene, traced once, captured `CAPTURES` times and decoded."""

    def __init__(self, name: str, seed: int, steps: Steps) -> None:
        self.name = name
        scene = scenes.load(name)
        with steps.step(f"trace light: {name}") as done:
            surfaces = render.surfaces(scene)
            self.transport = render.trace(scene, seed=seed, progress=done, surfaces=surfaces)
            self.truth = render.truth(scene, self.transport, surfaces)
        with steps.step(f"{CAPTURES} captures: {name}") as done:
            self._capture(seed, done)

    def _capture(self, seed: int, done: StepProgress) -> None:
        self.stack = render.expose(self.transport, seed=seed)
        stacks = [self.stack]
        # Noise is keyed by its seed; runs with other seeds must not share captures with this one.
        for k in range(1, CAPTURES):
            stacks.append(render.expose(self.transport, seed=seed + (k << 32)))
            done(0.5 * (k + 1) / CAPTURES)
        decoded = [decode.reconstruct(s, **METHOD, min_modulation_dn=SCAN_DN) for s in stacks]
        self.first = decoded[0]
        self.heights = np.stack([rec.height_mm for rec in decoded]).astype(np.float64)
        self.masked = [_mask(stack) for stack in stacks]

    # Measured

    def region(self, label: str) -> Mask:
        """The pixels a label is measured on, (row, col)."""
        return scored(self.truth, label, MARGIN_PX)

    def rms(self, label: str) -> float:
        """Root mean square height error of a region over all captures, mm."""
        error = (self.heights - self.truth.height_mm)[:, self.region(label)]
        return float(np.sqrt(np.mean(error**2)))

    def flagged(self, label: str) -> float:
        """Fraction of a region below the mask's threshold, over all captures."""
        region = self.region(label)
        return float(np.mean([mask[region].mean() for mask in self.masked]))

    @cached_property
    def apex(self) -> tuple[slice, slice]:
        """The pixels about the highest point."""
        row, col = np.unravel_index(np.nanargmax(self.truth.height_mm), self.truth.height_mm.shape)
        half = APEX_PX // 2
        return slice(int(row) - half, int(row) + half + 1), slice(
            int(col) - half, int(col) + half + 1
        )

    @property
    def apex_mm(self) -> float:
        """Mean measured height about the apex, over all captures."""
        return float(self.heights[:, *self.apex].mean())

    @property
    def apex_true_mm(self) -> float:
        """Mean true height of the same pixels."""
        return float(self.truth.height_mm[self.apex].mean(dtype=np.float64))

    @property
    def step_mm(self) -> tuple[float, float]:
        """Step height, mean over captures of `evaluation.scoring.feature_fits`, and its truth."""
        found = [features(height, self.truth)["step_height"] for height in self.heights]
        measured = [f.measured_mm for f in found if f.measured_mm is not None]
        assert found[0].truth_mm is not None  # the shipped scene shows its step
        return float(np.mean(measured)), found[0].truth_mm

    # Theory

    @cached_property
    def light(self) -> Fringe:
        """The finest fringe as rendered: no noise, no rounding, no clipping."""
        return fringe(self._mean_dn, np.zeros_like(self._mean_dn))

    @cached_property
    def samples(self) -> Fringe:
        """The same fringe as sampled: noisy, rounded, clipped."""
        sensor = self.transport.scene.sensor
        variance = sensor.variance_dn2(self._mean_dn, self.stack.exposure_ms[0])
        return fringe(*clipped(self._mean_dn, variance, 0.0, sensor.full_scale_dn))

    @cached_property
    def error_theory_mm(self) -> tuple[Floats, Floats]:
        """Mean and root mean square height error of each pixel over the noise."""
        mean, rms = self.samples.error_rad(self.light.phase_rad)
        return mean * self._mm_per_rad, rms * self._mm_per_rad

    def rms_theory(self, label: str) -> float:
        """Expected `rms`."""
        return float(np.sqrt(np.mean(self.error_theory_mm[1][self.region(label)] ** 2)))

    def flagged_theory(self, label: str) -> float:
        """Expected `flagged`."""
        return float(self.samples.below(MASK_DN)[self.region(label)].mean())

    @property
    def apex_bias_theory_mm(self) -> float:
        """Expected error of `apex_mm`."""
        return float(self.error_theory_mm[0][self.apex].mean())

    @property
    def apex_noise_mm(self) -> float:
        """Expected standard deviation of `apex_mm`."""
        mean, rms = (error[self.apex] for error in self.error_theory_mm)
        return float(np.sqrt((rms**2 - mean**2).sum() / CAPTURES) / rms.size)

    def modulation(self, label: str) -> float:
        """Mean modulation of a region after clipping, DN."""
        return float(self.samples.modulation_dn[self.region(label)].mean())

    def shading(self, label: str) -> tuple[float, float]:
        """Smallest and largest departure of a region's light from that of its apex."""
        light = self.light.modulation_dn
        ratio = light[self.region(label)] / light[self.apex].mean() - 1.0
        return float(ratio.min()), float(ratio.max())

    @cached_property
    def _mean_dn(self) -> Floats:
        """Frames of the finest period, (step, row, col)."""
        scene = self.transport.scene
        chosen = [i for i, f in enumerate(scene.frames) if f.period_px == self._finest_px]
        radiance = self.transport.frames()[chosen]
        return scene.sensor.mean_dn(radiance, self.stack.exposure_ms[0])

    @property
    def _mm_per_rad(self) -> float:
        """Height per phase, P / (2 pi c)."""
        scene = self.transport.scene
        points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        low, high = scene.projectors[0].projection().project(points)[0][:, 0]
        return float(self._finest_px / (2.0 * np.pi * (high - low)))

    @property
    def _finest_px(self) -> float:
        return min(frame.period_px for frame in self.transport.scene.frames)


def _mask(stack: scenes.Stack) -> Mask:
    """Pixels that the mask of the chapter rejects, by modulation only."""
    reason = decode.reconstruct(stack, **METHOD, min_modulation_dn=MASK_DN).reason
    return np.isin(reason, (Reason.DARK, Reason.SHADOW))
