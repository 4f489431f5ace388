"""Stages of optics and time through `render.trace` and `render.expose`, against closed forms.

A failure points to the stage in the test's name.
"""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

import render
from scenes import Scene
from scenes.acquisition.sensor import Emva
from tests.render import rigs
from tests.render.blur.test_image_borders import (
    test_phase_of_outermost_pixels_is_that_in_a_larger_image as test_image_borders,
)
from tests.render.blur.test_point_spread import (
    F_NUMBERS,
    PITCH_UM,
    WAVELENGTH_UM,
    airy_edge,
    edge_scene,
    sensor,
)
from tests.render.blur.test_point_spread import (
    test_encircled_energy_is_that_of_an_airy_disc as test_encircled_energy,
)
from tests.render.plugins.test_projector_pixels import FILL, SIGMA_PX
from tests.render.test_bit_planes import (
    test_phase_error_equals_that_of_a_simulation_of_single_mirrors as test_bit_planes,
)
from tests.render.test_illumination_map import (
    test_map_of_a_polynomial_is_that_polynomial as test_illumination_map,
)
from tests.render.test_motion import (
    test_phase_of_a_moving_slope_is_its_closed_form as test_conveyor,
)
from tests.render.test_rolling_shutter import (
    test_rows_meet_the_bit_planes_of_their_own_time as test_rolling_shutter,
)
from tests.render.test_unsteady_light import QUIET, phase, plain
from tests.render.test_unsteady_light import (
    test_light_of_a_source_fluctuates_from_picture_to_picture as test_fluctuation,
)
from tests.trust import chance

Floats = NDArray[np.float64]
Figure = Any
pytestmark = pytest.mark.trust
# Closed forms that every run checks are part of this suite, too.
__all__ = [
    "test_bit_planes", "test_conveyor", "test_encircled_energy", "test_fluctuation", "test_illumination_map",
    "test_image_borders", "test_rolling_shutter",
]  # fmt: skip


@pytest.mark.parametrize("f_number", F_NUMBERS)
def test_edge_of_a_rendered_plate_is_airy_and_pixel(
    f_number: float, record_property: Figure
) -> None:
    light = render.trace(edge_scene(64 * 4), samples=1024, depth=1)
    lens = sensor(f_number, dark_current_e_per_s=0.0)
    white = render.expose(light, sensor=lens, noise=False, subpixels=4).frames[0, -2]
    assert white.shape == (32, 64)
    level = white[:, 45:55].mean()
    x_um = np.asarray((np.arange(64.0) + 0.5 - 32.11) * PITCH_UM)
    expected = airy_edge(x_um, f_number, PITCH_UM)
    near = np.abs(x_um) < 12 * PITCH_UM
    # 1024 places in a sixteenth of a pixel, over 32 rows: the edge is known to 1e-3.
    plateau = airy_edge(x_um[45:55], f_number, PITCH_UM).mean()
    seen = white.mean(axis=0) / level * plateau
    off = np.abs(seen - expected)[near].max()
    record_property("figure", f"off by up to {off:.2%} of the edge")
    assert off < 0.01


def uniform(model: str, period_px: float) -> tuple[Scene, float]:
    """A plane on which a camera pixel spans the same projector pixels everywhere, and how many.

    Two pinholes look straight down from one height; parallel light may be tilted.
    """
    step = (30.0 / 256) / (80.0 / 128)
    down = {"pose": {"origin_mm": (0.0, 0.0, 200.0)}}
    aside = {"pose": {"origin_mm": (-20.0, 0.0, 200.0), "target_mm": (-20.0, 0.0, 0.0)}}
    kind = {"fill_factor": FILL, "psf_sigma_px": SIGMA_PX}
    if model == "pinhole":
        camera = rigs.pinhole((256, 64), field_mm=30.0) | down
        light = rigs.pinhole_projector(resolution=(128, 96), field_mm=80.0, **kind, **aside)
    else:
        camera = rigs.telecentric((256, 64), field_mm=30.0) | down
        light = rigs.telecentric_projector(resolution=(128, 96), field_mm=80.0, **kind)
        step *= 200.0 / np.hypot(80.0, 200.0)
    patterns = {"periods_px": (period_px,), "steps": 4}
    return rigs.scene(camera, light, objects=rigs.plane(), depth=1, patterns=patterns), step


@pytest.mark.parametrize("period_px", [3.0, 4.0, 6.0, 12.0])
@pytest.mark.parametrize("model", ["pinhole", "telecentric"])
def test_fringe_contrast_is_that_of_projector_pixel_camera_pixel_and_lens(
    model: str, period_px: float, record_property: Figure
) -> None:
    """Square and Gaussian of the projector, square of the camera, diffraction of its lens, each at the fringe's frequency."""
    scene, step = uniform(model, period_px)
    lens = Emva(psf="diffraction", bits=0, full_well_e=1e12, black_level_dn=0.0, f_number=11.0)
    light = render.trace(scene, samples=256)
    frames = render.expose(light, sensor=lens, noise=False).frames[0].astype(np.float64)
    phase = 2 * np.pi * step * np.arange(256) / period_px
    # Whole fringes in the middle of the image, away from its borders.
    fringes = int(200 * step / period_px)
    columns = slice(28, 28 + round(fringes * period_px / step))
    waves = ((frames[0] - frames[2]) + 1j * (frames[3] - frames[1])) / 2.0
    level = frames[:, :, columns].mean()
    # The fundamental alone: other orders are other frequencies.
    first = np.abs((waves * np.exp(-1j * phase))[:, columns].mean(axis=1)).mean()
    s = step / period_px * (0.589 * 11.0) / 3.45
    pupil = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    projector = np.sinc(np.sqrt(FILL) / period_px) * np.exp(
        -2 * (np.pi * SIGMA_PX / period_px) ** 2
    )
    expected = projector * np.sinc(step / period_px) * pupil
    record_property("figure", f"contrast {expected:.3f}, {first / level / expected - 1:+.2%}")
    assert first / level == pytest.approx(expected, rel=0.01)


