"""Stray light in a shadow against black ink: both are dim, only one is wrong."""

from dataclasses import replace

import numpy as np
import pytest

import decode
from decode.validity import shadow
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from tests.decode.synthetic import calibrated_stack, digitise, hills, rig

TIMES = (1.0, 4.0, 64.0)
INK, SHADE = np.s_[:, :12], np.s_[:, 20:26]


def board(shade: float, wrong_mm: float = 1.0) -> Stack:
    """A white board with ink of 5 %, and a strip that sees only light meant for a surface `wrong_mm` higher."""
    albedo = np.ones((48, 64))
    albedo[INK], albedo[SHADE] = 0.05, shade
    height = hills(top_mm=0.5)
    height[SHADE] += wrong_mm
    patterns = PhaseShift(periods_px=(16.0, 80.0))
    made = calibrated_stack(rig(), height, patterns, offset=100 * albedo, modulation=80 * albedo)
    rng = np.random.default_rng(1)
    counts = np.stack([digitise(made.frames[0] * t, 1.0, np.uint8, rng) for t in TIMES])
    sensor = SimpleSensor(sigma_dn=1.0)
    return replace(made, frames=counts, exposure_ms=TIMES, sensor=sensor)


def test_stray_light_is_shadow_and_ink_is_not() -> None:
    stack = board(shade=0.01)
    rec = decode.reconstruct(stack)
    assert (rec.reason[SHADE] == decode.Reason.SHADOW).all()
    assert rec.valid.sum() == rec.valid.size - 48 * 6
    # In 64 ms the strip decodes without a doubt, and wrongly: what the check is there for.
    fooled = decode.reconstruct(stack, min_relative_modulation=0.0)
    assert fooled.valid[SHADE].all()
    assert (np.abs(fooled.height_mm - hills(top_mm=0.5))[SHADE] > 0.9).all()


def test_what_is_shadow_does_not_depend_on_the_region_or_the_order_of_exposures() -> None:
    stack = board(shade=0.01)
    full = decode.reconstruct(stack)
    part = decode.reconstruct(stack, roi=(0, 48, 18, 30))
    assert np.array_equal(part.reason[:, 18:30], full.reason[:, 18:30])
    turned = replace(stack, frames=stack.frames[::-1], exposure_ms=TIMES[::-1])
    assert np.array_equal(decode.reconstruct(turned).reason, full.reason)


def test_saturation_stays_saturation() -> None:
    albedo_stack = board(shade=0.01)
    counts = albedo_stack.frames.copy()
    counts[..., :8, 40:48] = 255
    rec = decode.reconstruct(replace(albedo_stack, frames=counts))
    assert (rec.reason[:8, 40:48] == decode.Reason.SATURATED).all()


def striped(*shares: tuple[slice, float], prints: tuple[tuple[slice, float], ...] = ()) -> Stack:
    """A white board with columns that send back a share of its light, prints at its height and the others 1 mm higher."""
    albedo = np.ones((48, 64))
    height = hills(top_mm=0.5)
    for columns, part in (*shares, *prints):
        albedo[:, columns] = part
    for columns, _ in shares:
        height[:, columns] += 1.0
    patterns = PhaseShift(periods_px=(16.0, 80.0))
    made = calibrated_stack(rig(), height, patterns, offset=100 * albedo, modulation=80 * albedo)
    rng = np.random.default_rng(0)
    counts = np.stack([digitise(made.frames[0] * t, 0.0, np.uint8, rng) for t in TIMES])
    return replace(made, frames=counts, exposure_ms=TIMES, sensor=SimpleSensor(sigma_dn=0.3))


def test_brighter_stray_light_that_touches_shadow_is_shadow_and_dark_ink_valid() -> None:
    core, fringe, ink = slice(20, 24), slice(24, 27), slice(40, 44)
    rec = decode.reconstruct(striped((core, 0.01), (fringe, 0.035), prints=((ink, 0.035),)))
    assert (rec.reason[:, 20:27] == decode.Reason.SHADOW).all()
    assert rec.valid[:, ink].all()
    # Black ink next to a shadow is brighter than that, as long as it is wide enough not to be an edge.
    ink_edge = decode.reconstruct(striped((core, 0.01), prints=((slice(24, 30), 0.06),)))
    assert ink_edge.valid[:, 24:30].all()


@pytest.mark.parametrize(("share", "lit"), [(0.3, False), (0.45, False), (0.6, True)])
def test_pixel_on_the_edge_of_a_shadow_has_the_height_of_its_lit_part(
    share: float, lit: bool
) -> None:
    core, edge, far = slice(20, 24), slice(24, 25), slice(44, 45)
    stack = striped((core, 0.01), (edge, share), prints=((far, share),))
    rec = decode.reconstruct(stack)
    assert (rec.valid[:, edge] == lit).all()
    # As dim a line that borders on no shadow is print.
    assert rec.valid[:, far].all()
    part = decode.reconstruct(stack, roi=(5, 20, 24, 30))
    assert np.array_equal(part.reason[5:20, 24:30], rec.reason[5:20, 24:30])


@pytest.mark.parametrize("image", [(3, 5), (48, 64), (2048, 2448)])
def test_grid_covers_the_image_evenly(image: tuple[int, int]) -> None:
    at = shadow.grid(image)
    rows, columns = np.unravel_index(at, image)
    assert len(set(at.tolist())) == at.size <= 2 * shadow.GRID_PIXELS
    for found, size in ((rows, image[0]), (columns, image[1])):
        assert abs(found.mean() - (size - 1) / 2) <= size * 0.02 + 0.5


def test_light_near_a_pixel_is_the_mean_of_clear_pixels_around_it() -> None:
    """Two pixels each way; at the image's borders its outermost pixels are repeated."""
    rng = np.random.default_rng(1)
    levels, clear = rng.uniform(size=(7, 9)).astype(np.float32), rng.uniform(size=(7, 9)) < 0.2
    light, count = (
        np.lib.stride_tricks.sliding_window_view(np.pad(a, 2, "edge"), (5, 5)).sum(axis=(2, 3))
        for a in (levels * clear, clear)
    )
    found = shadow._light_near(levels, clear, *(i.ravel() for i in np.indices(levels.shape)))
    np.testing.assert_allclose(found, (light / np.maximum(count, 1)).ravel(), rtol=1e-5)
