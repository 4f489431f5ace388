"""Fusion rules against closed forms, optimisers and drawn noise."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, stats

import decode
from decode.device import Device
from decode.fusion.censored_likelihood import mills
from decode.fusion.interface import MaxModulation
from decode.fusion.merging import MaxModulationOfRepeats, MeanOfSets, PhasorSum
from decode.phase.n_step import fringe_sets
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import Emva, Sensor, SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

Map = NDArray[np.float64]
# All that use several exposures of a pixel, or choose one for each.
HDR = [rule for rule in decode.rules() if rule not in ("single", "auto-exposure")]
# Linear heights of 1 px = 1 rad: sigma_mm is then the predicted sigma of the phase.
PERIOD_PX, C_PX_PER_MM = 16.0, 16.0 / (2.0 * np.pi)


def capture(
    phase: Map,
    offset: float,
    modulation: float,
    times_ms: Sequence[float],
    sensor: Sensor,
    seed: int,
    steps: int = 4,
) -> Stack:
    """Frames of a fringe of `offset` and `modulation` DN/ms above black, with the sensor's noise and limits."""
    rng = np.random.default_rng(seed)
    shown = PhaseShift(steps=steps, periods_px=(PERIOD_PX,)).frames()
    frames = np.empty((len(times_ms), steps, *phase.shape))
    for e, time_ms in enumerate(times_ms):
        for f in shown:
            mean = time_ms * (offset + modulation * np.cos(phase + f.phase_shift_rad))
            if isinstance(sensor, Emva):
                electrons = rng.poisson(np.maximum(mean, 0.0) / sensor.gain_dn_per_e)
                electrons = np.minimum(electrons, sensor.full_well_e)
                noisy = electrons + rng.normal(0.0, sensor.read_noise_e, phase.shape)
                dn = sensor.black_level_dn + sensor.gain_dn_per_e * noisy
            else:
                dn = sensor.black_level_dn + mean + rng.normal(0.0, sensor.sigma_dn, phase.shape)
            frames[e, f.step] = dn
    if sensor.bits:
        frames = np.clip(np.rint(frames), 0, sensor.full_scale_dn)
    return Stack(frames.astype(sensor.dtype), shown, tuple(times_ms), sensor)


def phases(stack: Stack, fusion: Any) -> decode.Reconstruction:
    return decode.reconstruct(
        stack, fusion=fusion, unwrap="row-scan", height="linear", c_px_per_mm=C_PX_PER_MM
    )


def errors(rec: decode.Reconstruction, phase: Map) -> Map:
    """Phase errors of the pixels a fusion rule calls usable."""
    usable = rec.reason != decode.Reason.SATURATED
    return np.where(usable, np.angle(np.exp(1j * (rec.wrapped_rad - phase))), np.nan)


def all_phases(rows: int, columns: int) -> Map:
    """Every row has all phases, evenly."""
    one = 2.0 * np.pi * (np.arange(columns) + 0.5) / columns - np.pi
    return np.tile(one, (rows, 1))


def test_mills_ratio_is_scipys_over_its_whole_range() -> None:
    device = Device.open()
    z = np.linspace(-30.0, 30.0, 60_001).astype(np.float32)
    found = mills(device, device.types.Float(z)).numpy()
    true = np.exp(stats.norm.logpdf(z.astype(np.float64)) - stats.norm.logcdf(z.astype(np.float64)))
    # The polynomial's 1.2e-7, and float32's exp and squares of z, a few units in the last place.
    assert np.max(np.abs(found - true) / np.maximum(true, 1.0)) < 1e-6


def test_rules_that_choose_take_the_exposure_they_say() -> None:
    phase = all_phases(8, 64)
    sensor = SimpleSensor(sigma_dn=0.5)
    # Peaks at 55, 110, 220 and (clipped) 440 DN.
    stack = capture(phase, 30.0, 25.0, (2.0, 8.0, 4.0, 1.0), sensor, seed=0)
    assert (phases(stack, "brightest-unsaturated").exposure == 2).all()
    assert (phases(stack, "auto-exposure").exposure == 2).all()
    # A spot of 1 pixel in 512 that clips at once does not shorten the exposure of all, one of 64 does.
    stack.frames[:3, :, 0, 0] = 255
    assert (phases(stack, "auto-exposure").exposure[1:] == 2).all()
    stack.frames[:3, :, 0] = 255
    assert (phases(stack, "auto-exposure").exposure == 3).all()


