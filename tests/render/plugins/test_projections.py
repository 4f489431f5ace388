"""Pixels and points through the plugins, against OpenCV and against the scene's own double-precision geometry."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import render
from render.fringe_phasor import white_weights
from render.plugins.lens import optics
from render.plugins.variant import mi, use
from scenes.acquisition.pattern_basis import basis
from scenes.acquisition.patterns import PhaseShift
from scenes.rig.devices import Pinhole
from scenes.rig.projectors import PinholeProjector, Screen
from tests.render import rigs
from tests.render.rigs import DISTORTION

# A float32 image coordinate near 1024 is known to 6e-5 px; a dozen roundings on the way to it.
FLOAT32_PX = 12 * 6.1e-5


def wide_angle() -> PinholeProjector:
    entries = rigs.pinhole_projector(
        resolution=(1024, 768), field_mm=150.0, distortion=DISTORTION, cx_px=500.3, cy_px=391.8
    )
    return PinholeProjector.model_validate(entries)


def opencv_pixels(device: Pinhole, points: NDArray[np.float64]) -> NDArray[np.float64]:
    p = device.projection()
    # OpenCV's pixel centres are integers, ours integer + 0.5.
    k = np.array([[p.fx, 0, p.cx - 0.5], [0, p.fy, p.cy - 0.5], [0, 0, 1]])
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(p.R)[0], p.t, k, np.array(p.distortion))
    return np.asarray(pixels.reshape(-1, 2) + 0.5, np.float64)


def points_mm(count: int = 2000) -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform([-90, -70, -5], [90, 70, 15], (count, 3))


def emitter(scene: Any) -> Any:
    return render.mitsuba_scene(scene).emitters()[0]


def sample(plugin: Any, points: NDArray[np.float64]) -> Any:
    it = mi.Interaction3f(0.0, 0.0, [], mi.Point3f(*points.T.astype(np.float32)))
    return plugin.sample_direction(it, mi.Point2f(0.5))


def test_projector_plugin_and_opencv_project_to_the_same_pixel() -> None:
    projector = wide_angle()
    scene = rigs.scene(rigs.pinhole(), projector.model_dump())
    points = points_mm()
    expected = opencv_pixels(projector, points)
    ds, _ = sample(emitter(scene), points)

    pixels, lit = np.array(ds.uv).T, np.array(ds.pdf) > 0
    inside = ((expected >= 0) & (expected < projector.resolution)).all(axis=1)
    # Both kinds occur, else this proves nothing.
    assert 0.2 < inside.mean() < 0.98
    edge = np.abs(expected - np.clip(expected, 0, projector.resolution)).max(axis=1) < FLOAT32_PX
    assert (lit == inside)[~edge | inside].mean() > 0.999
    np.testing.assert_allclose(pixels[inside], expected[inside], atol=FLOAT32_PX, rtol=0)


def test_opencv_projects_points_of_camera_plugin_rays_to_their_pixel() -> None:
    camera = Pinhole.model_validate(
        rigs.pinhole((1024, 768), field_mm=150.0, distortion=DISTORTION, cy_px=391.8)
    )
    scene = rigs.scene(camera.model_dump(), rigs.pinhole_projector())
    sensor = render.mitsuba_scene(scene).sensors()[0]
    expected = np.random.default_rng(2).uniform((0, 0), camera.resolution, (2000, 2))
    place = mi.Point2f(*(expected / camera.resolution).T.astype(np.float32))
    ray, _ = sensor.sample_ray(0.0, 0.5, place, mi.Point2f(0.5))

    points = np.array(ray(200.0)).T
    np.testing.assert_allclose(opencv_pixels(camera, points), expected, atol=FLOAT32_PX, rtol=0)


@pytest.mark.parametrize("model", [rigs.pinhole_projector, rigs.telecentric_projector])
def test_irradiance_has_the_stated_direction_and_falloff(model: Any) -> None:
    scene = rigs.scene(rigs.pinhole(), model(resolution=(1024, 768)))
    projector = scene.projectors[0]
    assert not isinstance(projector, Screen)
    geometry = projector.projection()
    points = points_mm()
    pixels, depth = geometry.project(points)
    inside = ((pixels > 0.1) & (pixels < np.array(projector.resolution) - 0.1)).all(axis=1)
    ds, value = sample(emitter(scene), points)

    towards = np.array(ds.d).T[inside]
    cosine = -towards @ geometry.axis
    fall = 1.0 if geometry.telecentric else (200.0 / depth[inside]) ** 2
    fringe = 0.5 + 0.5 * np.cos(2 * np.pi * pixels[inside, 0] / 16.0)
    expected = projector.irradiance_w_m2 * fall / cosine * fringe
    # A pixel known to FLOAT32_PX shifts a 16 px fringe of half amplitude by at most pi / 16 of it.
    np.testing.assert_allclose(
        np.array(value)[0][inside], expected, atol=150 * np.pi / 16 * FLOAT32_PX, rtol=1e-5
    )
    assert inside.sum() > 200


@pytest.mark.parametrize("model", [rigs.pinhole_projector, rigs.telecentric_projector])
def test_projector_vignetting_dims_light_by_its_pixel(model: Any) -> None:
    points = points_mm()
    uneven = {"vignetting": (-0.4, 0.1), "evenness": (0.02, -0.03, -0.1, 0.05, -0.2)}
    scenes_ = [rigs.scene(rigs.pinhole(), model(**keys)) for keys in ({}, uneven)]
    device = scenes_[0].projectors[0]
    (ds, plain), (_, dimmed) = (sample(emitter(scene), points) for scene in scenes_)
    lit = (np.array(ds.pdf) > 0) & (np.array(plain)[0] > 0)
    pixels, _ = device.projection().project(points)
    size = np.array(device.resolution)
    r2 = ((pixels - size / 2) ** 2).sum(axis=1) / (size**2 / 4).sum()
    assert lit.sum() > 200
    u, v = (pixels / size * 2 - 1).T
    plane = 1 + 0.02 * u - 0.03 * v - 0.1 * u**2 + 0.05 * u * v - 0.2 * v**2
    np.testing.assert_allclose(
        np.array(dimmed)[0][lit] / np.array(plain)[0][lit],
        ((1 - 0.4 * r2 + 0.1 * r2**2) * plane)[lit],
        rtol=1e-4,
    )


@pytest.mark.parametrize("vignetting", [(-1.0,), (-0.2, -0.9), (float("nan"),)])
def test_vignetting_without_light_is_refused(vignetting: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="vignetting"):
        rigs.scene(rigs.pinhole(vignetting=vignetting), rigs.pinhole_projector())
    with pytest.raises(ValueError, match="evenness"):
        rigs.scene(rigs.pinhole(evenness=(0.9, 0.2, 0, 0, 0)), rigs.pinhole_projector())


def test_rays_of_a_telecentric_aperture_have_length_one_and_fill_its_cone() -> None:
    use()
    lens = {"numerical_aperture": 0.5, "focus_mm": 100.0}
    device = optics(rigs.scene(rigs.telecentric(lens=lens), rigs.pinhole_projector()).camera)
    samples = np.random.default_rng(0).random((2, 2000)).astype(np.float32)
    x, y, z = np.array(device._cone(mi.Point2f(samples)))
    np.testing.assert_allclose(x**2 + y**2 + z**2, 1.0, atol=1e-6)
    # Uniform over a disk of radius 1/2: r^2 has the mean 1/8, which 2000 draws know to 1.3 %.
    assert (x**2 + y**2).max() <= 0.25 + 1e-6
    assert np.mean(x**2 + y**2) == pytest.approx(0.125, rel=0.07)


def test_white_is_the_constant_channel() -> None:
    emitted = rigs.scene(rigs.pinhole(), rigs.pinhole_projector()).projectors[0]
    found = basis(PhaseShift(periods_px=(16.0, 64.0)), emitted, emitted.resolution)
    np.testing.assert_array_equal(white_weights(found), [1.0, 0.0, 0.0, 0.0, 0.0])
