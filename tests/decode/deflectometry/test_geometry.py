"""Reflection, edges and integration on surfaces known in closed form: rays are mirrored by formulas of the test's own."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from decode import Reason
from decode.deflectometry.edges import mostly_outside, near_edges, shift_px
from decode.deflectometry.integration import Integration, Patches
from decode.deflectometry.mirror import _in_volume
from decode.deflectometry.mirror_surface import integrated, two_positions
from decode.deflectometry.reflection import (
    Looks,
    Rays,
    meeting,
    normals,
    seen_points,
    slopes,
    spread,
)
from scenes import Emva, LookAt, Pinhole, Screen, Telecentric

Floats = NDArray[np.float64]

SIZE = (48, 36)
POSE = LookAt(origin_mm=(70.0, 10.0, 280.0))
PINHOLE = Pinhole(resolution=SIZE, fx_px=700.0, fy_px=700.0, cx_px=24.0, cy_px=18.0, pose=POSE)
BENT = PINHOLE.model_copy(update={"distortion": (-0.3, 0.1, 0.01, -0.01, 0.0)})
PARALLEL = Telecentric(resolution=SIZE, field_width_mm=18.0, pose=POSE)
SCREENS = tuple(
    Screen(
        resolution=(1280, 1024),
        size_mm=(160.0, 128.0),
        pose=LookAt(origin_mm=(-70 * s, -10 * s, 280 * s)),
    )
    for s in (0.4, 0.9)
)


def sphere(camera: Any, radius_mm: float) -> tuple[Rays, Floats, Floats]:
    """Rays, and where they meet a sphere through the origin whose centre is below: points and outward normals."""
    rays = Rays(
        *(
            part.reshape(-1, 3)
            for part in camera.projection().rays(camera.projection().pixel_centres())
        )
    )
    away = rays.origin_mm + np.array([0.0, 0.0, radius_mm])
    half = (away * rays.direction).sum(-1)
    distance = -half - np.sqrt(half**2 - (away**2).sum(-1) + radius_mm**2)
    point = rays.origin_mm + distance[:, None] * rays.direction
    return rays, point, (point + np.array([0.0, 0.0, radius_mm])) / radius_mm


def seen(rays: Rays, point: Floats, normal: Floats) -> Floats:
    """Columns and rows (screen, axis, pixel) at which a mirror shows the screens: OpenCV's x right, y down, from behind."""
    way = rays.direction - 2 * (rays.direction * normal).sum(-1, keepdims=True) * normal
    found = []
    for screen in SCREENS:
        rotation, translation = screen.pose.matrix()
        start, along = point @ rotation.T + translation, way @ rotation.T
        place = start - start[:, 2:] / along[:, 2:] * along
        found.append([640 - 8 * place[:, 0], 512 + 8 * place[:, 1]])
    return np.array(found)


@pytest.mark.parametrize("camera", [PINHOLE, BENT, PARALLEL])
@settings(deadline=None, max_examples=10)
@given(radius_mm=st.floats(60.0, 1e4))
def test_two_positions_give_point_and_normal_of_any_sphere(camera: Any, radius_mm: float) -> None:
    rays, point, normal = sphere(camera, radius_mm)
    near, far = seen_points(SCREENS, seen(rays, point, normal))
    distance, gap = meeting(rays, near, far)
    found = rays.points(distance)
    # Float64 at 300 mm, over the sine of the angle between both rays, some 0.4.
    np.testing.assert_allclose(found, point, atol=1e-9)
    np.testing.assert_allclose(gap, 0.0, atol=1e-9)
    np.testing.assert_allclose(normals(rays, found, (near, far)), normal, atol=1e-11)


