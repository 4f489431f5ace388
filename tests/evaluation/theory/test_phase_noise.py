"""Theory of phase noise, compared with closed forms and with simulation."""

import numpy as np
import pytest
from scipy.special import ndtr

from evaluation.theory.phase_noise import clipped, fringe, wrapped
from tests.evaluation.synthetic_truth import Floats

# Five standard deviations of a simulation: a false alarm in two million.
SIGMAS = 5.0
SAMPLES = 200_000


def means(A: float, B: float, phase: Floats, steps: int) -> Floats:
    """Noise-free samples (N, ...) of a fringe."""
    shift = 2.0 * np.pi * np.arange(steps) / steps
    return A + B * np.cos(np.multiply.outer(np.ones(steps), phase) + shift[:, None])


def simulate(
    A: float, B: float, phase: Floats, sigma: float, steps: int = 4, clip: float = np.inf
) -> tuple[Floats, Floats]:
    """Phase errors and modulations of noisy, clipped samples, (SAMPLES, phase)."""
    rng = np.random.default_rng(1)
    ideal = means(A, B, phase, steps)
    noisy = np.clip(ideal[:, None] + rng.normal(0.0, sigma, (steps, SAMPLES, 1)), 0.0, clip)
    shift = 2.0 * np.pi * np.arange(steps) / steps
    z = np.tensordot(np.exp(-1j * shift) * 2.0 / steps, noisy, axes=1)
    return wrapped(np.angle(z) - phase), np.abs(z)


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
def test_small_noise_gives_sigma_over_modulation(steps: int) -> None:
    phase = np.linspace(-3.0, 3.0, 7)
    got = fringe(means(120.0, 80.0, phase, steps), np.full((steps, 7), 0.25))
    np.testing.assert_allclose(got.phase_rad, phase, atol=1e-12)
    np.testing.assert_allclose(got.modulation_dn, 80.0, rtol=1e-12)
    bias, rms = got.error_rad(phase)
    expected = 0.5 / 80.0 * np.sqrt(2.0 / steps)
    # The arctangent's curvature adds s^2 / 2 to a phase noise of s.
    np.testing.assert_allclose(rms, expected, rtol=expected**2)
    np.testing.assert_allclose(bias, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("A", "B", "sigma", "clip", "rice"),
    [
        pytest.param(120.0, 15.0, 3.0, 255.0, True, id="dim"),
        pytest.param(21.6, 14.4, 3.0, 255.0, False, id="dark, clipped at 0"),
        pytest.param(204.0, 136.0, 3.0, 255.0, False, id="saturated"),
        pytest.param(120.0, 80.0, 25.0, 1e9, True, id="a fifth of a radian"),
    ],
)
def test_theory_of_noisy_clipped_phases_agrees_with_simulation(
    A: float, B: float, sigma: float, clip: float, rice: bool
) -> None:
    phase = np.array([-2.5, -0.4, 0.1, 0.9])
    errors, modulation = simulate(A, B, phase, sigma, clip=clip)
    ideal = means(A, B, phase, 4)
    got = fringe(*clipped(ideal, np.full(ideal.shape, sigma**2), 0.0, clip))
    bias, rms = got.error_rad(phase)
    scatter = errors.std(axis=0)
    # A clipped sample is not normal, of which theory keeps only two moments: allow a hundredth of the noise.
    lost = 0.01 * scatter
    np.testing.assert_array_less(
        np.abs(bias - errors.mean(axis=0)), SIGMAS * scatter / np.sqrt(SAMPLES) + lost
    )
    simulated = np.sqrt(np.mean(errors**2, axis=0))
    np.testing.assert_array_less(
        np.abs(rms - simulated), SIGMAS * simulated / np.sqrt(2 * SAMPLES) + lost
    )
    threshold = float(np.median(modulation))
    fraction = (modulation < threshold).mean(axis=0)
    # Half the pixels lie below; a shift of the distribution by a hundredth of its width moves 0.4 %. Clipping makes the
    # noise unequal in the phasor's two parts, which Rice's distribution does not know.
    if rice:
        chance = SIGMAS * 0.5 / np.sqrt(SAMPLES) + 0.004
        np.testing.assert_array_less(np.abs(got.below(threshold) - fraction), chance)


@pytest.mark.parametrize(
    ("ratio", "rms"), [(1.1, 0.0140), (1.25, 0.0557), (1.5, 0.0847), (2.0, 0.0)]
)
def test_clipping_error_over_all_phases_is_the_tabulated_one(ratio: float, rms: float) -> None:
    # Unit-contrast fringes with a peak `ratio` times saturation, four steps; values by direct evaluation, 3 digits.
    phase = np.linspace(-np.pi, np.pi, 4001)[:-1]
    ideal = means(ratio / 2.0, ratio / 2.0, phase, 4)
    error = wrapped(fringe(np.minimum(ideal, 1.0), np.zeros_like(ideal)).phase_rad - phase)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(rms, abs=5e-5)


def test_clipped_moments_equal_their_integrals() -> None:
    sigma, low, high = 3.0, 0.0, 255.0
    mean = np.array([-20.0, -2.0, 1.0, 100.0, 253.0, 256.0, 275.0])
    node, weight = np.polynomial.legendre.leggauss(400)
    inside = (low + high) / 2 + (high - low) / 2 * node
    density = np.exp(-0.5 * ((inside - mean[:, None]) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi))
    density *= weight * (high - low) / 2
    at_low, at_high = ndtr((low - mean) / sigma), ndtr((mean - high) / sigma)
    first = at_low * low + at_high * high + density @ inside
    centred = (inside - first[:, None]) ** 2
    second = (
        at_low * (low - first) ** 2
        + at_high * (high - first) ** 2
        + np.einsum("ij,ij->i", density, centred)
    )
    got_mean, got_variance = clipped(mean, sigma**2, low, high)
    np.testing.assert_allclose(got_mean, first, atol=1e-9)
    np.testing.assert_allclose(got_variance, second, atol=1e-9)


def test_modulation_far_from_a_threshold_is_certainly_above_or_below() -> None:
    ideal = means(120.0, 80.0, np.linspace(-3.0, 3.0, 5), 4)
    got = fringe(ideal, np.full(ideal.shape, 9.0))
    np.testing.assert_array_equal(got.below(20.0), 0.0)
    np.testing.assert_allclose(got.below(140.0), 1.0)