def test_merging_radiance_is_adding_phasors() -> None:
    phase = all_phases(16, 128)
    stack = capture(phase, 200.0, 150.0, (1.0, 4.0, 16.0), Emva(), seed=1)
    one, other = phases(stack, "radiance-merge"), phases(stack, "phasor-sum")
    # float32 rounding of one common factor.
    assert np.abs(np.angle(np.exp(1j * (one.wrapped_rad - other.wrapped_rad)))).max() < 1e-6
    np.testing.assert_allclose(one.sigma_mm, other.sigma_mm, rtol=1e-6)
    # The largest mean of 16 ms is 5600 DN, beyond saturation; of 4 ms it is 1400.
    np.testing.assert_allclose(one.offset_dn - 64.0, 800.0, rtol=0.1)
    np.testing.assert_allclose(other.offset_dn - 64.0, 1000.0, rtol=0.1)


def test_all_rules_are_the_n_step_phase_where_there_is_nothing_to_fuse() -> None:
    phase = all_phases(16, 128)
    stack = capture(phase, 100.0, 80.0, (1.0,), SimpleSensor(sigma_dn=2.0), seed=2)
    base = phases(stack, "single").wrapped_rad
    for rule in HDR:
        off = np.angle(np.exp(1j * (phases(stack, rule).wrapped_rad - base)))
        assert np.abs(off).max() < 2e-6, rule


def test_unrounded_samples_are_not_censored_at_zero() -> None:
    """A sensor without bits does not clip at 0, so negative samples count as they are."""
    phase = np.random.default_rng(8).uniform(-np.pi, np.pi, (40, 50))
    stack = capture(phase, 25.0, 30.0, (1.0,), SimpleSensor(sigma_dn=1.0, bits=0), seed=9)
    assert (stack.frames < 0.0).mean() > 0.1
    one, two = (phases(stack, rule) for rule in ("censored-ml", "masked-least-squares"))
    np.testing.assert_array_equal(one.wrapped_rad, two.wrapped_rad)


@pytest.mark.parametrize("rule", ["single", *HDR])
@pytest.mark.parametrize(
    ("sensor", "steps"),
    [(Emva(), 3), (Emva(), 4), (SimpleSensor(bits=12, black_level_dn=64.0, sigma_dn=8.0), 5)],
    ids=["shot-3", "shot-4", "constant-5"],
)
def test_predicted_sigma_is_the_scatter_within_3_percent(
    sensor: Sensor, rule: str, steps: int
) -> None:
    phase = all_phases(100, 400)
    # The longest exposure peaks at 3500 DN, five standard deviations below saturation.
    stack = capture(phase, 220.0, 200.0, (0.8, 2.0, 8.0), sensor, seed=steps, steps=steps)
    rec = phases(stack, rule)
    assert rec.valid.all()
    ratio = np.sqrt(np.mean(errors(rec, phase) ** 2 / rec.sigma_mm.astype(np.float64) ** 2))
    # 40 000 chi-square values scatter by 0.35 %; predictions themselves are noisy, by a few 1e-4.
    assert abs(ratio - 1.0) < 0.03
    # With three steps a phase's noise differs by a factor of 2 between phases: each is to be right.
    by_phase = np.mean(errors(rec, phase) ** 2 / rec.sigma_mm.astype(np.float64) ** 2, axis=0)
    thirds = by_phase.reshape(8, 50).mean(axis=1)  # 5000 values: 2 % each, 5 sigma.
    assert np.abs(thirds - 1.0).max() < 0.1


def test_least_squares_is_the_weighted_fit_that_numpy_makes() -> None:
    rng = np.random.default_rng(5)
    phase = rng.uniform(-np.pi, np.pi, (1, 64))
    times = (1.0, 3.0, 9.0)
    sensor = SimpleSensor(sigma_dn=2.0)
    stack = capture(phase, 60.0, 50.0, times, sensor, seed=6)
    found = phases(stack, "masked-least-squares")
    shifts = np.asarray(fringe_sets(stack.patterns, 0)["column"][0].shifts_rad)
    for i in range(phase.size):
        rows, samples = [], []
        for e, time_ms in enumerate(times):
            for n, shift in enumerate(shifts):
                if stack.frames[e, n, 0, i] < 255:
                    rows.append([time_ms, time_ms * np.cos(shift), -time_ms * np.sin(shift)])
                    samples.append(float(stack.frames[e, n, 0, i]))
        (_, c, s), *_ = np.linalg.lstsq(np.array(rows), np.array(samples))
        covariance = np.linalg.inv(np.array(rows).T @ np.array(rows)) * (4.0 + 1.0 / 12.0)
        across = np.array([0.0, -s, c]) / (c * c + s * s)
        # float32 sums of 12 samples of up to 255 DN, over a modulation of 50 DN/ms.
        assert abs(np.angle(np.exp(1j * (found.wrapped_rad[0, i] - np.arctan2(s, c))))) < 3e-6
        sigma = np.sqrt(across @ covariance @ across)
        assert found.sigma_mm[0, i] == pytest.approx(sigma, rel=1e-4)


