"""Stray light too bright to be recognised by its level: it claims a place that light cannot have come from."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

import decode
from decode.height.calibrated_view import view_of
from decode.height.rig_geometry import Rig
from decode.validity import epipolar_order
from scenes.acquisition.patterns import PhaseShift
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt
from tests.decode.synthetic import calibrated_stack, rig

Map = NDArray[np.float64]
Mask = NDArray[np.bool_]
SHAPE = (96, 128)
TOP_MM = 1.5
BLOCK = np.s_[28:68, 60:88]
# What `shadow` finds by its amount, far from all else: an image without any shadow is not looked at again.
DARK = np.s_[88:94, 4:12]
RIGS = [("telecentric", "telecentric"), ("pinhole", "telecentric"), ("pinhole", "pinhole")]


def hidden(calibration: Calibration, height_mm: Map) -> Mask:
    """(row, col): which points of a surface something blocks from the projector."""
    camera, projector = (d.projection() for d in (calibration.camera, calibration.projectors[0]))
    points = camera.points_at(height_mm)
    light = -projector.axis if projector.telecentric else projector.origin_mm - points
    light = light / light[..., 2:]
    found = np.zeros(height_mm.shape, np.bool_)
    for rise in np.linspace(0.02, TOP_MM + 0.1, 160):
        pixels, _ = camera.project(points + rise * light)
        column, row = np.floor(np.moveaxis(pixels, -1, 0)).astype(int)
        inside = (column >= 0) & (column < SHAPE[1]) & (row >= 0) & (row < SHAPE[0])
        there = height_mm[row.clip(0, SHAPE[0] - 1), column.clip(0, SHAPE[1] - 1)]
        found |= inside & (there > height_mm + rise + 1e-6)
    return found


def scene(
    calibration: Calibration, claimed_mm: float, share: float = 0.2, ink: Mask | None = None
) -> tuple[Stack, Mask]:
    """A block on a board; its shadow sends back a share of the light and claims a height. And where the shadow is."""
    height = np.zeros(SHAPE)
    height[BLOCK] = TOP_MM
    shade = hidden(calibration, height)
    albedo = np.where(shade, share, 1.0)
    albedo[DARK] = 0.01
    if ink is not None:
        albedo[ink & ~shade] = share
    height[shade] = claimed_mm
    patterns = PhaseShift(periods_px=(16.0, 80.0))
    stack = calibrated_stack(
        calibration, height, patterns, sigma_dn=0.2, offset=120 * albedo, modulation=100 * albedo
    )
    return stack, shade


# At the board's own height, right by accident; at the block's; below the board.
@pytest.mark.parametrize("claimed_mm", [0.0, TOP_MM, -0.3])
@pytest.mark.parametrize("models", RIGS)
def test_bright_stray_light_in_a_shadow_is_shadow(
    models: tuple[str, str], claimed_mm: float
) -> None:
    calibration = rig(*models, size=SHAPE[::-1])
    stack, shade = scene(calibration, claimed_mm)
    rec = decode.reconstruct(stack)
    # Order says nothing of pixels nearer than two to the light they claim.
    core = ndimage.binary_erosion(shade, iterations=2)
    assert core.sum() > 40
    assert (rec.reason[core] == decode.Reason.SHADOW).all()
    lit = ~shade
    lit[DARK] = False
    assert rec.valid[lit].all()
    assert decode.reconstruct(stack, min_relative_modulation=0.0).valid[shade].all()


def test_dim_print_next_to_a_block_is_valid() -> None:
    everywhere = np.ones(SHAPE, np.bool_)
    everywhere[BLOCK] = False
    everywhere[:, :40] = False
    stack, shade = scene(rig(size=SHAPE[::-1]), 0.0, ink=everywhere)
    rec = decode.reconstruct(stack)
    lit = ~shade
    lit[DARK] = False
    assert rec.valid[lit].all()


def test_board_lit_beneath_a_raised_lead_is_valid() -> None:
    """Out of order with the lead, and as bright as board is."""
    stack, shade = scene(rig(size=SHAPE[::-1]), 0.0, share=0.6)
    assert decode.reconstruct(stack).valid[shade].all()


def test_shadow_found_by_order_is_the_same_in_every_region() -> None:
    stack, shade = scene(rig(size=SHAPE[::-1]), 0.0)
    full = decode.reconstruct(stack)
    rows, columns = np.nonzero(shade)
    roi = int(rows.min()), int(rows.max()), int(columns.min()) + 1, int(columns.max())
    part = decode.reconstruct(stack, roi=roi)
    inside = np.s_[roi[0] : roi[1], roi[2] : roi[3]]
    assert (full.reason[inside] == decode.Reason.SHADOW).any()
    assert np.array_equal(part.reason[inside], full.reason[inside])


@pytest.mark.parametrize("choices", [{"height": "phase"}, {"height": "linear"}])
def test_stray_light_is_shadow_with_any_height_model(choices: Any) -> None:
    stack, shade = scene(rig(size=SHAPE[::-1]), 0.0)
    rec = decode.reconstruct(stack, **choices)
    assert (rec.reason[ndimage.binary_erosion(shade, iterations=2)] == decode.Reason.SHADOW).all()


def test_coordinates_that_noise_swaps_stay_valid() -> None:
    """Coordinates that noise swaps are in no order, and no reason for doubt."""
    stack, _ = scene(rig(size=SHAPE[::-1]), 0.0)
    height = np.zeros(SHAPE)
    albedo = np.ones(SHAPE)
    albedo[::3] = 0.3
    albedo[DARK] = 0.01
    # 1/10 rad in the dim rows: 0.25 px, where neighbours are 0.6 px apart.
    noisy = calibrated_stack(
        rig(size=SHAPE[::-1]),
        height,
        PhaseShift(periods_px=(16.0, 80.0)),
        sigma_dn=4.0,
        offset=120 * albedo,
        modulation=100 * albedo,
    )
    rec = decode.reconstruct(replace(noisy, patterns=stack.patterns))
    dim = albedo < 1.0
    dim[84:, :16] = False
    # Beyond three standard deviations on both sides: one pair in 45 000.
    assert (rec.reason[dim] == decode.Reason.SHADOW).sum() <= 1


def by_hand(claims: epipolar_order.Claims, rig: Rig, heights_mm: tuple[float, float]) -> Mask:
    """The rule, looked up pixel by pixel and step by step."""
    lines = epipolar_order._Lines.of(rig, "column", heights_mm, SHAPE)
    lead, side = lines.lead, 1 - lines.lead
    size = SHAPE[::-1]
    found = np.zeros(SHAPE, np.bool_)
    for row, column in np.ndindex(SHAPE):
        light = claims.level[row, column]
        if not light < 0.5 * claims.typical:
            continue
        start = np.array([column, row])
        steps, gradients = lines.steps_at(start[None] + 0.5)
        for way, k in ((w, k) for w in (-1, 1) for k in range(2, lines.reach + 1)):
            exact = start + way * k * steps[0]
            pair = {int(np.floor(exact[side] + 0.1)), int(np.ceil(exact[side] - 0.1))}
            verdicts = []
            for across in pair:
                at = [0, 0]
                at[lead], at[side] = round(exact[lead]), across
                inside = all(0 <= a < n for a, n in zip(at, size, strict=True))
                there = at[1], at[0]
                if not inside or claims.level[there] < max(0.5 * claims.typical, 2 * light):
                    verdicts.append(False)
                    continue
                off = (across - exact[side]) * gradients[0, side]
                if way < 0:
                    verdicts.append(claims.least_px[there] - off > claims.most_px[row, column])
                else:
                    verdicts.append(claims.most_px[there] - off < claims.least_px[row, column])
            found[row, column] |= all(verdicts)
    return found


@pytest.mark.parametrize(
    "models", [RIGS[0], *(pytest.param(rig, marks=pytest.mark.slow) for rig in RIGS[1:])]
)
def test_first_pass_finds_every_pixel_out_of_order(models: tuple[str, str]) -> None:
    calibration = rig(*models, size=SHAPE[::-1])
    view = view_of(calibration, 0)
    heights = (0.0, 1.0)
    rng = np.random.default_rng(3)
    flat = calibrated_stack(calibration, np.ones(SHAPE), PhaseShift(periods_px=(16.0, 80.0)))
    plane = decode.reconstruct(flat).phases["column"].coordinate_px
    coordinate = plane + ndimage.gaussian_filter(rng.normal(0, 25, SHAPE), 1.0)
    untrusted = rng.random(SHAPE) < 0.1
    claims = epipolar_order.Claims(
        np.where(untrusted, -np.inf, coordinate - 0.05).astype(np.float32),
        np.where(untrusted, np.inf, coordinate + 0.05).astype(np.float32),
        rng.uniform(0.1, 1.5, SHAPE).astype(np.float32),
        1.0,
    )
    expected = by_hand(claims, view.rig, heights)
    assert 30 < expected.sum() < 0.5 * expected.size
    assert np.array_equal(
        epipolar_order.contradicted(claims, view.rig, "column", heights), expected
    )


def test_volume_without_height_has_no_epipolar_lines() -> None:
    lines = epipolar_order._Lines.of(
        view_of(rig(size=SHAPE[::-1]), 0).rig, "column", (1.0, 1.0), SHAPE
    )
    assert lines.reach == 0


def test_lines_are_followed_as_far_as_a_shadow_is_long() -> None:
    calibration = rig(size=SHAPE[::-1])
    short, long = (
        epipolar_order._Lines.of(view_of(calibration, 0).rig, "column", (0.0, top), SHAPE).reach
        for top in (0.5, 1.0)
    )
    axis = calibration.projectors[0].projection().axis
    # 16 mm over 128 pixels, along the image's longer direction of the light.
    expected = np.abs(axis[:2] / axis[2]).max() / 0.125
    assert short == int(np.ceil(0.5 * expected - 1e-9))
    assert long == int(np.ceil(1.0 * expected - 1e-9))


@pytest.mark.parametrize("aside_mm", [(0.0001, 0.0, 59.0), (0.5, 0.2, 50.0), (30.0, 30.0, 50.0)])
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (40, 1), (64, 48)])
@pytest.mark.parametrize("heights_mm", [(-1e6, 1e6), (-0.5, 3.0)])
def test_lines_in_all_directions_or_far_out_of_the_image_are_left_out(
    size: tuple[int, int], aside_mm: tuple[float, float, float], heights_mm: tuple[float, float]
) -> None:
    """A projector in the camera's own axis, or a false height: masks of such lines would be larger than memory."""
    calibration = rig("telecentric", "pinhole", size=size)
    pose = LookAt(origin_mm=aside_mm)
    projector = calibration.projectors[0].model_copy(update={"pose": pose})
    calibration = calibration.model_copy(update={"projectors": (projector,)})
    rng = np.random.default_rng(0)
    coordinate = rng.uniform(0, 400, size[::-1]).astype(np.float32)
    untrusted = rng.random(size[::-1]) < 0.2
    claims = epipolar_order.Claims(
        np.where(untrusted, np.float32(-np.inf), coordinate),
        np.where(untrusted, np.float32(np.inf), coordinate),
        rng.uniform(0, 2, size[::-1]).astype(np.float32),
        1.0,
    )
    view = view_of(calibration, 0)
    found = epipolar_order.contradicted(claims, view.rig, "column", heights_mm)
    assert not found[untrusted].any()
    lines = epipolar_order._Lines.of(view.rig, "column", heights_mm, size[::-1])
    assert lines.reach <= max(size)
    if lines.reach:
        assert max(mask.size for mask in lines.masks(1)) <= (4 * max(size) + 5) ** 2
