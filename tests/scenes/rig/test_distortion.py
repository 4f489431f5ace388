"""Lens distortion: its derivatives against differences, and an ideal pinhole where none is stated."""

import numpy as np
import pytest

from scenes.rig.devices import LookAt, Pinhole
from scenes.rig.projection import distort, distortion_jacobian, monotone_radius, undistort

LENS = (-0.12, 0.05, 8e-3, -6e-3, 0.04)
X, Y = np.random.default_rng(0).uniform(-0.6, 0.6, (2, 200))


@pytest.mark.parametrize("term", range(5))
def test_jacobian_is_that_of_central_differences(term: int) -> None:
    """Each coefficient alone: the others cannot hide it."""
    k1, k2, p1, p2, k3 = np.where(np.arange(5) == term, LENS, 0.0).tolist()
    lens = (k1, k2, p1, p2, k3)
    h = 1e-5
    along_x = np.subtract(distort(X + h, Y, lens), distort(X - h, Y, lens)) / (2 * h)
    along_y = np.subtract(distort(X, Y + h, lens), distort(X, Y - h, lens)) / (2 * h)
    # h^2 / 6 times a third derivative below 20.
    for found, expected in zip(
        distortion_jacobian(X, Y, lens), (along_x[0], along_y[0], along_y[1]), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_allclose(along_x[1], along_y[0], atol=1e-9)


def test_undistorting_inverts_distorting() -> None:
    np.testing.assert_allclose(undistort(*distort(X, Y, LENS), LENS), (X, Y), atol=1e-9)


@pytest.mark.parametrize(("term", "power"), [(0, 2), (1, 4), (4, 6)])
def test_radius_grows_up_to_where_its_derivative_is_zero(term: int, power: int) -> None:
    """Of r (1 + k r^n) that is where (n + 1) k r^n = -1."""
    k1, k2, p1, p2, k3 = np.where(np.arange(5) == term, -0.3, 0.0).tolist()
    turn = (1.0 / ((power + 1) * 0.3)) ** (1.0 / power)
    assert monotone_radius((k1, k2, p1, p2, k3)) == pytest.approx(turn, rel=1e-9)
    assert monotone_radius((-k1, -k2, p1, p2, -k3)) == np.inf


def test_pinhole_without_coefficients_is_ideal() -> None:
    device = Pinhole(
        resolution=(64, 48),
        pose=LookAt(origin_mm=(0, 0, 100)),
        fx_px=500.0,
        fy_px=400.0,
        cx_px=33.0,
        cy_px=20.0,
    ).projection()
    origin, direction = device.rays(np.array([[33.0 + 25.0, 20.0 - 12.0]]))
    local = direction @ device.R.T
    # 25 px of 500 and 12 px of 400.
    np.testing.assert_allclose(local / local[..., 2:], [[0.05, -0.03, 1.0]], atol=1e-12)
    np.testing.assert_allclose(origin, [[0.0, 0.0, 100.0]], atol=1e-12)