def test_censored_likelihood_is_at_the_maximum_that_scipy_finds() -> None:
    rng = np.random.default_rng(7)
    phase = rng.uniform(-np.pi, np.pi, (1, 48))
    times, sigma2 = (1.0, 4.0), 9.0 + 1.0 / 12.0
    # Clipped above in the long exposure, below in the short one.
    stack = capture(phase, 45.0, 44.0, times, SimpleSensor(sigma_dn=3.0), seed=8)
    found = phases(stack, "censored-ml")
    shifts = np.asarray(fringe_sets(stack.patterns, 0)["column"][0].shifts_rad)
    dn = stack.frames[:, :, 0].astype(np.float64)
    assert (dn == 255).any() and (dn == 0).any()
    for i in range(phase.size):

        def loss(p: Map, dn: Map = dn[..., i]) -> float:
            mu = np.outer(times, p[0] + p[1] * np.cos(shifts) - p[2] * np.sin(shifts))
            terms = -((dn - mu) ** 2) / (2.0 * sigma2)
            terms = np.where(dn >= 255, stats.norm.logcdf((mu - 254.5) / sigma2**0.5), terms)
            terms = np.where(dn <= 0, stats.norm.logcdf((0.5 - mu) / sigma2**0.5), terms)
            return -float(terms.sum())

        start = [45.0, 44.0 * np.cos(phase[0, i]), 44.0 * np.sin(phase[0, i])]
        best = optimize.minimize(loss, start, method="BFGS", options={"gtol": 1e-8})
        true = np.arctan2(best.x[2], best.x[1])
        off = np.angle(np.exp(1j * (found.wrapped_rad[0, i] - true)))
        # The last Newton step moved it by less than SETTLED = 1e-2 sigma, the next would by about the square.
        assert abs(off) < 1e-3 * found.sigma_mm[0, i] + 3e-6


@pytest.mark.parametrize("rule", ["inverse-variance", "masked-least-squares", "censored-ml"])
def test_masked_samples_leave_no_bias(rule: str) -> None:
    """The longest exposure clips at half of its phases; `single` errs by 0.1 rad there."""
    phase = all_phases(400, 64)
    stack = capture(phase, 60.0, 55.0, (1.0, 2.0, 3.5), SimpleSensor(sigma_dn=2.0), seed=9)
    error = errors(phases(stack, rule), phase)
    mean = error.mean(axis=0)
    # Scatter of a mean of 400, of 64 such: 4.5 sigma; the edge of saturation truncates noise, which biases a
    # masked sample by some tenths of its sigma.
    limit = 4.5 * error.std(axis=0).max() / 20.0 + 0.15 * error.std(axis=0).max()
    assert np.abs(mean).max() < limit
    ignored = decode.reconstruct(
        stack, fusion="single", exposure=2, saturation="ignore", height="phase", unwrap="row-scan"
    )
    naive = np.angle(np.exp(1j * (ignored.wrapped_rad - phase))).mean(axis=0)
    assert np.abs(naive).max() > 5.0 * limit


def test_three_clipped_steps_of_one_exposure_are_never_called_usable() -> None:
    """Peaks at 2.5 times saturation, N = 4: at most two steps survive, and the clipped ones are far beyond."""
    phase = all_phases(50, 64)
    stack = capture(phase, 320.0, 318.0, (1.0,), SimpleSensor(sigma_dn=2.0), seed=10)
    survivors = (stack.frames[0] < 255).sum(axis=0)
    for rule in HDR:
        with pytest.raises(DecodeError, match="saturated"):
            phases(stack, rule)
    # A short exposure next to it makes all of them measurable.
    both = capture(phase, 320.0, 318.0, (1.0, 0.25), SimpleSensor(sigma_dn=2.0), seed=10)
    assert survivors.max() <= 2
    for rule in HDR:
        assert phases(both, rule).valid.all()


