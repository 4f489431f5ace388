"""Sensor stages against EMVA 1288 and against the variance that `scenes.sensor` promises decoders."""

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.constants
import scipy.stats
from numpy.typing import NDArray

from render.sensor_stages import (
    LineNoise,
    Noise,
    digital_numbers,
    digitised,
    fixed_pattern,
    mean_electrons,
    with_read_noise,
    with_shot_noise,
)
from scenes.acquisition.sensor import Emva, SimpleSensor

CAMERA = Emva()
# Fails a right program once in 1.7 million samples of a normal statistic.
FIVE_SIGMA = 5.0


def radiance_of(electrons: float, sensor: Emva = CAMERA, time_ms: float = 1.0) -> float:
    """Radiance that gives so many mean electrons."""
    dark = float(sensor.mean_electrons(0.0, time_ms))
    return (electrons - dark) / (float(sensor.mean_electrons(1.0, time_ms)) - dark)


def frame(
    level: float, sensor: Emva | SimpleSensor, count: int, seed: int = 0, index: int = 0
) -> NDArray[Any]:
    return digital_numbers(np.full(count, level), 1.0, sensor, Noise.of(seed, 0, index))


def test_mean_electrons_follow_from_first_principles() -> None:
    radiance, seconds = 7.0, 4e-3
    half_angle = np.arctan(1 / (2 * CAMERA.f_number))
    # Irradiance behind a lens whose cone has this half angle, in the paraxial form EMVA's users compute with.
    irradiance = np.pi * radiance * CAMERA.transmission * np.tan(half_angle) ** 2
    joules = irradiance * (CAMERA.pixel_um * 1e-6) ** 2 * seconds
    photon = scipy.constants.h * scipy.constants.c / (CAMERA.wavelength_nm * 1e-9)
    expected = CAMERA.quantum_efficiency * joules / photon + CAMERA.dark_current_e_per_s * seconds
    assert mean_electrons(np.array(radiance), 4.0, CAMERA) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("mean", [0.02, 0.7, 9.5, 11.0, 300.0])
def test_shot_noise_is_poisson(mean: float) -> None:
    count = 1 << 18
    drawn = with_shot_noise(np.full(count, mean), CAMERA, Noise.of(0, 0, 0).shot)
    law = scipy.stats.poisson(mean)
    # Bins of at least 50 expected, the ends open.
    edges = np.unique(law.ppf(np.linspace(0.001, 0.999, 60))) + 0.5
    observed = np.bincount(np.searchsorted(edges, drawn), minlength=len(edges) + 1)
    expected = np.diff(np.concatenate([[0.0], law.cdf(edges), [1.0]])) * count
    observed, expected = observed[expected > 50], expected[expected > 50]
    expected *= observed.sum() / expected.sum()
    assert scipy.stats.chisquare(observed, expected).pvalue > 1e-5


@pytest.mark.parametrize("well", [1.0, 100.0, 10500.0, 1e6])
def test_light_far_above_the_full_well_always_fills_it(well: float) -> None:
    sensor = Emva(full_well_e=well)
    flooded = with_shot_noise(np.full(1 << 18, 1e30), sensor, Noise.of(0, 0, 0).shot)
    assert flooded.min() >= well


def test_slightly_negative_radiance_is_black() -> None:
    dn = digital_numbers(np.full(100, -1e-6), 1.0, Emva(read_noise_e=0), Noise.of(0, 0, 0))
    assert set(dn) == {64}


def test_read_noise_has_its_standard_deviation_and_zero_mean() -> None:
    count = 1 << 20
    noise = with_read_noise(np.zeros(count), CAMERA, Noise.of(0, 0, 0).read)
    assert abs(noise.mean()) < FIVE_SIGMA * CAMERA.read_noise_e / np.sqrt(count)
    spread = noise.std() / CAMERA.read_noise_e
    assert abs(spread - 1) < FIVE_SIGMA / np.sqrt(2 * count)


