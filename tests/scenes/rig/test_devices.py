"""Rig geometry against OpenCV and against itself."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.rig.devices import Extrinsics, LookAt, Pinhole, Telecentric
from scenes.rig.projection import distort, monotone_radius, undistort
from scenes.rig.projectors import PinholeProjector
from scenes.support.errors import SceneError

DISTORTION = (-0.12, 0.05, 8e-4, -5e-4, 0.01)
ROUNDING = 1e-9


def pinhole(distortion: tuple[float, float, float, float, float]) -> Pinhole:
    return Pinhole(
        resolution=(640, 480),
        pose=LookAt(origin_mm=(30.0, -40.0, 300.0), target_mm=(1.0, 2.0, 0.0)),
        fx_px=900.0,
        fy_px=905.0,
        cx_px=322.0,
        cy_px=238.0,
        distortion=distortion,
    )


def devices() -> tuple[Pinhole, Telecentric]:
    pose = LookAt(origin_mm=(-80, 5, 200))
    return pinhole(DISTORTION), Telecentric(resolution=(640, 480), field_width_mm=40.0, pose=pose)


def test_projection_equals_opencvs_plus_half_a_pixel() -> None:
    geometry = pinhole(DISTORTION).projection()
    points = np.random.default_rng(1).uniform([-80, -60, -20], [80, 60, 20], (200, 3))
    matrix = np.array([[900.0, 0, 321.5], [0, 905.0, 237.5], [0, 0, 1]])
    turn, _ = cv2.Rodrigues(geometry.R)
    expected, _ = cv2.projectPoints(points, turn, geometry.t, matrix, np.array(DISTORTION))
    np.testing.assert_allclose(geometry.project(points)[0], expected[:, 0] + 0.5, atol=1e-7)


def test_point_on_a_pixels_ray_projects_to_that_pixel() -> None:
    for device in devices():
        geometry = device.projection()
        pixels = geometry.pixel_centres()[::37, ::41]
        origin, direction = geometry.rays(pixels)
        back, depth = geometry.project(origin + 250.0 * direction)
        np.testing.assert_allclose(back, pixels, atol=ROUNDING * 640)
        assert (depth > 0).all()


def test_camera_looks_down_with_x_along_columns_and_y_up() -> None:
    camera = Telecentric(
        resolution=(400, 300), field_width_mm=40.0, pose=LookAt(origin_mm=(0, 0, 9))
    )
    pixels, depth = camera.projection().project([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2]])
    np.testing.assert_allclose(
        pixels, [[200, 150], [210, 150], [200, 140], [200, 150]], atol=ROUNDING
    )
    np.testing.assert_allclose(depth, [9, 9, 9, 7])


def test_points_behind_a_pinhole_or_beyond_its_lens_are_not_imaged() -> None:
    geometry = pinhole((-0.3, 0.0, 0.0, 0.0, 0.0)).projection()
    behind = geometry.origin_mm - 10.0 * geometry.axis
    outside = geometry.origin_mm + geometry.axis + 2.0 * geometry.max_radius * geometry.R[0]
    assert np.isnan(geometry.project([behind, outside])[0]).all()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_pose_farther_than_float32_resolves_is_refused(axis: int) -> None:
    far = [0.0, 1.0, 2.0]
    far[axis] = -1e7
    x, y, z = far
    LookAt(origin_mm=(x, y, z))
    far[axis] = -1.01e7
    x, y, z = far
    with pytest.raises(SceneError, match="keep them within"):
        LookAt(origin_mm=(x, y, z))


def test_matrix_pose_equals_the_look_at_pose_it_was_taken_from() -> None:
    look = LookAt(origin_mm=(10.0, 20.0, 300.0), target_mm=(0.0, 5.0, 0.0))
    R, t = look.matrix()
    again = Extrinsics(R=tuple(map(tuple, R)), t_mm=tuple(t))
    np.testing.assert_allclose(again.matrix()[0], R, atol=1e-15)
    np.testing.assert_allclose(again.matrix()[1], t)


@given(st.floats(-0.2, 0.2), st.floats(-0.1, 0.1), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3))
def test_undistort_inverts_distort_inside_the_monotone_radius(
    k1: float, k2: float, p1: float, p2: float
) -> None:
    coefficients = (k1, k2, p1, p2, 0.0)
    # Tangential terms of 2e-3 move the turning point by less than a tenth.
    reach = min(0.5, 0.6 * monotone_radius(coefficients))
    x, y = reach * np.cos(np.arange(12)), reach * np.sin(np.arange(12))
    back = undistort(*distort(x, y, coefficients), coefficients)
    np.testing.assert_allclose(back, [x, y], atol=ROUNDING)


@pytest.mark.parametrize(
    ("name", "value"),
    [("fx_px", 1e-300), ("fy_px", 1e300), ("cy_px", 4e84), ("distortion", (0, 0, 0, 0, 1e300))],
)
def test_lens_beyond_floating_point_range_is_refused(name: str, value: object) -> None:
    # found by fuzzing: such a principal point in a file's header overflowed where the decoder plans
    with pytest.raises(SceneError, match=name):
        Pinhole(**{**pinhole(DISTORTION).model_dump(), name: value})


def test_distortion_that_folds_in_one_corner_is_refused() -> None:
    # r (1 - 0.8 r^2) turns at r = 0.645: the right corners are 0.74 from the centre, the left ones 0.27.
    with pytest.raises(SceneError, match="folds over inside the image"):
        changes = {"cx_px": 20.0, "distortion": (-0.8, 0.0, 0.0, 0.0, 0.0)}
        Pinhole(**pinhole(DISTORTION).model_dump() | changes)


def test_points_at_a_height_are_in_that_plane_and_on_their_pixels_ray() -> None:
    for device in devices():
        geometry = device.projection()
        height = np.random.default_rng(1).uniform(-1.0, 2.0, (geometry.height, geometry.width))
        height[0, 0] = np.nan
        points = geometry.points_at(height)
        assert np.isnan(points[0, 0]).all()
        np.testing.assert_allclose(points[..., 2], height, atol=ROUNDING)
        pixels, _ = geometry.project(points)
        assert np.nanmax(np.abs(pixels - geometry.pixel_centres())) < ROUNDING * 640


def test_a_projector_of_so_many_bits_shows_so_many_levels() -> None:
    device = PinholeProjector(
        pose=LookAt(origin_mm=(0, 0, 100)),
        resolution=(64, 48),
        fx_px=100,
        fy_px=100,
        cx_px=32,
        cy_px=24,
        reference_mm=100,
        bits=2,
    )
    # Two bits: thirds, each for the commanded values nearest to it.
    shown = device.emit(np.array([0.0, 0.16, 0.17, 0.49, 0.51, 0.83, 0.84, 1.0]))
    np.testing.assert_allclose(shown, np.array([0, 0, 1, 1, 2, 2, 3, 3]) / 3.0)