def test_height_of_a_vibrating_scene_scatters_by_061_of_it(record_property: Figure) -> None:
    """Four steps: ``sum of (sin^2(phi + k pi / 2) / 2)^2`` averages to 3/8 over phi, so 0.612 of the jitter."""
    scene = plain(vibration_um=1.0)
    transport = render.trace(scene, samples=16)
    slope = render.height_slope(transport)
    still = phase(render.expose(transport, sensor=QUIET, noise=False).frames[0].astype(np.float64))
    per_mm = 2.0 * np.pi / 16 / (72.0 / 128) * 80.0 / np.hypot(80.0, 200.0)
    times = [1.0] * 250
    errors_um = []
    for seed in range(16):
        stack = render.expose(transport, seed, QUIET, times, slope=slope)
        off = phase(stack.frames.astype(np.float64)) - still
        errors_um.append(((off + np.pi) % (2 * np.pi) - np.pi) / per_mm * 1e3)
    rms = float(np.sqrt(np.mean(np.square(errors_um))))
    record_property("figure", f"{rms:.4f} of it, {rms / np.sqrt(3 / 8) - 1:+.2%}")
    # 4000 repeats of some three independent numbers each know it to 0.7 %.
    assert rms == pytest.approx(np.sqrt(3 / 8), rel=0.03)


@pytest.mark.parametrize("exposure_ms", [0.1, 3.0, 17.0])
def test_flicker_of_ambient_light_is_averaged_by_the_exposure(
    exposure_ms: float, record_property: Figure
) -> None:
    """Of depth d and frequency f an exposure of T keeps ``d |sinc(f T)|``, at a phase of its own: variance half its square."""
    scene = plain(ambient__flicker_depth=0.3, ambient__flicker_hz=100.0)
    light = render.trace(scene, samples=4)
    still = render.expose(light, sensor=QUIET, exposures=[exposure_ms], noise=False).frames[0]
    seeds = chance.seeds(4, "flicker", exposure_ms)
    taken = [render.expose(light, s, QUIET, [exposure_ms] * 250).frames for s in seeds]
    mean = light.ambient.astype(np.float64) * exposure_ms
    share = ((np.concatenate(taken) - still.astype(np.float64)) / mean).mean(axis=(2, 3))
    kept = 0.3 * abs(np.sinc(0.1 * exposure_ms))
    # A cosine's square has a variance of an eighth.
    z = (share.var() - kept**2 / 2) / (kept**2 / np.sqrt(8 * share.size))
    record_property("figure", f"depth {np.sqrt(2 * share.var()) / kept - 1:+.2%}")
    assert chance.two_sided(np.array([z]))[0] > chance.ALPHA / 3


def test_speckle_shifts_phase_as_its_closed_form(record_property: Figure) -> None:
    """Light appears displaced by ``C wavelength / (2 pi sin u)`` (Dorsch et al. 1994), which a pixel averages.

    The mean over a square of side p of a field correlated as ``mu(r) = (2 J1(v) / v)^2`` has the share of its variance
    ``4 int int mu (1 - x)(1 - y)``, in units of p.
    """
    contrast, f_number = 0.1, 8.0
    scene = plain(
        projectors__0__speckle_contrast=contrast,
        camera__resolution=[64, 48],
        ambient__radiance_w_m2_sr=0.0,
    )
    transport = render.trace(scene, samples=16)
    lens = sensor(f_number, psf="none")
    how: dict[str, Any] = {"sensor": lens, "noise": False, "exposures": [1.0]}
    still = phase(render.expose(transport, **how).frames[0].astype(np.float64))
    seen = [render.expose(transport, seed, **how, steady=False).frames[0] for seed in range(24)]
    off = np.angle(np.exp(1j * (phase(np.array(seen, np.float64)) - still)))
    # Radians per pixel, as central differences have it.
    turn = 2.0 * np.pi / 16 * (60.0 / 64) / (72.0 / 128) * 200.0 / np.hypot(80.0, 200.0)
    x = (np.arange(1000) + 0.5) / 1000
    v = np.pi * np.hypot(x[:, None], x) * PITCH_UM / (WAVELENGTH_UM * f_number)
    kept = 4.0 * np.mean((2.0 * j1(v) / v) ** 2 * (1.0 - x[:, None]) * (1.0 - x))
    displaced = contrast * WAVELENGTH_UM * f_number / (np.pi * PITCH_UM) * np.sqrt(kept)
    inside = off[:, 2:-2, 2:-2]
    expected = np.sin(turn) * displaced
    record_property("figure", f"{inside.std() / expected - 1:+.2%} of the closed form")
    # Some 24 x 3000 / 3 independent grains know a deviation to 0.5 %; the differences' second order is C^2 / 2 of it.
    assert inside.std() == pytest.approx(expected, rel=0.02)
    # The grain itself, ten times as large, cancels.
    level = np.array(seen, np.float64).mean(axis=1)
    assert (level.std(axis=0) / level.mean(axis=0)).mean() == pytest.approx(
        contrast * np.sqrt(kept), rel=0.05
    )
