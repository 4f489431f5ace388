"""N-step phase shifting against closed forms, and its predicted noise against drawn noise."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import decode
from decode.phase.n_step import FringeSet, fringe_sets, solution
from scenes.acquisition.patterns import Frame, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from tests.decode.synthetic import digitise, frames

EPS = 2.0**-24


def equal_steps(steps: int) -> FringeSet:
    return fringe_sets(PhaseShift(steps=steps, periods_px=(16.0,)).frames(), 0)["column"][0]


@given(
    steps=st.integers(3, 24),
    offset=st.floats(0.0, 4000.0),
    modulation=st.floats(1.0, 4000.0),
    phase=st.floats(-np.pi, np.pi, exclude_max=True),
)
def test_least_squares_returns_offset_modulation_and_phase_for_any_step_count(
    steps: int, offset: float, modulation: float, phase: float
) -> None:
    fringes = equal_steps(steps)
    samples = offset + modulation * np.cos(phase + np.asarray(fringes.shifts_rad))
    mean, cosine, sine = solution(fringes) @ samples
    # float64 rounding of a sum of N terms.
    tolerance = 4.0 * steps * (offset + modulation) * 2.0**-52
    assert abs(mean - offset) < tolerance
    assert abs(cosine - modulation * np.cos(phase)) < tolerance
    assert abs(sine - modulation * np.sin(phase)) < tolerance


@given(st.lists(st.floats(0.0, 6.28), min_size=3, max_size=9), st.floats(-3.1, 3.1))
def test_unequal_steps_are_decoded_right_or_refused(shifts: list[float], phase: float) -> None:
    fringes = FringeSet("column", 16.0, tuple(range(len(shifts))), tuple(shifts))
    try:
        rows = solution(fringes)
    except DecodeError:
        return
    found = rows @ (100.0 + 50.0 * np.cos(phase + np.asarray(shifts)))
    # `solution` refuses singular values below 1e-6, which may amplify float64 rounding that much.
    assert np.allclose(
        found, [100.0, 50.0 * np.cos(phase), 50.0 * np.sin(phase)], rtol=0, atol=1e-6
    )


def test_four_steps_give_the_textbook_differences() -> None:
    rows = solution(equal_steps(4))
    assert np.allclose(rows[1], [0.5, 0, -0.5, 0], rtol=0, atol=4 * 2.0**-52)
    assert np.allclose(rows[2], [0, -0.5, 0, 0.5], rtol=0, atol=4 * 2.0**-52)


@settings(max_examples=20, deadline=None)
@given(
    steps=st.integers(3, 12),
    offset=st.floats(50.0, 200.0),
    ratio=st.floats(0.2, 1.0),
    seed=st.integers(0, 2**31),
)
def test_kernel_phase_agrees_with_the_ideal_fringe_to_float32_rounding(
    steps: int, offset: float, ratio: float, seed: int
) -> None:
    modulation = ratio * offset
    at = np.random.default_rng(seed).uniform(0.0, 16.0, (8, 16))
    shown = PhaseShift(steps=steps, periods_px=(16.0,)).frames()
    counts = frames({"column": at}, shown, offset, modulation).astype(np.float32)
    stack = Stack(counts[None], shown, (1.0,), SimpleSensor(sigma_dn=0, bits=0))
    rec = decode.reconstruct(stack, height="phase", unwrap="row-scan")
    assert (rec.wrapped_rad >= np.float32(-np.pi)).all()
    assert (rec.wrapped_rad < np.float32(np.pi)).all()
    error = np.angle(np.exp(1j * (rec.wrapped_rad - 2.0 * np.pi * at / 16.0)))
    # Every sample is rounded, and so is each of the N additions; Dr.Jit's atan2 is good to 1e-6.
    rounding = 2.0 * (steps + 2) * EPS * (offset + modulation)
    assert np.abs(error).max() < rounding / modulation + 1e-6
    assert np.abs(rec.modulation_dn - modulation).max() < rounding + 4 * EPS * modulation
    assert np.abs(rec.offset_dn - offset).max() < rounding


@pytest.mark.parametrize("steps", [3, 4, 5, 8])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_predicted_phase_noise_is_the_scatter(steps: int, dtype: type) -> None:
    rng = np.random.default_rng(steps)
    n, sigma, modulation = 40_000, 2.0, 60.0
    at = rng.uniform(0.0, 16.0, (200, n // 200))
    shown = PhaseShift(steps=steps, periods_px=(16.0,)).frames()
    counts = digitise(frames({"column": at}, shown, 120.0, modulation), sigma, dtype, rng)
    sensor = SimpleSensor(sigma_dn=sigma, bits=8 if dtype is np.uint8 else 0)
    stack = Stack(counts[None], shown, (1.0,), sensor)
    rec = decode.reconstruct(stack, height="phase", unwrap="row-scan")
    error = np.angle(np.exp(1j * (rec.wrapped_rad - 2.0 * np.pi * at / 16.0)))
    variance = 2.0 / steps * sensor.noise_model()[0] / modulation**2
    # Chi-square interval of 1e-6; linearising atan2 is wrong by a relative sigma_phi^2 = 6e-4 at most.
    low, high = (float(stats.chi2.ppf(p, n)) / n for p in (5e-7, 1 - 5e-7))
    assert low * (1 - 2e-3) < np.mean(error**2) / variance < high * (1 + 2e-3)


@pytest.mark.parametrize("shifts", [(0.0, np.pi), (0.0, 0.0, np.pi), (0.0, 0.0, 2 * np.pi)])
def test_fewer_than_three_different_shifts_are_refused_by_name(shifts: tuple[float, ...]) -> None:
    shown = tuple(Frame("column", 16.0, k, len(shifts), d) for k, d in enumerate(shifts))
    counts = np.full((1, len(shifts), 4, 4), 100, np.uint8)
    stack = Stack(counts, shown, (1.0,), SimpleSensor())
    with pytest.raises(DecodeError, match=r"column fringes of period 16 px .* three different"):
        decode.reconstruct(stack, height="phase")
