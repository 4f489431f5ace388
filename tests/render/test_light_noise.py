"""Noise of light behind a lens: the plan's weights against the variance that they are to lower."""

import numpy as np
import pytest

import render
import scenes
from render.light_noise import phase_variance, sensor_noise, through, weights
from tests.render import rigs


@pytest.mark.parametrize("seed", range(3))
def test_weights_times_variances_are_the_variance_of_heights_behind_the_lens(seed: int) -> None:
    """The plan works in reverse: what a pixel's own variance adds to the heights of all pixels around it."""
    rng = np.random.default_rng(seed)
    shape, edge = (24, 30), 6
    phasor = np.asarray(rng.normal(3.0, 1.0, shape) + 1j * rng.normal(size=shape), np.complex128)
    # A quadrant, as `spread_kernel` has it.
    kernel = np.outer(*[np.exp(-(np.arange(5) ** 2) / 3.0)] * 2)
    mm_per_rad = np.where(rng.random(shape) < 0.7, rng.uniform(0.1, 1.0, shape), 0.0)
    across, along = np.zeros((2, *shape))
    inner = np.s_[edge:-edge, edge:-edge]
    across[inner], along[inner] = rng.uniform(0.0, 0.01, (2, *across[inner].shape))

    variance = phase_variance(phasor, across, along, np.zeros(shape), kernel)
    chip = through(phasor, kernel)
    own = weights(phasor[None], chip[None], mm_per_rad[None], kernel)[:, 0]
    # Blurs are of float32.
    assert (own * [across, along]).sum() == pytest.approx(
        (mm_per_rad**2 * variance).sum(), rel=1e-4
    )


def test_a_lens_that_does_not_blur_changes_no_weight() -> None:
    rng = np.random.default_rng(0)
    shape = (1, 8, 8)
    phasor = np.asarray(rng.normal(size=shape) + 1j * rng.normal(size=shape), np.complex128)
    mm_per_rad = rng.uniform(0.1, 1.0, shape)
    sharp = weights(phasor, phasor, mm_per_rad, None)
    assert weights(phasor, phasor, mm_per_rad, np.ones((1, 1))) == pytest.approx(
        sharp, rel=1e-5, abs=1e-5
    )


@pytest.mark.parametrize("period_px", [16.0, 32.0])
def test_height_per_phase_is_the_fringes_over_the_sine_of_the_angle(period_px: float) -> None:
    """Both telecentric: a fringe of p mm on a plane across the projector's axis moves by h sin(angle) / p at a height h."""
    devices = rigs.telecentric(), rigs.telecentric_projector()
    scene = rigs.scene(*devices, objects=rigs.plane(), patterns={"periods_px": (period_px,)})
    bright = scenes.parse(scenes.dumps(scene), {"exposures.times_ms": [10.0]})
    noise = sensor_noise(render.trace(bright, samples=4, depth=1))
    assert noise is not None
    measured = noise.mm_per_rad[0] > 0.0
    assert measured.mean() > 0.9
    fringe_mm = period_px * 72.0 / 128
    expected = fringe_mm / (2 * np.pi * 80.0 / np.hypot(80.0, 200.0))
    np.testing.assert_allclose(noise.mm_per_rad[0][measured], expected, rtol=1e-6)
