"""Rows of a rolling shutter against closed forms: the flicker, the patterns and the bit planes that each row meets."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
from scenes.acquisition.sensor import Emva
from tests.render.test_bit_planes import DEVICE, FRAME_MS, mirrors_on
from tests.render.test_unsteady_light import plain

Floats = NDArray[np.float64]
ROWS = 12
LIGHT_MS = 2.0


def sensor(row_time_us: float) -> Emva:
    """Without noise, blur, dark current and rounding; DN are electrons."""
    ideal: dict[str, Any] = {"bits": 0, "full_well_e": 1e12, "black_level_dn": 0.0, "gain_dn_per_e": 1.0}  # fmt: skip
    return Emva(psf="none", dark_current_e_per_s=0.0, row_time_us=row_time_us, **ideal)


def taken(light: render.Transport, row_time_us: float, times_ms: list[float], **how: Any) -> Floats:
    """Radiance (exposure, frame, row, col), by the time exposed."""
    stack = render.expose(light, sensor=sensor(row_time_us), exposures=times_ms, **{"noise": False, **how})  # fmt: skip
    per_ms = float(sensor(0.0).mean_electrons(1.0, 1.0))
    radiance = np.asarray(stack.frames, np.float64) / per_ms
    return np.asarray(radiance / np.array(times_ms)[:, None, None, None])


@pytest.mark.parametrize("overhead_ms", [0.0, 0.5, 5.0])
def test_rows_that_begin_late_see_the_next_pattern_as_well(overhead_ms: float) -> None:
    """A pattern stays for all its exposures and the overhead after the last; the last pattern stays."""
    row_ms, times = 0.25, [1.0, LIGHT_MS]
    light = render.trace(plain(acquisition={"overhead_ms": overhead_ms}), samples=4)
    still, rolled = (taken(light, 1e3 * row, times) for row in (0.0, row_ms))
    np.testing.assert_allclose(rolled[0], still[0], rtol=1e-6)
    late = np.clip(row_ms * np.arange(ROWS) - overhead_ms, 0.0, LIGHT_MS) / LIGHT_MS
    following = np.concatenate([still[1, 1:], still[1, -1:]])
    expected = (1.0 - late)[:, None] * still[1] + late[:, None] * following
    np.testing.assert_allclose(rolled[1], expected, rtol=1e-6)
    assert (late[-1] > 0.0) == (np.abs(rolled[1] - still[1]).max() > 0.1)


def test_rows_meet_the_flicker_of_their_own_time() -> None:
    """Rows a quarter of a period apart have cosine and sine of one phase: their squares add up to ``(d sinc(f T))^2``."""
    depth, hz = 0.4, 100.0
    flickers = {"radiance_w_m2_sr": 5.0, "flicker_depth": depth, "flicker_hz": hz}
    light = render.trace(plain(ambient=flickers), samples=4)
    # Three rows are 2.5 ms. No pattern changes before the last row has ended.
    row_us, seeds = 2500.0 / 3, range(6)
    still = taken(light, 0.0, [LIGHT_MS])[0]
    kept = depth * np.sinc(hz * LIGHT_MS * 1e-3)
    phases = []
    for seed in seeds:
        frames = taken(light, row_us, [LIGHT_MS], seed=seed, steady=False)[0]
        share = ((frames - still) / light.ambient).mean(axis=2)[-1]
        turns = np.arange(ROWS) * row_us * 1e-6 * hz * 2.0 * np.pi
        cosine, sine = share[:-3], -share[3:]
        np.testing.assert_allclose(np.hypot(cosine, sine), kept, rtol=1e-4)
        phase = np.unwrap(np.arctan2(sine, cosine))
        np.testing.assert_allclose(phase - phase[0], turns[:-3], atol=1e-3)
        phases.append(phase[0])
    assert np.ptp(phases) > 0.5


def test_rows_meet_the_bit_planes_of_their_own_time() -> None:
    """Mirrors that start with each picture, seen from a row's delay on; the next pattern starts its own frame."""
    row_ms, exposure_ms = 0.3, 2.0
    scene = plain(**DEVICE, acquisition={"overhead_ms": 1.0}, ambient={"radiance_w_m2_sr": 0.0})
    light = render.trace(scene, samples=4, footprint=0.0)
    even = taken(light, 0.0, [7 * FRAME_MS])[0]
    # Levels are whole numbers of 255, the same in all rows.
    white = even.max() / np.rint(127.5 + 127.5 * np.cos(np.pi / 16)) * 255.0
    level = np.rint(even / white * 255.0).astype(np.int64)
    np.testing.assert_allclose(even / white * 255.0, level, atol=1e-3)
    found = taken(light, 1e3 * row_ms, [exposure_ms])[0] / white
    for row in range(ROWS):
        delay_ms = row * row_ms
        late_ms = min(max(delay_ms - 1.0, 0.0), exposure_ms)
        own_ms = exposure_ms - late_ms
        begin_ms = max(delay_ms - exposure_ms - 1.0, 0.0)
        expected = np.zeros(level.shape[-1])
        for of, length_ms, start_ms in ((0, own_ms, delay_ms), (1, late_ms, begin_ms)):
            if length_ms:
                expected += length_ms * mirrors_on(level[of, row], length_ms, start_ms, 100_000)
        # Sampling errs by a tick at each of up to 8 changes of a plane in each of 2 frames, twice.
        np.testing.assert_allclose(found[0, row], expected / exposure_ms, atol=4e-4)


def test_all_rows_at_once_are_a_global_shutter() -> None:
    light = render.trace(plain(), samples=4)
    one, other = (render.expose(light, 3, Emva(row_time_us=row)).frames for row in (0.0, 1e-9))
    np.testing.assert_array_equal(one, other)