@pytest.mark.parametrize(
    "sensor",
    [
        SimpleSensor(sigma_dn=3.0),
        SimpleSensor(bits=0, sigma_dn=0.2, black_level_dn=10.0),
        Emva(),
        Emva(bits=8, gain_dn_per_e=0.02, read_noise_e=60.0, black_level_dn=8.0),
        Emva(bits=0, dark_current_e_per_s=2e5),
        Emva(bits=16, gain_dn_per_e=4.0),
    ],
    ids=lambda s: f"{s.kind}-{s.bits}bit",
)
def test_mean_and_variance_are_what_the_sensor_promises(sensor: Emva | SimpleSensor) -> None:
    count = 1 << 18
    for fraction in (0.2, 0.5, 0.8):
        top = sensor.saturation_dn if np.isfinite(sensor.saturation_dn) else 200.0
        slope = float(sensor.mean_dn(1.0, 1.0) - sensor.mean_dn(0.0, 1.0))
        dark = float(sensor.mean_dn(0.0, 1.0))
        level = max(fraction * top - dark, 0.1 * top) / slope
        mean = float(sensor.mean_dn(level, 1.0))
        variance = float(sensor.variance_dn2(mean, 1.0))
        dn = frame(level, sensor, count).astype(float)
        assert abs(dn.mean() - mean) < FIVE_SIGMA * np.sqrt(variance / count)
        # Noise is nearly normal here: its variance is known to sqrt(2 / count).
        assert abs(dn.var() / variance - 1) < FIVE_SIGMA * np.sqrt(2 / count)


@pytest.mark.parametrize("sensor", [SimpleSensor(sigma_dn=0), SimpleSensor(bits=0, sigma_dn=0)])
def test_zero_sigma_gives_the_noise_free_image(sensor: SimpleSensor) -> None:
    light = np.random.default_rng(1).uniform(0, 200, 1000)
    noisy = digital_numbers(light, 1.0, sensor, Noise.of(0, 0, 0))
    assert np.array_equal(noisy, digital_numbers(light, 1.0, sensor))


def test_converter_rounds_and_clips_exactly() -> None:
    dn = np.array([-3.0, -0.2, 0.49, 0.51, 254.4, 254.6, 255.4, 256.0, 1e9, np.inf])
    assert digitised(dn.copy(), SimpleSensor()).tolist() == [0, 0, 0, 1, 254, 255, *[255] * 4]
    for bits, dtype in (
        (1, np.uint8),
        (8, np.uint8),
        (9, np.uint16),
        (12, np.uint16),
        (16, np.uint16),
    ):
        out = digitised(np.array([1e9]), SimpleSensor(bits=bits))
        assert out.dtype == dtype
        assert out[0] == 2**bits - 1
    whole = digitised(dn.copy(), SimpleSensor(bits=0))
    assert whole.dtype == np.float32
    assert np.array_equal(whole, dn.astype(np.float32))


def test_full_well_always_counts_as_saturated() -> None:
    # Read noise comes after the full well, so half of all full wells read below the full well's digital number.
    sensor = Emva(read_noise_e=8.0)
    assert sensor.saturation_dn < sensor.full_scale_dn
    full = frame(radiance_of(2 * sensor.full_well_e, sensor), sensor, 100_000)
    # Lower by 5 sigma: one in 3.5 million.
    assert (full >= sensor.saturation_dn).all()