def test_clipped_samples_near_the_limit_decide_what_the_others_leave_open() -> None:
    """One step is at the limit in 24 exposures, so about half of them clip: how many shows where it is."""
    phase = np.zeros((40, 100))
    # N = 3 at phase 0: step 0 at 254.5 DN, steps 1 and 2 far below.
    stack = capture(phase, 154.5, 100.0, (1.0,) * 24, SimpleSensor(sigma_dn=6.0), seed=11, steps=3)
    rec = phases(stack, "censored-ml")
    modulation = rec.modulation_dn.astype(np.float64)
    masked = phases(stack, "masked-least-squares").modulation_dn.astype(np.float64)
    # 4000 means of 24 samples; keeping only unclipped ones lowers step 0 by 0.8 sigma = 4.8 DN, B by 2/3 of it.
    assert abs(modulation.mean() - 100.0) < 5.0 * modulation.std() / np.sqrt(4000) + 0.05
    assert masked.mean() < 100.0 - 2.5


def test_samples_clipped_at_zero_are_censored() -> None:
    """Fringes of 4 +- 4 DN under 3 DN of noise: a third of the samples clips at 0."""
    phase = all_phases(200, 64)
    stack = capture(phase, 4.0, 4.0, (1.0,) * 16, SimpleSensor(sigma_dn=3.0), seed=12)
    true, masked = (
        phases(stack, rule).modulation_dn.astype(np.float64).mean()
        for rule in ("censored-ml", "masked-least-squares")
    )
    assert masked < 3.6
    # |Z| is Rician: B + sigma_B^2 / (2 B) with sigma_B^2 = 2 sigma^2 / 64, or more by what clipping takes of the
    # information, at most half; the mean of 12 800 scatters by 0.005.
    rice = 2.0 * (9.0 + 1.0 / 12.0) / 64.0 / (2.0 * 4.0)
    assert rice - 0.02 < true - 4.0 < 2.0 * rice + 0.02


def test_of_repeated_times_the_one_of_largest_modulation_is_taken() -> None:
    times_ms, sensor = (1.0, 4.0, 1.0), SimpleSensor(sigma_dn=0.5)
    phase = all_phases(4, 64)
    for offset, clipped in ((30.0, False), (60.0, True)):
        rec = phases(capture(phase, offset, 20.0, times_ms, sensor, 1), MaxModulationOfRepeats())
        # Noise of 0.5 DN and rounding: 0.58 sqrt(2/4) DN of B = 80, or of B = 20 by half of that where two are averaged.
        sigma_rad = 0.58 * np.sqrt(0.5) / (20.0 * np.sqrt(2.0) if clipped else 80.0)
        assert float(np.std(errors(rec, phase))) == pytest.approx(sigma_rad, rel=0.2)


def test_times_without_repeats_are_not_added() -> None:
    stack = capture(all_phases(4, 64), 20.0, 15.0, (1.0, 4.0, 2.0), SimpleSensor(sigma_dn=2.0), 1)
    one, other = (phases(stack, rule) for rule in (MaxModulationOfRepeats(), MaxModulation()))
    np.testing.assert_array_equal(one.wrapped_rad, other.wrapped_rad)
    # Rounding of another order of sums.
    np.testing.assert_allclose(one.sigma_mm, other.sigma_mm, rtol=1e-5)


def test_mean_of_two_sets_has_the_phase_and_the_modulation_of_both() -> None:
    phase = all_phases(4, 64)
    stack = capture(phase, 100.0, 80.0, (1.0,), SimpleSensor(sigma_dn=0.0), seed=1, steps=8)
    rec = phases(stack, MeanOfSets())
    # Rounding errs by half a digital number at most; half a turn of steps fits a modulation to a few of these.
    np.testing.assert_allclose(rec.modulation_dn, 80.0, atol=2.0)
    assert np.abs(errors(rec, phase)).max() < 2.0 / 80.0


def test_sum_of_repeats_is_their_mean() -> None:
    phase = all_phases(8, 64)
    stack = capture(phase, 100.0, 80.0, (1.0,) * 5, SimpleSensor(sigma_dn=2.0), seed=13)
    mean = stack.frames.mean(axis=0, dtype=np.float64)
    z = np.tensordot(np.exp(-2j * np.pi * np.arange(4) / 4), mean, axes=(0, 0))
    found = phases(stack, PhasorSum()).wrapped_rad
    assert np.abs(np.angle(np.exp(1j * (found - np.angle(z))))).max() < 2e-6