def test_rays_that_miss_each_other_on_either_side_give_no_height() -> None:
    rays, point, normal = sphere(PINHOLE, 150.0)
    exact = seen(rays, point, normal)
    sigma = np.full(exact.shape, 0.02)
    assert (
        two_positions(rays, Looks(SCREENS, exact, sigma, np.zeros_like(exact))).reason == Reason.OK
    ).all()
    # Rows of the far screen off by 20 px, 1000 deviations: the mirrored ray is tilted out of the plane of the two.
    off = exact.copy()
    off[1, 1, ::2] += 20.0
    off[1, 1, 1::2] -= 20.0
    found = two_positions(rays, Looks(SCREENS, off, sigma, np.zeros_like(exact)))
    assert (found.reason == Reason.NO_HEIGHT).all()


def test_a_pixel_without_height_is_left_out_of_the_integration_and_no_other() -> None:
    rays, point, normal = sphere(PINHOLE, 150.0)
    at = seen(rays, point, normal)
    at += 0.2 * np.random.default_rng(3).standard_normal(at.shape)
    at[1, 1, 900] += 500.0
    looks = Looks(SCREENS, at, np.full(at.shape, 0.2), np.zeros_like(at))
    alone = two_positions(rays, looks)
    found = integrated(rays, looks, np.ones((SIZE[1], SIZE[0]), np.bool_), None)
    good = np.arange(at.shape[-1]) != 900
    assert found.reason[900] == Reason.NO_HEIGHT and (found.reason[good] == Reason.OK).all()
    # Normals of 1728 pixels average what each pixel's own height has of noise: to a fifth at least.
    before, after = (np.std((m.height_mm - point[:, 2])[good]) for m in (alone, found))
    assert after < 0.2 * before


def test_predicted_deviations_are_those_of_noisy_coordinates() -> None:
    rays, point, normal = sphere(PINHOLE, 150.0)
    exact = seen(rays, point, normal)
    sigma = np.full(exact.shape, 0.02)
    sigma[0] *= 2.0

    def figures(at: Floats) -> Floats:
        near, far = seen_points(SCREENS, at)
        distance, gap = meeting(rays, near, far)
        where = rays.points(distance)
        return np.concatenate([[where[:, 2], gap], slopes(normals(rays, where, (near, far)))])

    rng = np.random.default_rng(1)
    tried = [figures(exact + sigma * rng.standard_normal(exact.shape)) for _ in range(200)]
    ratio = np.std(tried, axis=0) / spread(figures, exact, sigma)
    # 200 samples of each of 1728 pixels: a deviation is known to 1 / sqrt(400), its mean over pixels to 0.1 %.
    np.testing.assert_allclose(ratio.mean(axis=-1), 1.0, atol=0.01)
    found = two_positions(rays, Looks(SCREENS, exact, sigma, np.zeros_like(exact)))
    height, _, *slope = np.std(tried, axis=0)
    np.testing.assert_allclose(np.mean(height / found.sigma_mm), 1.0, atol=0.01)
    np.testing.assert_allclose(np.mean(slope / found.slope_sigma, axis=-1), 1.0, atol=0.01)


@pytest.mark.parametrize("camera", [PINHOLE, BENT, PARALLEL])
@settings(deadline=None, max_examples=10)
@given(radius_mm=st.floats(60.0, 1e4), lift=st.floats(-5.0, 5.0))
def test_integrated_normals_of_a_sphere_give_its_heights(
    camera: Any, radius_mm: float, lift: float
) -> None:
    """Chords of a sphere are at right angles to the mean of the normals at their ends, so nothing is approximated."""
    rays, point, normal = sphere(camera, radius_mm)
    mask = np.ones((SIZE[1], SIZE[0]), np.bool_)
    mask[:, 20] = False
    mask[10, 20] = True
    kept = mask.ravel()
    own = Rays(rays.origin_mm[kept], rays.direction[kept])
    patches = Patches.of(mask)
    assert patches.count == 1
    # The heights' mean is known, and nothing else of them.
    weight = np.ones(kept.sum())
    rng = np.random.default_rng(2)
    known = point[kept, 2] + 0.1 * rng.standard_normal(kept.sum())
    found = Integration(patches, own, normal[kept]).distances(known, weight)
    off = own.points(found)[:, 2] - point[kept, 2]
    # All pixels are off by what the mean of the known heights is off, but for the growth of scale with depth.
    assert abs(off.mean()) < 5 * 0.1 / np.sqrt(kept.sum())
    assert np.ptp(off) < 1e-3 * 0.1


