"""Pixels and points through the plugins, against OpenCV and against the scene's own double-precision geometry."""

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import render
from render.variant import mi
from scenes.emission import PinholeProjector
from scenes.rig import Pinhole
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
    return pixels.reshape(-1, 2) + 0.5


def points_mm(count: int = 2000) -> NDArray[np.float64]:
    return np.random.default_rng(1).uniform([-90, -70, -5], [90, 70, 15], (count, 3))


def emitter(scene: Any) -> Any:
    return render.mitsuba_scene(scene).emitters()[0]


def sample(plugin: Any, points: NDArray[np.float64]) -> Any:
    it = mi.Interaction3f(0.0, 0.0, [], mi.Point3f(*points.T.astype(np.float32)))
    return plugin.sample_direction(it, mi.Point2f(0.5))


def test_projector_plugin_reads_the_pixel_opencv_projects_to() -> None:
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


def test_camera_plugin_looks_where_opencv_says_the_pixel_came_from() -> None:
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
def test_light_comes_from_the_device_and_falls_as_stated(model: Any) -> None:
    scene = rigs.scene(rigs.pinhole(), model(resolution=(1024, 768)))
    projector = scene.projectors[0]
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
