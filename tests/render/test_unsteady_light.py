"""Light that changes from picture to picture, against closed forms: vibration, fluctuation, flicker."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
from render.laser_speckle import speckle
from render.unsteady_light import moment
from scenes import Scene
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.support.errors import RenderError
from tests.render import rigs

Floats = NDArray[np.float64]
QUIET = SimpleSensor(bits=0, sigma_dn=0.0)


def plain(**more: Any) -> Scene:
    """Paint under parallel light, seen by parallel rays: four steps of 16 px."""
    scene = rigs.scene(
        rigs.telecentric((16, 12)),
        rigs.telecentric_projector(),
        objects=rigs.plane(),
        depth=1,
        ambient=5.0,
        patterns={"steps": 4},
    )
    dumped: Any = scene.model_dump(mode="json", exclude_unset=True)
    for key, value in more.items():
        place = dumped
        *folders, last = key.split("__")
        for folder in folders:
            place = place[int(folder)] if folder.isdigit() else place[folder]
        place[last] = value
    return Scene.model_validate(dumped)


def phase(frames: Floats) -> Floats:
    """Of four steps, (..., row, col)."""
    a = np.moveaxis(frames, -3, 0)
    return np.asarray(np.arctan2(a[3] - a[1], a[0] - a[2]))


def test_slope_is_the_change_of_light_with_height() -> None:
    scene = plain(vibration_um=1.0)
    transport = render.trace(scene, samples=64)
    slope = render.height_slope(transport)
    # The channel's phase at a point moves by dz tan(22 degrees) cos over the projector's pixel.
    pixel_mm = 72.0 / 128
    turn = 2.0 * np.pi / 16 / pixel_mm * 80.0 / np.hypot(80.0, 200.0)
    cos, sin = transport.total[0, 1:3].astype(np.float64)
    moved = slope.total[0, 1:3].astype(np.float64)
    sign = np.sign(np.sum(-moved[0] * sin))
    # The difference's own error is (turn h)^2 / 6 with h = 0.01 mm; tens of roundings of 6e-8 in radiance, over h.
    atol = np.abs(cos).max() * (turn * (turn * 0.01) ** 2 / 6 + 30 * 6e-8 / 0.01)
    np.testing.assert_allclose(moved[0], -sign * turn * sin, atol=atol)
    np.testing.assert_allclose(moved[1], sign * turn * cos, atol=atol)


def test_vibration_without_a_slope_traces_its_own() -> None:
    transport = render.trace(plain(vibration_um=2.0), samples=4)
    own = render.expose(transport, seed=3, sensor=QUIET)
    given = render.expose(transport, seed=3, sensor=QUIET, slope=render.height_slope(transport))
    np.testing.assert_array_equal(own.frames, given.frames)
    assert (own.frames != render.expose(transport, seed=4, sensor=QUIET).frames).any()
    # Without noise there is none of this either.
    clean = render.expose(transport, sensor=QUIET, noise=False)
    steady = render.expose(render.trace(plain(), samples=4), sensor=QUIET, noise=False)
    np.testing.assert_array_equal(clean.frames, steady.frames)


def test_light_of_a_source_fluctuates_from_picture_to_picture() -> None:
    scene = plain(projectors__0__fluctuation=0.02, ambient__radiance_w_m2_sr=0.0)
    transport = render.trace(scene, samples=4)
    mean = render.expose(transport, sensor=QUIET, noise=False).frames[0].astype(np.float64)
    # A stack holds up to 255 exposures.
    times = [1.0] * 250
    taken = np.concatenate([render.expose(transport, s, QUIET, times).frames for s in range(4)])
    gains = taken.astype(np.float64) / mean
    # One gain for each picture.
    assert np.ptp(gains, axis=(2, 3)).max() < 1e-5
    gain = gains[:, :, 0, 0]
    assert abs(gain.std() / 0.02 - 1) < 5 / np.sqrt(2 * gain.size)
    assert abs(gain.mean() - 1) < 5 * 0.02 / np.sqrt(gain.size)
    correlation = np.corrcoef(gain.T)[np.triu_indices(gain.shape[1], 1)]
    assert np.abs(correlation).max() < 5 / np.sqrt(len(gain))


@pytest.mark.parametrize("exposure_ms", [0.1, 3.0, 10.0, 17.0])
def test_flicker_averages_over_the_exposure(exposure_ms: float) -> None:
    """Of depth d and frequency f an exposure of T keeps ``d |sinc(f T)|``: none where it spans whole periods."""
    scene = plain(ambient__flicker_depth=0.3, ambient__flicker_hz=100.0)
    found = np.array([moment(scene, 0, e, 0, 0, exposure_ms).ambient for e in range(4000)])
    kept = 0.3 * abs(np.sinc(0.1 * exposure_ms))
    assert found.mean() == pytest.approx(1.0, abs=5 * kept / np.sqrt(2 * found.size) + 1e-12)
    # A cosine of random phase has the variance 1/2, and its square's is 1/8.
    assert found.var() == pytest.approx(
        kept**2 / 2, abs=5 * kept**2 / np.sqrt(8 * found.size) + 1e-12
    )


def test_flicker_changes_ambient_light_alone() -> None:
    scene = plain(ambient__flicker_depth=0.5, ambient__flicker_hz=50.0)
    transport = render.trace(scene, samples=4)
    steady = render.expose(transport, sensor=QUIET, noise=False).frames[0].astype(np.float64)
    frames = render.expose(transport, 2, QUIET, [1.0] * 4).frames.astype(np.float64)
    share = (frames - steady) / transport.ambient
    assert np.ptp(share, axis=(2, 3)).max() < 1e-4
    assert share.std() > 0.1


def test_flicker_of_no_amplitude_changes_nothing() -> None:
    transport = render.trace(plain(), samples=4)
    calm = render.trace(plain(ambient__flicker_hz=50.0, vibration_um=0.0), samples=4)
    a, b = (render.expose(light, seed=5, sensor=Emva(psf="none")) for light in (transport, calm))
    np.testing.assert_array_equal(a.frames, b.frames)


def test_speckle_follows_its_seed_keeps_the_mean_and_needs_a_lens() -> None:
    scene = plain(projectors__0__speckle_contrast=0.2)
    transport = render.trace(scene, samples=4)
    lens = Emva(bits=0, full_well_e=1e12)
    how: dict[str, Any] = {"sensor": lens, "noise": False, "exposures": [1.0]}
    one, again, other = (
        render.expose(transport, seed, **how, steady=False).frames for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.allclose(one, other, rtol=0.05)
    # Without noise there is none of it, and its mean is that light.
    still = render.expose(transport, **how).frames
    assert one.mean() == pytest.approx(still.mean(), rel=0.05)
    with pytest.raises(RenderError, match="emva1288"):
        render.expose(transport, sensor=QUIET)


@pytest.mark.parametrize("lens", [{"pixel_um": 1e300}, {"pixel_um": 1e-300}, {"f_number": 1e300}])
def test_speckle_of_extreme_lenses_is_finite(lens: dict[str, float]) -> None:
    for field in speckle(Emva(**lens), 0.5, (5, 8), np.random.default_rng(0)):
        assert np.isfinite(field).all()