def test_separate_patches_are_integrated_independently() -> None:
    rays, point, normal = sphere(PINHOLE, 200.0)
    mask = np.ones((SIZE[1], SIZE[0]), np.bool_)
    mask[:, 20] = False
    kept = mask.ravel()
    patches = Patches.of(mask)
    assert patches.count == 2
    known = point[kept, 2] + np.where(patches.patch == 0, 0.0, 1.0)
    own = Rays(rays.origin_mm[kept], rays.direction[kept])
    found = Integration(patches, own, normal[kept]).distances(known, np.ones(kept.sum()))
    off = own.points(found)[:, 2] - point[kept, 2]
    np.testing.assert_allclose(off[patches.patch == 0], 0.0, atol=1e-9)
    # A patch 1 mm nearer, of 290, is so much smaller.
    np.testing.assert_allclose(off[patches.patch == 1], 1.0, atol=0.01)


@pytest.mark.parametrize("edge", [20.0, 20.3, 20.5, 20.9])
def test_edge_moves_a_blurred_pixel_to_the_centre_of_its_visible_part(edge: float) -> None:
    """A mirror from column `edge` on, seen through a Gaussian of 1.5 px: integrals over its visible part, pixel by pixel."""
    sigma = 1.5
    lens = Emva(psf="none", psf_sigma_um=3.45 * np.sqrt(sigma**2 - 1.0 / 12.0))
    centre = np.arange(40) + 0.5
    x = np.linspace(edge, edge + 60.0, 20001)
    weight = stats.norm.pdf(x - centre[:, None], scale=sigma)
    share = np.trapezoid(weight, x)
    moved = np.trapezoid(weight * (x - centre[:, None]), x) / share
    light = np.tile(100.0 * share, (30, 1))
    reason = np.full(light.shape, Reason.OK, np.uint8)
    reason[share * np.ones((30, 1)) < 0.1] = Reason.NO_IMAGE

    near = near_edges(reason)
    assert near[15, 21]
    assert not near[15, 30]
    outside = mostly_outside(light, near)[15]
    # The brightest pixel nearby has all of the light but 0.1 %, which moves the limit by 0.002 px.
    valid = reason[15] == Reason.OK
    np.testing.assert_array_equal(outside[valid], (centre < edge - 0.002)[valid])
    right, down = shift_px(light, np.zeros_like(light), near, lens)[:, 15]
    assert not down.any()
    np.testing.assert_array_equal(right[~near[15]], 0.0)
    inner = near[15] & ~outside
    # The gradient over two pixels is that of the Gaussian times 1 + (z^2 - 1) / 6 s^2 + (z^4 - 6 z^2 + 3) / 120 s^4.
    z = (centre - edge) / sigma
    difference = 1.0 + (z**2 - 1.0) / (6.0 * sigma**2)
    np.testing.assert_allclose(right[inner], (moved * difference)[inner], rtol=0.01)
    # Gradients that noise may make count as none.
    assert not shift_px(light, np.full_like(light, 10.0), near, lens).any()


def test_heights_beyond_a_twentieth_of_the_range_are_out_of_the_volume() -> None:
    height = np.array([9.85, 9.95, 11.0, 12.05, 12.15])
    found = SimpleNamespace(height_mm=height, reason=np.full(5, Reason.OK))
    stack = SimpleNamespace(calibration=SimpleNamespace(height_range_mm=(10.0, 12.0)))
    reason = _in_volume(found, stack, SimpleNamespace(height_range_mm=None))  # type: ignore[arg-type]
    outside, ok = Reason.OUT_OF_VOLUME, Reason.OK
    np.testing.assert_array_equal(reason, [outside, ok, ok, ok, outside])
