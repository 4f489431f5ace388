"""What the measured second harmonic claims to know of itself, against drawn noise and phases."""

import numpy as np
import pytest

from decode.checks.fringe_check import misfit
from decode.phase.gamma import Harmonics, _from_histogram, estimate, harmonics, response
from decode.phase.n_step import fringe_sets
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack

THIRDS = np.linspace(0.0, 2.0 * np.pi, 3, endpoint=False)


def measured(steps: int, sigma_dn: float, seed: int) -> Harmonics:
    """Of ideal sinusoids with noise, each pixel at a phase of its own."""
    rng = np.random.default_rng(seed)
    shown = PhaseShift(steps=steps, periods_px=(16.0,)).frames()
    phase = rng.uniform(0.0, 2.0 * np.pi, (50, 80))
    frames = np.stack([120.0 + 80.0 * np.cos(phase + f.phase_shift_rad) for f in shown])
    frames += sigma_dn * rng.standard_normal(frames.shape)
    sensor = SimpleSensor(sigma_dn=sigma_dn, bits=0)
    stack = Stack(frames[None].astype(np.float32), shown, (1.0,), sensor)
    return harmonics(stack, fringe_sets(shown, 0)["column"][0])


@pytest.mark.parametrize("steps", [4, 5, 8])
def test_residual_of_ideal_fringes_is_the_noise_that_is_claimed(steps: int) -> None:
    """Of N samples a sinusoid takes three: sqrt((N - 3) / N) of the noise is left."""
    found = measured(steps, 2.0, steps)
    assert found.noise == pytest.approx(2.0 / 80.0 * np.sqrt((steps - 3) / steps), rel=1e-3)
    # 4000 pixels with N - 3 freedoms: 1.1 % at four steps.
    assert found.residual == pytest.approx(found.noise, rel=0.05)


def test_error_of_the_phases_histogram_is_that_of_a_complex_mean() -> None:
    """The harmonic is the real part, which scatters by sqrt(1/2) of the error that is claimed."""
    found = [measured(3, 0.0, seed) for seed in range(100)]
    scatter = np.std([h.second for h in found]) / np.mean([h.error for h in found])
    # 100 draws know a standard deviation to 7 %.
    assert scatter == pytest.approx(np.sqrt(0.5), rel=0.25)


def test_sets_of_fringes_count_by_the_inverse_of_their_variance() -> None:
    rng = np.random.default_rng(0)
    patterns = PhaseShift(steps=4, periods_px=(16.0, 128.0))
    phase = rng.uniform(0.0, 2.0 * np.pi, (50, 80))
    light = [(0.5 + 0.45 * np.cos(phase + f.phase_shift_rad)) ** 1.2 for f in patterns.frames()]
    # A quarter of the fringes' contrast, so that one set knows gamma worse.
    light[4:] = [0.4 + 0.25 * (one - 0.4) for one in light[4:]]
    frames = 20.0 + 200.0 * np.array(light) + rng.standard_normal((8, 50, 80))
    sensor = SimpleSensor(sigma_dn=1.0, bits=0, black_level_dn=20.0)
    stack = Stack(frames[None].astype(np.float32), patterns.frames(), (1.0,), sensor)
    found = [harmonics(stack, one) for one in fringe_sets(patterns.frames(), 0)["column"]]
    weight = np.array([h.error for h in found]) ** -2.0
    assert weight.max() > 4.0 * weight.min()
    assert estimate(stack) == pytest.approx(weight @ [h.gamma for h in found] / weight.sum())


def test_misfit_is_what_noise_and_gamma_do_not_explain() -> None:
    """Variances add: 0.7^2 = 0.2^2 + 0.3^2 + 0.6^2."""
    seen = Harmonics(0.0, 0.0, 1.0, 0.7, 0.2, 0.3)
    assert misfit(seen) == pytest.approx(0.6)
    assert misfit(Harmonics(0.0, 0.0, 1.0, 0.1, 0.2, 0.3)) == 0.0


@pytest.mark.parametrize(
    ("gamma", "error", "bent", "linear"),
    [
        (1.15, 1e-4, True, False),
        (0.85, 1e-4, True, False),
        (1.05, 1e-4, False, True),
        (0.95, 1e-4, False, True),
        (1.05, 0.01, False, False),  # Four standard deviations of gamma are 0.12.
        (
            1.15,
            0.02,
            False,
            False,
        ),  # The harmonic itself is in doubt: 0.05 against four times 0.02.
    ],
)
def test_gamma_counts_beyond_a_tenth_and_four_standard_deviations(
    gamma: float, error: float, bent: bool, linear: bool
) -> None:
    # d(gamma) = 3 d(second), near gamma 1.
    found = Harmonics((gamma - 1.0) / 3.0, error, gamma, 0.0, 0.0, 0.0)
    assert (found.bent, found.linear) == (bent, linear)


@pytest.mark.parametrize("first_rad", [0.0, 0.5, -2.0])
def test_three_step_histogram_shows_the_second_harmonic_wherever_steps_begin(
    first_rad: float,
) -> None:
    # Light of A + cos(x) + 0.05 cos(2 x), seen by steps of a third of a turn, over a uniform x.
    true = np.linspace(0.0, 2.0 * np.pi, 30_000, endpoint=False)
    shifts = first_rad + THIRDS
    angle = true + shifts[:, None]
    seen = np.cos(angle) + 0.05 * np.cos(2.0 * angle)
    phase = -np.angle((seen * np.exp(1j * shifts)[:, None]).sum(axis=0))
    # First order in 0.05: the next is a few per cent of it.
    assert _from_histogram(phase, shifts)[0] == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize(("uneven", "usable"), [(0.2, True), (0.48, False)])
def test_histogram_of_a_surface_with_phases_of_its_own_shows_nothing(
    uneven: float, usable: bool
) -> None:
    """Phases with density 1 + c cos x have an RMS harmonic of c / 4 over the four that are looked at: 1/12 is the limit."""
    grid = np.linspace(-np.pi, np.pi, 100_001)
    even = np.linspace(-np.pi, np.pi, 20_000)
    phase = np.interp(even, grid + uneven * np.sin(grid), grid)
    found = _from_histogram(phase, THIRDS)
    assert np.isfinite(found).all() == usable


@pytest.mark.parametrize(
    ("gammas", "found"), [((1.5, 1.5), 1.5), ((1.5, 1.0), None), ((1.0, 1.0), None)]
)
def test_gamma_is_reported_only_if_all_sets_agree_on_it(
    gammas: tuple[float, float], found: float | None
) -> None:
    """One linear set among bent ones: what bends them is not the projector's response."""
    patterns = PhaseShift(steps=5, periods_px=(16.0, 80.0))
    shown = patterns.frames()
    by_period = dict(zip(patterns.periods_px, gammas, strict=True))
    column = np.random.default_rng(3).uniform(0.0, 400.0, (50, 80))
    frames = [200.0 * patterns.commanded(f, column) ** by_period[f.period_px] for f in shown]
    stack = Stack(np.array([frames], np.float32), shown, (1.0,), SimpleSensor(sigma_dn=0.1, bits=0))
    assert response(stack) == (None if found is None else pytest.approx(found, abs=0.02))
