"""Spheres and planes fitted to points whose truth is known."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evaluation.scoring.reference_bodies import (
    expected_range,
    fit_plane,
    fit_sphere,
    shortest_range,
)
from scenes.support.errors import ScoreError


def dome(count: int, seed: int, slope_deg: float = 60.0) -> np.ndarray:
    """Unit vectors spread over the upper part of a sphere."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(np.cos(np.deg2rad(slope_deg)), 1.0, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)


@given(st.floats(0.5, 200.0), st.tuples(*[st.floats(-1e3, 1e3)] * 3), st.floats(25.0, 90.0))
@settings(max_examples=40, deadline=None)
def test_exact_sphere_comes_back(
    radius: float, centre: tuple[float, float, float], slope: float
) -> None:
    found = fit_sphere(radius * dome(400, 1, slope) + centre)
    # float64 at coordinates of 1e3, stretched by the weak hold that a cap has on its radius
    tolerance = 1e-9 * (1e3 + radius)
    np.testing.assert_allclose(found.centre_mm, centre, atol=tolerance)
    assert found.radius_mm == pytest.approx(radius, abs=tolerance)
    assert found.form_mm < tolerance


def test_noisy_sphere_has_the_expected_form_error_and_size() -> None:
    sigma, radius, count = 0.01, 10.0, 20_000
    rng = np.random.default_rng(3)
    unit = dome(count, 2)
    found = fit_sphere(unit * (radius + rng.normal(0, sigma, count))[:, None])
    assert found.sigma_mm == pytest.approx(sigma, rel=0.03)
    assert found.form_mm == pytest.approx(sigma * expected_range(count), rel=0.05)
    # 95 % of a Gaussian lie within 2 * 1.96 sigma
    assert found.form95_mm == pytest.approx(3.92 * sigma, rel=0.03)
    # a 60 degree cap determines its radius some 10 times worse than a mean would: 10 sigma / sqrt(n), three of them
    assert abs(found.radius_mm - radius) < 30.0 * sigma / np.sqrt(count)


@pytest.mark.parametrize("mirrored", list(np.ndindex(2, 2, 2)))
def test_fitted_sphere_has_the_least_squares(mirrored: tuple[int, int, int]) -> None:
    """There the deviations and their components sum to zero, whichever way the algebraic sphere was off."""
    points = dome(200, 3, 180.0) * np.random.default_rng(3).normal(10.0, 0.5, (200, 1))
    points *= 1 - 2 * np.array(mirrored)
    found = fit_sphere(points)
    away = points - found.centre_mm
    distance = np.linalg.norm(away, axis=1)
    off = distance - found.radius_mm
    # Float64 of 10 mm; the algebraic sphere misses by the noise squared over the radius, 0.02 mm.
    assert abs(off.mean()) < 1e-8
    assert np.abs((off[:, None] * away / distance[:, None]).mean(axis=0)).max() < 1e-8


def test_three_in_a_thousand_outliers_are_left_out_and_more_are_not() -> None:
    points = 10.0 * dome(2000, 4)
    points[:6] *= 1.1
    assert fit_sphere(points).form_mm < 1e-3
    points[:12] *= 1.1
    assert fit_sphere(points).form_mm > 0.5


def test_tilted_plane_is_flat_and_a_bump_is_not() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-20, 20, (2, 5000))
    points = np.stack([x, y, 0.3 * x - 0.2 * y + 700.0], axis=-1)
    found = fit_plane(points)
    assert found.flatness_mm < 1e-10
    np.testing.assert_allclose(
        np.abs(found.normal), np.abs([-0.3, 0.2, 1.0] / np.sqrt(1.13)), atol=1e-9
    )
    points[:, 2] += np.where(np.hypot(x, y) < 5.0, 0.1, 0.0)
    bump = fit_plane(points)
    assert bump.flatness_mm == pytest.approx(0.1 / np.sqrt(1.13), rel=0.02)


def test_noisy_plane_has_the_expected_flatness() -> None:
    rng = np.random.default_rng(6)
    points = np.column_stack([rng.uniform(-20, 20, (30_000, 2)), rng.normal(0, 0.01, 30_000)])
    assert fit_plane(points).flatness_mm == pytest.approx(0.01 * expected_range(30_000), rel=0.03)


@settings(deadline=None)
@given(st.lists(st.floats(-100, 100), min_size=1, max_size=40), st.floats(0.05, 1.0))
def test_shortest_range_holds_that_share(values: list[float], share: float) -> None:
    found = shortest_range(np.array(values), share)
    ordered = sorted(values)
    inside = max(sum(low <= v <= low + found + 1e-12 for v in ordered) for low in ordered)
    assert inside >= share * len(values) - 1e-9
    assert found <= max(values) - min(values) + 1e-12


@pytest.mark.parametrize("fit", [fit_sphere, fit_plane])
def test_too_few_points_are_refused(fit: Callable[[np.ndarray], object]) -> None:
    points = dome(100, 0)
    points[60:] = np.nan
    points[30:] = np.nan
    with pytest.raises(ScoreError, match="30 measured points"):
        fit(points)


def test_sphere_of_coplanar_points_is_refused() -> None:
    points = np.column_stack([np.random.default_rng(0).normal(size=(100, 2)), np.zeros(100)])
    with pytest.raises(ScoreError, match="on a plane"):
        fit_sphere(points)


def test_fifty_points_are_enough() -> None:
    assert fit_sphere(10.0 * dome(50, 7)).points == 50
    with pytest.raises(ScoreError, match="49 measured points"):
        fit_sphere(10.0 * dome(49, 7))
