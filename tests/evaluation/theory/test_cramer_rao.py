"""The Cramer-Rao bound against closed forms and integrals, and efficiency against draws of known variance."""

import numpy as np
import pytest
from scipy import integrate, stats

from evaluation.theory.cramer_rao import FringeLight, efficiency, phase_bound_rad2
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.support.errors import ScoreError

PHASE = (2.0 * np.pi * (np.arange(50) + 0.5) / 50 - np.pi)[None]


def light(offset: float, modulation: float) -> FringeLight:
    return FringeLight(
        np.full_like(PHASE, offset), modulation * np.cos(PHASE), modulation * np.sin(PHASE)
    )


def shifts(steps: int) -> list[float]:
    return [2.0 * np.pi * k / steps for k in range(steps)]


@pytest.mark.parametrize("steps", [3, 4, 7])
def test_constant_noise_gives_the_textbook_variance(steps: int) -> None:
    sensor = SimpleSensor(sigma_dn=3.0, bits=0)
    found = phase_bound_rad2(light(120.0, 80.0), shifts(steps), (1.0,), sensor)
    np.testing.assert_allclose(found, 2.0 * 9.0 / (steps * 80.0**2), rtol=1e-12)
    # exposures add up as the squares of their times
    both = phase_bound_rad2(light(120.0, 80.0), shifts(steps), (1.0, 2.0, 2.0), sensor)
    np.testing.assert_allclose(both, found / 9.0, rtol=1e-12)


def test_shot_noise_bound_of_four_steps_is_the_closed_form() -> None:
    """``(gain A / (2 B^2)) (1 - (B sin 2 phi / A)^2 / 2)``: the fourth sample checks the other three."""
    sensor = Emva(read_noise_e=0.0, bits=0, full_well_e=1e9, dark_current_e_per_s=0.0)
    dn = float(sensor.mean_dn(1.0, 1.0)) - sensor.black_level_dn
    a, b = 1000.0, 900.0
    found = phase_bound_rad2(light(a / dn, b / dn), shifts(4), (1.0,), sensor)
    matched = sensor.gain_dn_per_e * a / (2.0 * b**2)
    true = matched * (1.0 - (b * np.sin(2.0 * PHASE) / a) ** 2 / 2.0)
    np.testing.assert_allclose(found, true, rtol=1e-9)


@pytest.mark.parametrize("limit", [-2.0, -0.5, 0.0, 1.0, 4.0])
def test_information_of_a_clipped_sample_is_the_integral_of_its_squared_score(limit: float) -> None:
    """Three steps, two far from their limits, so that the bound moves with one sample's information alone."""
    sigma, modulation, phase = 2.0, 60.0, 0.6
    total = np.sqrt(sigma**2 + 1.0 / 12.0)
    # saturation, half a DN below 255 for rounding, lies `limit` sigma above step 0, which is on the slope of the fringe
    mean = 254.5 - limit * total
    cosine, sine = modulation * np.cos(phase), modulation * np.sin(phase)
    one = FringeLight(*(np.array([[x]]) for x in (mean - cosine, cosine, sine)))
    sensor = SimpleSensor(sigma_dn=sigma)

    def square(y: float) -> float:
        return float(((y - mean) / total**2) ** 2 * stats.norm.pdf(y, mean, total))

    inside, _ = integrate.quad(square, mean - 12.0 * total, min(254.5, mean + 12.0 * total))
    gone = stats.norm.sf(limit)
    edge = (stats.norm.pdf(limit) / total) ** 2 / gone
    for censored, known in ((True, inside + edge), (False, (1.0 - gone) / total**2)):
        found = phase_bound_rad2(one, shifts(3), (1.0,), sensor, censored=censored).item()
        weights = np.array([known, 1.0 / total**2, 1.0 / total**2])
        design = np.stack([np.ones(3), np.cos(shifts(3)), -np.sin(shifts(3))], axis=1)
        covariance = np.linalg.inv(design.T @ (weights[:, None] * design))
        across = np.array([0.0, -np.sin(phase), np.cos(phase)]) / modulation
        assert found == pytest.approx(across @ covariance @ across, rel=1e-6)


def test_no_bound_where_fewer_than_three_steps_can_be_seen() -> None:
    found = phase_bound_rad2(light(400.0, 380.0), shifts(4), (1.0,), SimpleSensor(sigma_dn=1.0))
    assert np.isinf(found).any()
    assert np.isfinite(
        phase_bound_rad2(light(400.0, 380.0), shifts(4), (1.0, 0.3), SimpleSensor(sigma_dn=1.0))
    ).all()


def test_light_of_a_fringe_is_found_among_other_frames() -> None:
    shown = PhaseShift(periods_px=(16.0, 80.0), steps=5).frames()
    true = light(7.0, 3.0)
    frames = np.stack(
        [true.at(f.phase_shift_rad) if f.period_px == 16.0 else np.zeros_like(PHASE) for f in shown]
    )
    found = FringeLight.of(frames, shown, "column", 16.0)
    np.testing.assert_allclose(found.phase_rad, PHASE, atol=1e-12)
    np.testing.assert_allclose(found.offset, 7.0)
    with pytest.raises(ScoreError, match="no row fringe of 16 px"):
        FringeLight.of(frames, shown, "row", 16.0)


def test_efficiency_is_the_ratio_drawn_and_bias_is_kept_apart() -> None:
    rng = np.random.default_rng(0)
    n, repeats = 20_000, 6
    bound = rng.uniform(1.0, 4.0, n) * 1e-4
    bias = 0.02 * np.sin(np.arange(n))
    noise = rng.normal(0.0, np.sqrt(bound / 0.8), (repeats, n))
    error = bias + noise
    error[:, :50] = np.nan
    error[0, 50] = np.nan
    bound[60:70] = np.inf
    found = efficiency(error, bound)
    assert found is not None
    assert found.pixels == n - 61
    # the interval is of 95 %; twice it is of 99.99 %
    assert abs(found.value - 0.8) < 2.0 * found.half_width
    assert found.half_width == pytest.approx(1.96 * 0.8 * np.sqrt(2.0 / (repeats - 1) / n), rel=0.1)
    assert found.bias_rad == pytest.approx(0.02 / np.sqrt(2.0), rel=0.02)
    # errors a turn apart are the same
    turned = efficiency(error + 2.0 * np.pi * rng.integers(-3, 3, error.shape), bound)
    assert turned is not None and turned.value == pytest.approx(found.value)
    assert efficiency(np.full((2, 3), np.nan), np.ones(3)) is None
    with pytest.raises(ScoreError, match="at least 2"):
        efficiency(error[:1], bound)


def test_one_pixel_has_an_efficiency_of_unknown_uncertainty() -> None:
    error = np.random.default_rng(1).normal(0.0, 0.01, (5, 1))
    found = efficiency(error, np.array([1e-4]))
    assert found is not None
    assert found.pixels == 1
    assert found.half_width == np.inf


def test_pixel_whose_bound_says_nothing_has_no_efficiency() -> None:
    """All steps clipped: no scatter, and a bound above the pi^2 / 3 of a phase that is uniform over a turn."""
    alone = efficiency(np.full((3, 4), 0.2), np.full(4, 3.3))
    found = efficiency(np.array([[0.1, 0.2], [-0.1, 0.2], [0.0, 0.2]]), np.array([0.01, 1e9]))
    assert alone is not None and found is not None
    assert np.isnan(alone.value)
    # Its error is still one of the decoder.
    assert alone.bias_rad == pytest.approx(0.2)
    assert found.pixels == 1
    assert found.value == pytest.approx(1.0)
