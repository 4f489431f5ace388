"""Bit planes of a micromirror device against a plain calculation of mirrors in time."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
import scenes
from scenes.support.errors import RenderError, SceneError
from tests.render.test_unsteady_light import QUIET, phase, plain

Floats = NDArray[np.float64]
FRAME_MS = 3.0
DEVICE: dict[str, Any] = {"projectors__0__bits": 8, "projectors__0__frame_ms": FRAME_MS}


def mirrors_on(level: NDArray[np.int64], exposure_ms: float, start_ms: float, ticks: int) -> Floats:
    """Share of an exposure in which mirrors that show a level (...) of 0 to 255 are on, sampled at so many midpoints.

    A frame is 255 slots: 128 of the bit worth 128, then 64 of that worth 64, and so on.
    """
    bits = np.repeat([7, 6, 5, 4, 3, 2, 1, 0], [128, 64, 32, 16, 8, 4, 2, 1])
    at_ms = start_ms + (np.arange(ticks) + 0.5) * exposure_ms / ticks
    slot = np.floor(at_ms / FRAME_MS % 1.0 * 255.0).astype(np.int64) % 255
    times = np.bincount(bits[slot], minlength=8) / ticks
    return np.asarray(sum(times[bit] * ((level >> bit) & 1) for bit in range(8)))


def taken(light: render.Transport, times_ms: list[float], **how: Any) -> Floats:
    stack = render.expose(light, sensor=QUIET, exposures=times_ms, **{"noise": False, **how})
    frames = stack.frames.astype(np.float64) / np.array(times_ms)[:, None, None, None]
    return np.asarray(frames)


def device_light(**more: Any) -> render.Transport:
    """Light that pixels' centres see, each of one projector pixel."""
    scene = plain(ambient__radiance_w_m2_sr=0.0, **{**DEVICE, **more})
    return render.trace(scene, samples=4, footprint=0.0)


def test_parts_of_a_frame_show_parts_of_its_planes() -> None:
    light = device_light()
    steady = taken(light, [1.0], steady=True)[0]
    white = steady.max() / (127.5 + 127.5 * np.cos(np.pi / 16)) * 255.0
    level = np.rint(steady / white * 255.0).astype(np.int64)
    # The brightest of 16 pixels a fringe is at cos(pi / 16); levels are whole, but for float32.
    np.testing.assert_allclose(steady / white * 255.0, level, atol=0.5)
    white = (steady.sum() / level.sum()) * 255.0
    np.testing.assert_allclose(steady / white * 255.0, level, atol=1e-3)
    times = [0.1, 1.0, 1.6, 4.0, 7.5]
    for exposure_ms, frames in zip(times, taken(light, times), strict=True):
        expected = mirrors_on(level, exposure_ms, 0.0, 100_000)
        # Sampling errs by a tick at each of up to 8 changes of a plane in each of 3 frames.
        np.testing.assert_allclose(frames / white, expected, atol=24e-5 + 1e-5)


@pytest.mark.parametrize("triggered", [True, False])
def test_exposures_of_whole_frames_have_no_error(triggered: bool) -> None:
    light = device_light(projectors__0__triggered=triggered)
    steady = taken(light, [1.0], steady=True)
    for seed in range(3):
        whole = taken(light, [FRAME_MS, 7 * FRAME_MS], seed=seed, steady=False)
        np.testing.assert_allclose(whole, np.repeat(steady, 2, axis=0), rtol=1e-6)
    # The light is that of a steady projector of as many bits.
    plainly = render.trace(device_light().scene.model_copy(update={"projectors": (_steady(),)}), samples=4, footprint=0.0)  # fmt: skip
    np.testing.assert_allclose(steady, taken(plainly, [1.0]), rtol=1e-5)
    assert len(plainly.bases[0].channels) < len(light.bases[0].channels)


def _steady() -> Any:
    return plain(projectors__0__bits=8).projectors[0]


def test_exposures_that_start_anywhere_keep_the_mean_and_their_seed() -> None:
    light = device_light(projectors__0__triggered=False)
    mean = taken(light, [1.0])[0]
    np.testing.assert_array_equal(mean, taken(light, [1.0], steady=True)[0])
    one, two, again = (taken(light, [4.0], seed=s, steady=False) for s in (1, 2, 1))
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, two, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("periods", "rms_rad"), [(2.5, 0.0576), (10.5, 0.0142), (20.5, 0.0076)])
def test_phase_error_equals_that_of_a_simulation_of_single_mirrors(
    periods: float, rms_rad: float
) -> None:
    light = device_light(projectors__0__triggered=False)
    still = phase(taken(light, [1.0], steady=True)[0])
    times = [periods * FRAME_MS] * 250
    errors = [phase(taken(light, times, seed=s, steady=False)) - still for s in range(4)]
    found = float(np.sqrt(np.mean(np.angle(np.exp(1j * np.array(errors))) ** 2)))

    rng = np.random.default_rng(0)
    at = np.pi / 16 + np.arange(16) * np.pi / 8
    steps = np.arange(4) * np.pi / 2
    level = np.rint(127.5 + 127.5 * np.cos(at + steps[:, None])).astype(np.int64)
    quiet = phase(level[..., None].astype(np.float64))
    off = []
    for _ in range(1000):
        starts = rng.uniform(0.0, FRAME_MS, 4)
        shown = [mirrors_on(n, times[0], s, 4000) for n, s in zip(level, starts, strict=True)]
        off.append(phase(np.array(shown)[..., None]) - quiet)
    expected = float(np.sqrt(np.mean(np.angle(np.exp(1j * np.array(off))) ** 2)))
    # 1000 sets of four starts each side; errors are bounded, so that an RMS is known to some 2 %.
    assert found == pytest.approx(expected, rel=0.08)
    assert found == pytest.approx(rms_rad, rel=0.08)


def test_planes_outside_the_traced_span_are_refused() -> None:
    light = device_light()
    other = scenes.PhaseShift(steps=3, periods_px=(16.0,))
    assert taken(light, [2.0], patterns=other.model_copy(update={"steps": 8})).shape[1] == 8
    with pytest.raises(RenderError, match="traced"):
        taken(light, [2.0], patterns=scenes.PhaseShift(steps=3, periods_px=(19.0,)))


def test_devices_without_bits_or_with_a_curve_are_refused() -> None:
    for wrong in ({"projectors.0.bits": 0}, {"projectors.0.bits": 8, "projectors.0.gamma": 2.2}):
        with pytest.raises(SceneError, match="bit planes are linear"):
            scenes.load("step", {"projectors.0.frame_ms": 4.0, **wrong})