def test_prnu_and_dsnu_have_their_spread_and_are_the_same_in_every_frame() -> None:
    sensor = Emva(bits=0, prnu=0.02, dsnu_e=5.0, dark_current_e_per_s=0.0)
    count = 1 << 18
    chip = fixed_pattern(sensor, 3, (1, count))
    assert chip is not None
    bound = FIVE_SIGMA / np.sqrt(2 * count)
    dark = digital_numbers(np.zeros(count), 1.0, sensor, pattern=chip)
    assert abs(dark.std(dtype=float) / (5.0 * sensor.gain_dn_per_e) - 1) < bound
    level = radiance_of(5000.0, sensor)
    bright = digital_numbers(np.full(count, level), 1.0, sensor, pattern=chip).astype(float)
    gain = (bright - dark) / (5000.0 * sensor.gain_dn_per_e)
    # dark and bright are float32 of up to 2000 DN: 1e-4 DN of rounding is far below the spread of 38 DN.
    assert abs(gain.std() / 0.02 - 1) < bound

    quiet = sensor.model_copy(update={"read_noise_e": 0.0, "bits": 16})
    a, b = (
        digital_numbers(np.full(count, level), 1.0, quiet, Noise.of(3, 0, f), chip) for f in (0, 1)
    )
    shared = np.corrcoef(a, b)[0, 1]
    # Fixed part (0.02 x 5000)^2 + 5^2, shot noise 5000 electrons^2.
    assert shared == pytest.approx(10025 / 15025, abs=FIVE_SIGMA / np.sqrt(count))
    other = fixed_pattern(sensor, 4, (1, count))
    assert other is not None
    assert not np.array_equal(chip.responsivity, other.responsivity)


def test_sensors_without_fixed_pattern_have_none() -> None:
    assert fixed_pattern(SimpleSensor(), 0, (1, 10)) is None
    assert fixed_pattern(Emva(), 0, (1, 10)) is None


@pytest.mark.parametrize("sensor", [SimpleSensor(bits=0), Emva(bits=0)], ids=lambda s: s.kind)
def test_seeds_exposures_and_frames_share_no_noise(sensor: Emva | SimpleSensor) -> None:
    count = 1 << 16
    level = 100.0 if isinstance(sensor, SimpleSensor) else radiance_of(4000.0)
    keys = list(itertools.product((0, 1), (0, 1, 2), (0, 1, 2)))
    drawn = [digital_numbers(np.full(count, level), 1.0, sensor, Noise.of(*key)) for key in keys]
    correlation = np.corrcoef(np.array(drawn, dtype=float))[np.triu_indices(len(keys), 1)]
    # 153 pairs at six sigma: one false alarm in 3 million runs.
    assert np.abs(correlation).max() < 6 / np.sqrt(count)
    again = digital_numbers(np.full(count, level), 1.0, sensor, Noise.of(*keys[4]))
    assert np.array_equal(again, drawn[4])


def test_neighbouring_pixels_share_no_noise() -> None:
    count = 1 << 18
    dn = frame(radiance_of(4000.0), CAMERA, count).astype(float)
    for lag in (1, 2, 64, 640):
        r = np.corrcoef(dn[lag:], dn[:-lag])[0, 1]
        assert abs(r) < FIVE_SIGMA / np.sqrt(count - lag)


@pytest.mark.parametrize("sensor", [SimpleSensor(), Emva(prnu=0.01)], ids=lambda s: s.kind)
def test_blocks_of_a_frame_equal_the_whole_frame(sensor: Emva | SimpleSensor) -> None:
    light = np.random.default_rng(2).uniform(0, 100, 10_001)
    chip = fixed_pattern(sensor, 0, (1, light.size))
    whole = digital_numbers(light, 1.0, sensor, Noise.of(5, 1, 2), chip)
    noise = Noise.of(5, 1, 2)
    blocks = [
        digital_numbers(light[s], 1.0, sensor, noise, chip[s] if chip else None)
        for s in (slice(0, 777), slice(777, 4000), slice(4000, None))
    ]
    assert np.array_equal(np.concatenate(blocks), whole)


@pytest.mark.parametrize(("bits", "clip"), [(8, 235.0), (12, 4080.0), (16, 65520.0)])
def test_converter_clips_below_its_bits_and_says_so(bits: int, clip: float) -> None:
    for sensor in (SimpleSensor(bits=bits, clip_dn=clip), Emva(bits=bits, clip_dn=clip)):
        assert sensor.saturation_dn <= sensor.full_scale_dn == clip
        assert digitised(np.array([1e9, clip - 1.0]), sensor).tolist() == [clip, clip - 1.0]


