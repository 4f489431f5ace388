"""Close periods, unequal steps and bent responses."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import decode
from decode.order.heterodyne import ladder, widest_px
from decode.phase.gamma import estimate, harmonics
from decode.phase.n_step import fringe_sets, solution
from scenes.acquisition.patterns import Frame, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from tests.decode import synthetic
from tests.decode.order.test_gray_order import take
from tests.decode.synthetic import coordinates, hills, rig

COLUMN, ROW = coordinates(rig("pinhole", "pinhole", lenses=True), hills())


@given(st.lists(st.integers(6, 60), min_size=2, max_size=4, unique=True), st.floats(10.0, 3000.0))
@settings(max_examples=60, deadline=None)
def test_each_synthetic_period_is_the_beat_of_its_terms(periods: list[int], width: float) -> None:
    coarsest_first = sorted((float(p) for p in periods), reverse=True)
    rungs = ladder(coarsest_first, width)
    if rungs is None:
        return
    assert rungs[0].period_px >= width
    assert rungs[-1].terms == ((len(periods) - 1, 1),)
    assert all(a.period_px > b.period_px for a, b in pairwise(rungs))
    for rung in rungs:
        frequency = sum(c / coarsest_first[i] for i, c in rung.terms)
        assert rung.period_px * frequency == pytest.approx(1.0, rel=1e-9)


def test_no_beat_is_claimed_wide_enough_where_none_exists() -> None:
    assert ladder((20.0, 10.0), 21.0) is None


@pytest.mark.parametrize("periods", [(18.0, 21.0, 24.0), (24.0, 28.0, 31.0)])
def test_three_close_periods_measure_the_whole_projector(periods: tuple[float, ...]) -> None:
    stack = take(PhaseShift(steps=4, periods_px=periods), sigma_dn=1.0)
    rec = decode.reconstruct(stack, anchor="field", height="phase")
    sigma_px = periods[0] / (2 * np.pi) * 1.04 / (np.sqrt(2.0) * 80.0)
    assert rec.valid.mean() > 0.99
    # A slipped fringe would be 18 px.
    assert np.abs((rec.phases["column"].coordinate_px - COLUMN)[rec.valid]).max() < 6.0 * sigma_px


# Projector size and numbers of fringes whose beat is exactly that size, as textbooks and vendors choose them.
TEXTBOOK = [
    (1920, (40, 41)),
    (1920, (53, 58, 64)),
    (1024, (56, 63, 64)),
    (1024, (63, 64)),
    (1280, (59, 64, 70)),
    (912, (30, 35, 36)),
    (1920, (90, 99, 100)),
    (1140, (42, 48, 49)),
    (1920, (72, 80, 81)),
    (1280, (25, 26, 28)),
    (1024, (15, 16)),
    (1920, (54, 59, 60)),
    (800, (28, 32, 33)),
    (1280, (40, 41)),
    (854, (29, 30)),
    (640, (20, 24, 25)),
    (1824, (56, 57)),
    (1600, (59, 64, 70)),
    (1366, (35, 36)),
]


# Periods in px without a common factor, unique over their product (Gushov & Solodkin 1991): beats reach half of it at most.
COPRIME = [
    (483, (21.0, 23.0)),
    (1023, (31.0, 33.0)),
    (783, (27.0, 29.0)),
    (2145, (11.0, 13.0, 15.0)),
    (1920, (17.0, 19.0, 21.0)),
]


@pytest.mark.parametrize(("width", "periods"), COPRIME)
@pytest.mark.parametrize("sigma_dn", [0.01, 0.7])
def test_periods_without_a_common_factor_are_unique_over_their_product(
    width: int, periods: tuple[float, ...], sigma_dn: float
) -> None:
    """Noise of 0.7 DN in 80 is 1/1000 of a turn: a step that multiplies it by 64 slips at eight standard deviations."""
    assert widest_px(sorted(periods, reverse=True)) >= width * (1.0 - 1e-9)
    at = np.linspace(0.5, width - 0.5, 16384).reshape(128, 128)
    shown = PhaseShift(steps=4, periods_px=periods).frames()
    ideal = synthetic.frames({"column": at}, shown, 120.0, 80.0)
    noisy = ideal + np.random.default_rng(1).normal(0.0, sigma_dn, ideal.shape)
    sensor = SimpleSensor(bits=0, sigma_dn=sigma_dn)
    stack = Stack(
        noisy.astype(np.float32)[None], shown, (1.0,), sensor, projector_resolution=(width, width)
    )
    rec = decode.reconstruct(stack, height="phase")
    assert rec.order_known
    assert rec.valid.mean() > 0.999
    # An order error would be a whole period.
    assert np.abs(rec.phases["column"].coordinate_px - at)[rec.valid].max() < 5.0


def test_ladder_that_multiplies_noise_beyond_use_is_not_taken() -> None:
    """61 and 67 px are unique over 4087 px, by a step that multiplies noise by 190."""
    assert ladder((67.0, 61.0), 4000.0) is None
    assert widest_px((67.0, 61.0)) < 2000.0


@pytest.mark.parametrize(("width", "fringes"), TEXTBOOK)
@pytest.mark.parametrize("steps", [3, 4, 8])
def test_periods_whose_beat_is_the_projectors_size_decode_without_order_errors(
    width: int, fringes: tuple[int, ...], steps: int
) -> None:
    at = np.linspace(0.5, width - 0.5, 4096).reshape(64, 64)
    shown = tuple(
        Frame("column", width / count, k, steps, 2.0 * np.pi * k / steps)
        for count in fringes
        for k in range(steps)
    )
    frames = synthetic.frames({"column": at}, shown, 120.0, 80.0).astype(np.float32)
    sensor = SimpleSensor(bits=0, sigma_dn=0.01)
    stack = Stack(frames[None], shown, (1.0,), sensor, projector_resolution=(width, width))
    rec = decode.reconstruct(stack, height="phase")
    assert rec.valid.all() and rec.order_known
    # An order error would be a whole period, more than 10 px.
    assert np.abs(rec.phases["column"].coordinate_px - at).max() < 0.01


def test_periods_unique_over_less_than_the_projector_are_reported_with_the_range() -> None:
    assert widest_px((48.0, 1920 / 41)) == pytest.approx(1920.0)
    at = np.linspace(0.5, 1899.5, 4096).reshape(64, 64)
    shown = tuple(
        Frame("column", period, k, 3, 2.0 * np.pi * k / 3)
        for period in (1900 / 40, 1900 / 41)
        for k in range(3)
    )
    frames = synthetic.frames({"column": at}, shown, 120.0, 80.0).astype(np.float32)
    stack = Stack(frames[None], shown, (1.0,), SimpleSensor(bits=0), projector_resolution=(1920, 1))
    with pytest.raises(DecodeError, match="unique over 1900 px at most"):
        decode.reconstruct(stack, height="phase", anchor="field")
    assert not decode.reconstruct(stack, height="phase").order_known


def test_unequal_steps_give_the_phase_of_equal_ones() -> None:
    shifts = (0.0, 0.9, 2.1, 3.0, 4.9)
    stack = take(PhaseShift(steps=5, periods_px=(16.0, 128.0), shifts_rad=shifts), sigma_dn=1.0)
    rec = decode.reconstruct(stack)
    error = (rec.phases["column"].coordinate_px - COLUMN)[rec.valid]
    assert rec.valid.mean() > 0.99
    # Least squares is unbiased: mean within 4 standard errors of 0, scatter as the normal equations predict.
    assert abs(error.mean()) < 4.0 * error.std() / np.sqrt(error.size)
    rows = np.linalg.pinv(np.stack([np.ones(5), np.cos(shifts), -np.sin(shifts)], axis=1))
    gain = ((rows[1] ** 2).sum() + (rows[2] ** 2).sum()) / 2.0
    sigma_px = 16.0 / (2 * np.pi) * np.sqrt(gain * (1.0 + 1.0 / 12.0)) / 80.0
    assert error.std() == pytest.approx(sigma_px, rel=0.05)


def bent(
    gamma: float, steps: int, sigma_dn: float = 1.0, seed: int = 3
) -> tuple[Stack, np.ndarray]:
    """Fringes through a gamma, many periods over a large image."""
    patterns = PhaseShift(steps=steps, periods_px=(16.0,))
    u = np.linspace(3.0, 330.0, 400)[None] + np.linspace(0.0, 11.0, 300)[:, None]
    rng = np.random.default_rng(seed)
    shown = patterns.frames()
    ideal = np.stack([20.0 + 200.0 * patterns.commanded(f, u) ** gamma for f in shown])
    counts = np.clip(np.round(ideal + rng.normal(0.0, sigma_dn, ideal.shape)), 0, 255)
    return Stack(counts[None].astype(np.uint8), shown, (1.0,), SimpleSensor(sigma_dn=sigma_dn)), u


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
@pytest.mark.parametrize("gamma", [0.6, 1.0, 1.8, 2.4])
def test_gamma_is_read_from_the_harmonics(steps: int, gamma: float) -> None:
    stack, _ = bent(gamma, steps)
    found = harmonics(stack, fringe_sets(stack.patterns, 0)["column"][0])
    # The histogram of three steps sees how evenly the surface samples the fringe: 20.4 fringes leave a few per mille of
    # second harmonic, 0.02 of gamma; more steps see it in every pixel.
    assert found.gamma == pytest.approx(gamma, abs=0.05 if steps == 3 else 0.005)


@pytest.mark.parametrize("steps", [3, 4, 5])
@pytest.mark.parametrize("gamma", [0.6, 1.8, 2.4])
def test_gamma_correction_removes_the_waves_from_the_phase(steps: int, gamma: float) -> None:
    stack, u = bent(gamma, steps, sigma_dn=0.1)

    def worst(**choices: Any) -> float:
        rec = decode.reconstruct(stack, height="phase", unwrap="quality-guided", **choices)
        miss = np.angle(np.exp(1j * (rec.phases["column"].wrapped_rad - 2 * np.pi * u / 16.0)))
        return float(np.sqrt(np.mean(miss**2)))

    raw, known = worst(), worst(gamma=gamma)
    # Rounding and noise, 0.31 DN, on the modulation that each phase has; straightening stretches them.
    fringes = fringe_sets(stack.patterns, 0)["column"][0]
    true = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    levels = 200.0 * (0.5 + 0.5 * np.cos(true + np.array(fringes.shifts_rad)[:, None])) ** gamma
    _, c, s = solution(fringes) @ levels
    straightening = 1.0 / np.gradient(np.unwrap(np.arctan2(s, c)), true)
    raw_noise = np.sqrt(2.0 / steps) * 0.31 / np.hypot(c, s)
    noise = np.sqrt(np.mean((raw_noise * straightening) ** 2))
    assert known == pytest.approx(noise, rel=0.1)
    # The estimate's error, 0.05 of gamma with three steps, moves the phase by 0.05 / (gamma + 2) at most.
    allowed = 0.02 if steps == 3 else 0.002
    assert worst(gamma="estimate") < noise + allowed
    assert estimate(stack) == pytest.approx(gamma, abs=0.05 if steps == 3 else 0.005)
    # Three steps pass the second harmonic on, four the third.
    if steps < 5:
        assert raw > (10.0 if steps == 3 else 1.5) * np.sqrt(np.mean(raw_noise**2))
