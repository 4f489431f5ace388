"""Scenes on a conveyor: pictures against shifted pictures, and phases against the closed form of a moving slope."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
from scenes import Scene
from scenes.support.errors import RenderError
from tests.render import rigs
from tests.render.test_unsteady_light import QUIET, phase

Floats = NDArray[np.float64]
# Telecentric: 64 pixels over 60 mm.
PIXEL_UM = 60e3 / 64


def moving(conveyor_um: tuple[float, float], tilt_deg: float = 0.0, **more: Any) -> Scene:
    """A box on a large plate, or a tilted plate alone, under parallel light and seen by parallel rays."""
    step = {"kind": "box", "size_mm": (12.0, 16.0, 5.0)}
    box = {"label": "step", "material": "white-paint", "shape": step, "position_mm": (3.0, 4.0, 0.0)}  # fmt: skip
    plate = rigs.plane()[0] | {"rotation_deg": (0.0, tilt_deg, 0.0)}
    scene = rigs.scene(
        rigs.telecentric((64, 48)),
        rigs.telecentric_projector(),
        objects=[plate] if tilt_deg else [plate, box],
        depth=1,
        patterns={"steps": 4},
    )
    dumped: Any = scene.model_dump(mode="json", exclude_unset=True)
    return Scene.model_validate(dumped | {"conveyor_um": conveyor_um} | more)


def taken(light: render.Transport, times_ms: list[float], **how: Any) -> Floats:
    stack = render.expose(light, sensor=QUIET, noise=False, exposures=times_ms, **how)
    return np.asarray(stack.frames / np.array(times_ms)[:, None, None, None], np.float64)


@pytest.mark.parametrize(("right", "up"), [(2, 0), (0, -1), (-3, 2)])
def test_motion_by_whole_pixels_shifts_evenly_lit_frames_by_as_many(right: int, up: int) -> None:
    """The mean of four steps is the light of an even projector, which moves with the scene: shadows, edges and all."""
    shape = {"kind": "gray-code", "bits": (1,), "cell_px": 64.0, "inverted": False}
    scene = moving((right * PIXEL_UM, up * PIXEL_UM), patterns=shape)
    light = render.trace(scene, samples=256)
    times = [1.0, 2.0]
    frames = taken(light, times)
    still = taken(light, times, steady=True)
    # Of three frames (bit, white, black) and two exposures, white has the pictures 2 and 3 of 0 to 5: half a step from the
    # middle each. Two exposures of one pattern are a step apart.
    inside = slice(4, -4)
    early, late = frames[0, 1], frames[1, 1]
    shifted = np.roll(early, (-up, right), axis=(0, 1))
    # A pixel on an edge draws its own 256 places, which know its share to 0.5 / 16; the rest is the same but for rounding.
    off = np.abs(late - shifted)[inside, inside] / still.max()
    assert np.median(off) < 1e-6
    assert off.max() < 0.5 / 16
    assert np.abs(late - early)[inside, inside].mean() / still.max() > 10 * off.mean()


def test_phase_of_a_moving_slope_is_its_closed_form() -> None:
    """A slope of gradient s that moves by d a picture sinks by s d at each place, and its fringes go on by as much."""
    d_um, tilt = 120.0, 10.0
    scene = moving((d_um, 0.0), tilt, height_range_mm=[-20.0, 20.0])
    light = render.trace(scene, samples=64)
    steady = phase(taken(light, [1.0], steady=True)[0])
    found = phase(taken(light, [1.0])[0])
    # A plate turned about y by a positive angle falls towards +x.
    rise_mm = np.tan(np.deg2rad(tilt)) * d_um * 1e-3
    turn = 2.0 * np.pi / 16 / (72.0 / 128) * 80.0 / np.hypot(80.0, 200.0)
    drift = turn * rise_mm * (np.arange(4) - 1.5)
    expected = []
    for sign in (1.0, -1.0):
        waves = [np.cos(steady + k * np.pi / 2 + sign * drift[k]) for k in range(4)]
        off = found - phase(np.array(waves))
        expected.append(np.abs(np.angle(np.exp(1j * off)))[4:-4, 4:-4])
    error = np.abs(np.angle(np.exp(1j * (found - steady))))[4:-4, 4:-4]
    # Contrast and shading are those of the place; what is left is float32's phase of light at 64 samples.
    assert min(e.max() for e in expected) < 0.02 * error.max()
    # Drift about the middle of four steps leaves a ripple of half a step.
    assert error.max() == pytest.approx(turn * rise_mm / 2, rel=0.02)


def test_steady_frames_leave_out_motion_and_moved_lights_must_suffice() -> None:
    scene = moving((50.0, 0.0))
    light = render.trace(scene, samples=2)
    plain = render.trace(scene.model_copy(update={"conveyor_um": (0.0, 0.0)}), samples=2)
    np.testing.assert_array_equal(taken(light, [1.0], steady=True), taken(plain, [1.0]))
    pictures = list(render.conveyed(light, [0] * 8))
    own = taken(light, [1.0, 3.0])
    np.testing.assert_array_equal(own, taken(light, [1.0, 3.0], moved=pictures))
    assert (own[0, 0] != own[1, 0]).any()
    with pytest.raises(RenderError, match="fewer lights"):
        taken(light, [1.0, 3.0], moved=pictures[:-1])


def test_each_picture_has_the_light_of_its_projector() -> None:
    """Two projectors that show the same: their pictures differ, as they do when the scene is still."""
    scene = moving((1e-6, 0.0))
    other = scene.projectors[0].model_copy(update={"irradiance_w_m2": 50.0})
    both = scene.model_copy(update={"projectors": (scene.projectors[0], other)})
    light = render.trace(both, samples=4)
    frames = taken(light, [1.0])[0]
    np.testing.assert_allclose(frames, taken(light, [1.0], steady=True)[0], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(frames[4:], frames[:4] / 2.0, rtol=1e-4, atol=1e-4)
