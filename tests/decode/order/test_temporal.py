"""Fringe orders: temporal for any periods, spatial with its known weaknesses, and what is said when they fail."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import decode
from decode.order.spatial import level, quality_guided, row_scan
from scenes.acquisition.patterns import PhaseShift
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from tests.decode.synthetic import Map, calibrated_stack, hills, rig


def wrap(phase: Map) -> np.ndarray:
    return ((phase + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)


def uncalibrated(stack: Stack) -> Stack:
    return replace(stack, calibration=None)


@settings(max_examples=25, deadline=None)
@given(
    fine=st.floats(6.0, 24.0),
    ratios=st.lists(st.floats(1.5, 6.0), min_size=1, max_size=3),
    steps=st.integers(3, 6),
    seed=st.integers(0, 2**31),
)
def test_any_period_set_is_decoded_where_its_coarsest_period_is_unambiguous(
    fine: float, ratios: list[float], steps: int, seed: int
) -> None:
    periods = tuple(np.cumprod([fine, *ratios]))
    truth = hills()
    stack = calibrated_stack(
        rig(),
        truth,
        PhaseShift(steps=steps, periods_px=periods),
        sigma_dn=0.5,
        dtype=np.uint8,
        rng=np.random.default_rng(seed),
    )
    if periods[-1] < 3.85 * 5.0 * 1.05:  # The volume shifts the fringe by about 20 px.
        return
    rec = decode.reconstruct(stack, max_order_residual=0.25)
    assert rec.valid.all()
    assert (np.abs(rec.height_mm - truth) < 6.5 * rec.sigma_mm).all()


@pytest.mark.parametrize("height_mm", [-0.19, 0.69])
def test_a_period_as_wide_as_the_volume_is_right_at_both_of_its_ends(height_mm: float) -> None:
    # 0.9 mm and their margin of a tenth shift the fringe by 5 px: half a period about the middle reaches both ends.
    truth = np.full((48, 64), height_mm)
    shown = PhaseShift(periods_px=(5.3,))
    rec = decode.reconstruct(calibrated_stack(rig(heights_mm=(-0.2, 0.7)), truth, shown))
    assert rec.settings["unwrap"] == "volume"
    assert np.abs(rec.height_mm - truth).max() < 2e-5


def test_one_period_suffices_when_the_volume_is_shallow() -> None:
    truth = hills(top_mm=0.5)
    calibration = rig(heights_mm=(-0.2, 0.7))
    rec = decode.reconstruct(calibrated_stack(calibration, truth, PhaseShift(periods_px=(16.0,))))
    assert rec.settings["unwrap"] == "volume"
    assert np.abs(rec.height_mm - truth).max() < 2e-5


def test_field_anchor_reaches_both_ends_of_the_projector() -> None:
    truth = hills()
    stack = calibrated_stack(rig(), truth, PhaseShift(periods_px=(16.0, 80.0, 400.0)))
    rec = decode.reconstruct(stack, anchor="field")
    assert rec.valid.all()
    assert np.abs(rec.height_mm - truth).max() < 2e-5


@pytest.mark.parametrize(
    ("choices", "heights", "periods", "said"),
    [
        (
            {"anchor": "volume"},
            (-20.0, 20.0),
            (16.0, 80.0),
            "shift the column fringe by .* more than",
        ),
        ({"anchor": "field"}, (-0.5, 3.0), (16.0, 80.0), "less than the projector's 400 px"),
        ({"unwrap": "temporal"}, (-20.0, 20.0), (16.0,), "single column period: .* Add a coarser"),
    ],
)
def test_ambiguous_orders_are_refused_with_the_numbers(
    choices: dict[str, Any], heights: tuple[float, float], periods: tuple[float, ...], said: str
) -> None:
    stack = calibrated_stack(rig(heights_mm=heights), hills(), PhaseShift(periods_px=periods))
    with pytest.raises(DecodeError, match=said):
        decode.reconstruct(stack, **choices)


def test_one_wrong_pixel_disturbs_its_row_in_a_row_scan_but_only_itself_in_time() -> None:
    truth = np.zeros((48, 64))
    patterns = PhaseShift(periods_px=(16.0, 80.0))
    stack = calibrated_stack(rig(), truth, patterns)
    # A scratch that shifts the fringe by a third and then by two thirds of a turn: two steps up that never come down.
    counts = stack.frames.copy()
    fine = stack.frames[0, :4].astype(np.float64)
    for column, turn in ((30, 1 / 3), (31, 2 / 3)):
        z = ((fine[0] - fine[2]) - 1j * (fine[1] - fine[3]))[10, column] / 2
        phase = np.angle(z) + 2 * np.pi * turn
        counts[0, :4, 10, column] = 120 + 80 * np.cos(phase + np.arange(4) * np.pi / 2)
    bad = replace(stack, frames=counts)
    wrong = {
        way: np.abs(decode.reconstruct(bad, unwrap=way).height_mm - truth) > 0.1
        for way in ("row-scan", "temporal")
    }
    assert wrong["row-scan"][10, 32:].all()
    assert wrong["temporal"].sum() <= 2


def test_disagreeing_periods_are_flagged_as_order_mismatch() -> None:
    stack = calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16.0, 80.0)))
    counts = stack.frames.copy()
    there = (slice(10, 20), slice(10, 20))
    z = (counts[0, 4] - counts[0, 6]) - 1j * (counts[0, 5] - counts[0, 7])
    # The coarse phase off by 0.45 fine periods.
    phase = np.angle(z) + 2 * np.pi * 0.45 / 5
    for k in range(4):
        counts[0, 4 + k][there] = (120 + 80 * np.cos(phase + k * np.pi / 2))[there]
    rec = decode.reconstruct(replace(stack, frames=counts))
    assert (rec.reason[there] == decode.Reason.ORDER_MISMATCH).all()
    assert (rec.reason != decode.Reason.OK).sum() == 100
    assert decode.reconstruct(replace(stack, frames=counts), max_order_residual=0.5).valid.all()


@pytest.mark.parametrize("scan", [row_scan, quality_guided])
def test_spatial_unwrapping_restores_a_smooth_phase_up_to_whole_turns(scan: Any) -> None:
    y, x = np.mgrid[:60, :80]
    phase = 0.4 * x + 6.0 * np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / 300)
    wrapped, good = wrap(phase), np.ones(phase.shape, bool)
    orders = scan(wrapped, good)
    turns = (orders * 2 * np.pi + wrapped - phase) / (2 * np.pi)
    assert np.abs(turns - np.round(turns[0, 0])).max() < 1e-6


@pytest.mark.parametrize("scan", [row_scan, quality_guided])
def test_spatial_unwrapping_steps_over_pixels_without_a_fringe(scan: Any) -> None:
    y, x = np.mgrid[:40, :60]
    phase = 0.3 * x + 0.1 * y
    rng = np.random.default_rng(2)
    good = np.ones(phase.shape, bool)
    good[10:20, 20:26] = False
    good[5] = False
    wrapped = np.where(good, wrap(phase), rng.uniform(-3, 3, phase.shape)).astype(np.float32)
    orders = scan(wrapped, good)
    orders = level(orders, wrapped, good, phase / (2 * np.pi), whole=scan is row_scan)
    assert np.abs((orders * 2 * np.pi + wrapped - phase)[good]).max() < 1e-5


def test_quality_guided_regions_are_each_levelled_by_the_volume() -> None:
    truth = hills()
    albedo = np.ones_like(truth)
    albedo[:, 30:34] = 0.0
    stack = calibrated_stack(
        rig(), truth, PhaseShift(periods_px=(32.0,)), offset=120 * albedo, modulation=80 * albedo
    )
    rec = decode.reconstruct(stack, unwrap="quality-guided")
    assert (rec.reason[albedo == 0] == decode.Reason.SHADOW).all()
    lit = (albedo > 0) & (
        np.arange(64) < 55
    )  # Left of the sharp step, which no spatial method crosses safely.
    assert rec.valid[lit].all()
    assert np.abs(rec.height_mm - truth)[lit].max() < 5e-5


@pytest.mark.parametrize("way", ["row-scan", "quality-guided"])
def test_scan_takes_its_whole_turns_from_the_coarser_periods(way: Any) -> None:
    # The board fills the image, 5.5 mm below the middle of the volume; a fringe is 3.1 mm.
    truth = 0.2 * hills()
    truth[:, 56:] = 0.0
    calibration = rig(heights_mm=(-1.0, 12.0))
    patterns = PhaseShift(periods_px=(16.0, 100.0, 400.0))
    rec = decode.reconstruct(calibrated_stack(calibration, truth, patterns), unwrap=way)
    assert rec.valid.all()
    assert np.abs(rec.height_mm - truth).max() < 5e-5


def test_uncalibrated_single_period_gives_relative_phase_from_zero() -> None:
    made = calibrated_stack(rig(), np.zeros((48, 64)), PhaseShift(periods_px=(16.0,)))
    rec = decode.reconstruct(uncalibrated(made), height="phase")
    assert rec.settings["unwrap"] == "quality-guided"
    assert rec.fringe_order[0, 0] == 0
    assert np.isnan(rec.height_mm).all()
    known = decode.reconstruct(made)
    turns = (known.phase_rad - rec.phase_rad) / (2 * np.pi)
    assert np.abs(turns - np.round(turns[0, 0])).max() < 1e-9