@pytest.mark.parametrize("curve", [(-0.05,), (0.02, -0.06), (0.0, 0.0, 0.1)])
def test_charge_is_read_by_the_curve_after_the_full_well(curve: tuple[float, ...]) -> None:
    sensor = Emva(bits=0, nonlinearity=curve, dark_current_e_per_s=0.0)
    share = np.array([0.0, 0.1, 0.5, 0.9, 1.0, 3.0])
    light = share * radiance_of(sensor.full_well_e, sensor)
    dn = digital_numbers(light, 1.0, sensor)
    x = np.minimum(share, 1.0)
    read = x * (1.0 + sum(c * x ** (k + 1) for k, c in enumerate(curve)))
    expected = sensor.black_level_dn + sensor.gain_dn_per_e * sensor.full_well_e * read
    np.testing.assert_allclose(dn, expected, rtol=1e-6)
    # A full well still counts as saturated: 5 sigma below what it reads as.
    full = sensor.gain_dn_per_e * (sensor.full_well_e * read[-1] - 5.0 * sensor.read_noise_e)
    assert sensor.saturation_dn == pytest.approx(sensor.black_level_dn + full)


@pytest.mark.parametrize("curve", [(-1.2,), (-0.6,), (float("inf"),)])
def test_curve_that_falls_is_refused(curve: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="nonlinearity"):
        Emva(nonlinearity=curve)


def test_line_noise_is_shared_in_a_line_and_independent_between_frames() -> None:
    sensor = Emva(row_noise_e=3.0, column_noise_e=5.0)
    shape = (1500, 2000)
    one, other = (LineNoise.of(sensor, 0, 0, f, shape) for f in (0, 1))
    assert one is not None and other is not None
    image = one[slice(0, shape[0] * shape[1])].reshape(shape)
    assert np.linalg.matrix_rank(image[:20, :20] - image[:20, :20].mean()) <= 2
    for axis, sigma in ((1, 3.0), (0, 5.0)):
        lines = image.mean(axis=axis)
        assert abs(lines.std() / sigma - 1.0) < FIVE_SIGMA / np.sqrt(2 * lines.size)
    for a, b in ((one.row_e, other.row_e), (one.column_e, other.column_e)):
        assert abs(np.corrcoef(a, b)[0, 1]) < FIVE_SIGMA / np.sqrt(len(a))
    assert np.array_equal(one[slice(1990, 4010)], image.ravel()[1990:4010])
    assert LineNoise.of(Emva(), 0, 0, 0, shape) is None


def test_hot_and_dead_pixels_have_their_shares() -> None:
    sensor = Emva(bits=0, hot_pixels=0.01, hot_current_e_per_s=400.0, dead_pixels=0.002)
    shape = (500, 800)
    chip = fixed_pattern(sensor, 1, shape)
    assert chip is not None and chip.dark_e_per_s is not None
    for share, found in ((0.002, chip.responsivity == 0), (0.01, chip.dark_e_per_s > 0)):
        scatter = np.sqrt(share / found.size)
        assert abs(found.mean() - share) < FIVE_SIGMA * scatter
    hot = chip.dark_e_per_s[chip.dark_e_per_s > 0]
    assert abs(hot.mean() / 400.0 - 1.0) < FIVE_SIGMA / np.sqrt(hot.size)
    assert scipy.stats.kstest(hot, scipy.stats.expon(scale=400.0).cdf).pvalue > 1e-5
    # Ten seconds in the dark, and light on dead pixels.
    dark = digital_numbers(np.zeros(chip.offset_e.size), 1e4, sensor, pattern=chip)
    expected = sensor.mean_dn(0.0, 1e4) + sensor.gain_dn_per_e * 10.0 * chip.dark_e_per_s
    full = sensor.black_level_dn + sensor.gain_dn_per_e * sensor.full_well_e
    np.testing.assert_allclose(dark, np.minimum(expected, full), rtol=1e-6)
    lit = digital_numbers(np.full(chip.offset_e.size, 5.0), 1.0, sensor, pattern=chip)
    assert (lit[chip.responsivity == 0] < 65.0).all()
