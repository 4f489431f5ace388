"""Pads measured from height maps: exact maps first, then rendered ones."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import decode
import render
import scenes
from evaluation.inspection.pad_limits import (
    PadLimits,
    confusion,
    judge,
    pad_errors,
    threshold_shares,
)
from evaluation.inspection.pad_measurement import measure_pads
from scenes.labels.pad_truth import BoardTruth
from scenes.support.errors import ScoreError

PIXEL_MM = 0.01
SCENE = """
name = "pads"
height_range_mm = [-0.05, 0.45]
materials = {{ paint = {{ kind = "diffuse", reflectance = 0.5 }} }}

[camera]
model = "telecentric"
resolution = [240, 180]
field_width_mm = 2.4
pose = {{ origin_mm = [0.0, 0.0, 100.0] }}

{projectors}

[patterns]
kind = "phase-shift"
steps = 4
periods_px = [16.0, 512.0]
axes = ["column"]

[sensor]
kind = "emva1288"
bits = 12
psf = "none"

[exposures]
auto = {{ label = "mask", level_dn = 1200.0 }}

[sampling]
samples = 16
depth = 1

[board]
kind = "parametric"
size_mm = [2.4, 1.8]
layers = {{ mask_material = "paint", laminate_material = "paint" }}
parts = [
  {{ package = "chip", name = "R1", size = "0402", position_mm = [0.0, 0.35] }},
  {{ package = "bga", name = "U1", position_mm = [-0.6, -0.4], columns = 2, rows = 1, pad_mm = 0.3 }},
  {{ package = "chip", name = "R2", size = "0201", position_mm = [0.55, -0.4] }},
]

[board.paste]
material = "paint"
step_mm = 0.01
scoop = 0.1
dog_ear = 0.1
volume = {{ kind = "uniform", low = 0.9, high = 1.1 }}
offset_x_mm = {{ kind = "uniform", low = -0.01, high = 0.01 }}
offset_y_mm = {{ kind = "uniform", low = -0.01, high = 0.01 }}
"""
PROJECTOR = """
[[projectors]]
model = "telecentric"
resolution = [512, 384]
field_width_mm = 3.0
irradiance_w_m2 = 100.0
pose = {{ origin_mm = [{0}, {1}, 100.0], up = [{2}, {3}, 0.0] }}
"""
# Around the camera; each one's fringes run across its own direction of light.
PLACES = ((-50, 0, 0, 1), (50, 0, 0, 1), (0, 50, -1, 0), (0, -50, -1, 0))


def scene_of(projectors: int = 1, **overrides: Any) -> scenes.Scene:
    text = SCENE.format(projectors="".join(PROJECTOR.format(*p) for p in PLACES[:projectors]))
    return scenes.parse(text, {key.replace("__", "."): v for key, v in overrides.items()})


@pytest.fixture(scope="module")
def scene() -> scenes.Scene:
    return scene_of()


def exact(scene: scenes.Scene) -> decode.Reconstruction:
    """The true heights at the pixels' centres, as a reconstruction."""
    truth = render.truth(scene)
    calibration = scene.calibration()
    return decode.Reconstruction.of_heights(truth.height_mm, calibration=calibration)


def measured_pads(rec: decode.Reconstruction, board: BoardTruth, **options: Any) -> Sequence[Any]:
    """The pads, untyped: a figure that is None fails its comparison."""
    return measure_pads(rec, board, **options)


@pytest.fixture(scope="module")
def board(scene: scenes.Scene) -> BoardTruth:
    return scenes.board_truth(scene)


@pytest.fixture(scope="module")
def heights(scene: scenes.Scene) -> decode.Reconstruction:
    return exact(scene)


def test_exact_heights_give_the_true_volume_area_and_offset(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    for pad, true in zip(measured_pads(heights, board, threshold_mm=0.0), board.pads, strict=True):
        # A pixel's centre decides for all of it. Where the outline cuts pixels, each errs by a uniform share of one:
        # sd 0.29 pixels for each that the outline crosses if they were independent. Along a straight side they are
        # not: all may err alike, by half a pixel along the whole outline at worst.
        outline = 2.0 * sum(true.size_mm)
        worst = 0.5 * PIXEL_MM * outline
        assert abs(pad.area_mm2 - true.area_mm2) < worst
        # At the rim is a wall of 0.3 of the plateau (paste.wall), so that share of the area's error is volume.
        assert abs(pad.volume_mm3 - true.volume_mm3) < worst * 0.5 * true.peak_height_mm
        # Opposite sides may err by half a pixel in opposite senses, each worth its wall's share of the volume.
        assert abs(pad.offset_x_mm - true.offset_x_mm) < PIXEL_MM / 2
        assert abs(pad.offset_y_mm - true.offset_y_mm) < PIXEL_MM / 2
        assert pad.peak_height_mm == pytest.approx(true.peak_height_mm, rel=0.02)
        assert pad.reference_mm == pytest.approx(board.pad_surface_mm, abs=1e-6)
        assert pad.coverage == 1.0
        assert pad.bridged_to == ()


def test_threshold_removes_what_the_mesh_predicts(
    scene: scenes.Scene, heights: decode.Reconstruction
) -> None:
    board = scenes.board_truth(scene)
    for threshold in (0.04, 0.08):
        assert scene.board is not None
        shares = threshold_shares(scene.board, threshold)
        low = measured_pads(heights, board, threshold_mm=0.0)
        high = measured_pads(heights, board, threshold_mm=threshold)
        for all_, cut in zip(low, high, strict=True):
            area, volume = shares[cut.pad]
            # Both maps have the same pixels: what is left is the contour's own, half a pixel along it at worst, and it
            # is as high as the threshold.
            rim = 0.5 * PIXEL_MM * 4 * np.sqrt(all_.area_mm2)
            assert abs(cut.area_mm2 - area * all_.area_mm2) < 2 * rim
            assert abs(cut.volume_mm3 - volume * all_.volume_mm3) < 2 * rim * threshold


def test_threshold_removes_more_of_small_pads(scene: scenes.Scene) -> None:
    sizes = {pad.pad: min(pad.size_mm) for pad in scenes.board_truth(scene).pads}
    assert scene.board is not None
    lost = {pad: 1.0 - volume for pad, (_, volume) in threshold_shares(scene.board, 0.08).items()}
    smallest, largest = min(sizes, key=sizes.__getitem__), max(sizes, key=sizes.__getitem__)
    assert lost[smallest] > 1.5 * lost[largest] > 0


def test_tilted_and_raised_board_measures_the_same(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    x = heights.xyz_mm[..., 0]
    y = heights.xyz_mm[..., 1]
    # 0.5 degrees and 30 um: within the tolerance of a board on its table.
    tilted = replace(heights, height_mm=(heights.height_mm + 0.03 + 0.009 * x - 0.004 * y))
    flat = measured_pads(heights, board)
    for pad, level in zip(measured_pads(tilted, board), flat, strict=True):
        assert pad.volume_mm3 == pytest.approx(level.volume_mm3, rel=1e-3)
        assert pad.offset_x_mm == pytest.approx(level.offset_x_mm, abs=1e-4)


@pytest.mark.slow
def test_bare_board_scan_removes_the_copper_step(scene: scenes.Scene) -> None:
    # Copper under the mask all around raises the board by 35 um: if assumed to be mask on laminate, all paste reads lower.
    board = scenes.board_truth(scene)
    rec = exact(scene)
    raised = np.where(np.abs(rec.height_mm - board.mask_surface_mm) < 1e-5, 0.035, 0.0)
    on_copper = replace(rec, height_mm=(rec.height_mm + raised).astype(np.float32))
    bare = exact(scene_of(board__defects__missing__probability=1.0))
    with_scan = measured_pads(on_copper, board, bare=bare)
    without_scan = measured_pads(on_copper, board)
    for flat, one, other in zip(measured_pads(rec, board), with_scan, without_scan, strict=True):
        # The same pixels, the same heights; float32 rounds them at 2e-9 mm.
        assert one.volume_mm3 == pytest.approx(flat.volume_mm3, rel=1e-5)
        assert other.volume_mm3 < flat.volume_mm3 - 0.03 * flat.area_mm2


def test_noise_below_the_threshold_adds_no_volume(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    rng = np.random.default_rng(3)
    sigma = 0.005
    noisy = replace(
        heights,
        height_mm=(heights.height_mm + rng.normal(0, sigma, heights.height_mm.shape)).astype("f4"),
    )
    for pad, clean in zip(measured_pads(noisy, board), measured_pads(heights, board), strict=True):
        pixels = clean.area_mm2 / PIXEL_MM**2
        # Independent pixels average out, and the plane is fitted to thousands: 5 sd of the mean height. At the rim
        # some pixels cross the threshold either way: as many as are within a sigma of it, one row or two around.
        rim = 4 * np.sqrt(clean.area_mm2) * 2 * PIXEL_MM
        bound = clean.area_mm2 * sigma * 5 * np.sqrt(1 / pixels + 1 / 2000) + rim * sigma
        assert abs(pad.volume_mm3 - clean.volume_mm3) < bound
        assert abs(pad.peak_height_mm - clean.peak_height_mm) < 5 * sigma


def test_pad_that_was_not_seen_is_not_measured(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    x = heights.xyz_mm[..., 0]
    reason = np.where(x > 0.0, decode.Reason.SHADOW, heights.reason).astype(np.uint8)
    for pad, true in zip(
        measured_pads(replace(heights, reason=reason), board), board.pads, strict=True
    ):
        assert (pad.volume_mm3 is None) == (true.x_mm > 0.0)
        assert (pad.coverage < 0.5) == (true.x_mm > 0.0)
        assert judge(pad, true, PadLimits())[0] == ("unmeasured" if true.x_mm > 0.0 else "pass")


@pytest.mark.parametrize(
    ("known", "shine", "height_mm", "verdict"),
    [
        (0.1, 0.9, 0.0, "missing"),
        # overexposed paste: its measured part is above the threshold
        (0.1, 0.9, 0.1, "unmeasured"),
        # nothing is measured
        (0.0, 1.0, 0.0, "unmeasured"),
        # dark, not shining
        (0.1, 0.2, 0.0, "unmeasured"),
    ],
)
def test_bare_pads_are_missing_and_overexposed_ones_unmeasured(
    known: float,
    shine: float,
    height_mm: float,
    verdict: str,
    scene: scenes.Scene,
    heights: decode.Reconstruction,
) -> None:
    board = scenes.board_truth(scene)
    truth = render.truth(scene)
    on_pads = truth.height_mm > board.mask_surface_mm + 0.01
    draw = np.random.default_rng(0).random(on_pads.shape)
    reason = np.select(
        [draw < known, draw < known + shine],
        [decode.Reason.OK, decode.Reason.SATURATED],
        decode.Reason.SHADOW,
    )
    seen = replace(
        heights,
        reason=np.where(on_pads, reason, heights.reason).astype(np.uint8),
        height_mm=np.where(on_pads, board.pad_surface_mm + height_mm, heights.height_mm).astype(
            np.float32
        ),
    )
    for pad, true in zip(measured_pads(seen, board), board.pads, strict=True):
        assert pad.volume_mm3 is None
        assert judge(pad, true, PadLimits()) == (verdict,)


@pytest.mark.parametrize(
    ("defect", "settings", "verdict"),
    [
        ("missing", {}, "missing"),
        ("insufficient", {"volume": 0.3}, "insufficient"),
        ("excess", {"volume": 2.0}, "excess"),
        ("high_area", {"area": 1.8}, "high-area"),
        ("offset", {"distance": 0.4}, "offset"),
        ("bridge", {"height_mm": 0.1, "width_mm": 0.2, "longest_mm": 0.6}, "bridge"),
    ],
)
def test_each_defect_is_judged_from_exact_heights_as_from_the_truth(
    defect: str, settings: dict[str, float], verdict: str
) -> None:
    probability: dict[str, Any] = {f"board__defects__{defect}": {"probability": 1.0, **settings}}
    defective = scene_of(**probability)
    board = scenes.board_truth(defective)
    # At the default threshold the flattest of these deposits would not be seen at all.
    measured = measured_pads(exact(defective), board, threshold_mm=0.01, reach_mm=0.3)
    table = confusion(measured, board)
    gate = table.gates[verdict]
    assert gate.caught > 0
    assert gate.escaped == gate.false_calls == 0
    assert table.gates["any"].escaped == 0
    assert table.verdicts[defect.replace("_", "-")][verdict] == gate.caught


def test_a_short_reach_leaves_the_reference_where_it_is(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    # The mask's opening ends farther from the aperture than this reach, and is no bare board for it.
    default, short = (
        [pad.reference_mm for pad in measured_pads(heights, board, **reach)]
        for reach in ({}, {"reach_mm": 0.01})
    )
    assert short == default


@pytest.mark.parametrize("highest", [True, False])
def test_figures_at_the_limits_are_accepted(board: BoardTruth, highest: bool) -> None:
    true = board.pads[0]
    volume = 100.0 * true.volume_mm3 / true.nominal_volume_mm3
    area = 100.0 * true.area_mm2 / true.aperture_area_mm2
    limits = PadLimits(
        volume_percent=(0.0, volume) if highest else (volume, 1e3),
        area_percent=(0.0, area) if highest else (area, 1e3),
        missing_percent=volume,
        peak_mm=true.peak_height_mm,
    )
    assert judge(true, true, limits) == ("pass",)


@pytest.mark.parametrize(
    ("percent", "verdict"), [(9.9, "missing"), (10.1, "insufficient"), (50.1, "pass")]
)
def test_a_tenth_of_the_nominal_volume_is_missing_and_half_is_insufficient(
    board: BoardTruth, percent: float, verdict: str
) -> None:
    """The defaults that the reference states."""
    true = board.pads[0]
    pad = true.model_copy(update={"volume_mm3": percent / 100.0 * true.nominal_volume_mm3})
    assert judge(pad, true, PadLimits()) == (verdict,)


def test_errors_of_pads_are_those_made_on_purpose(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    percent = (1.0, -4.0, 2.0, 0.0, -1.0, 2.0)
    measured = [
        replace(pad, volume_mm3=(1.0 + error / 100.0) * true.volume_mm3)
        for pad, true, error in zip(measured_pads(heights, board), board.pads, percent, strict=True)
    ]
    found = pad_errors(measured, board)
    # Their mean is 0, and their mean square (1 + 16 + 4 + 0 + 1 + 4) / 6.
    assert found.volume_bias_percent == pytest.approx(0.0, abs=1e-9)
    assert found.volume_sd_percent == pytest.approx(np.sqrt(26.0 / 6.0))
    assert found.volume_max_percent == pytest.approx(4.0)


def test_confusion_counts_escapes_and_false_calls(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    measured = list(measured_pads(heights, board))
    # Two pads that are good are read as half empty, and the truth's third is called empty though read full.
    for i in (0, 1):
        measured[i] = replace(measured[i], volume_mm3=0.3 * board.pads[i].nominal_volume_mm3)
    pads = list(board.pads)
    pads[2] = pads[2].model_copy(update={"volume_mm3": 0.3 * pads[2].nominal_volume_mm3})
    table = confusion(measured, board.model_copy(update={"pads": tuple(pads)}))
    gate = table.gates["insufficient"]
    assert (gate.caught, gate.escaped, gate.false_calls, gate.passed) == (0, 1, 2, 3)


def test_boards_and_parameters_that_do_not_fit_are_refused(
    board: BoardTruth, heights: decode.Reconstruction
) -> None:
    with pytest.raises(ScoreError, match="threshold_mm = -1"):
        measured_pads(heights, board, threshold_mm=-1.0)
    with pytest.raises(ScoreError, match="no calibration"):
        measured_pads(replace(heights, calibration=None), board)
    with pytest.raises(ScoreError, match="no pads in its region"):
        measured_pads(heights, board.model_copy(update={"pads": ()}))
    measured = measured_pads(heights, board)
    with pytest.raises(ScoreError, match="not the same"):
        pad_errors(measured[1:], board)
    with pytest.raises(ScoreError, match="no pad of 0"):
        pad_errors(measured, board, min_size_mm=5.0)


@pytest.mark.slow
def test_four_projectors_without_noise_measure_volume_to_one_percent_where_one_leaves_shadow() -> (
    None
):
    """The acceptance of measured volume: diffuse paste, ideal rig, pads of 0.3 mm and more, pixels of 5 um."""
    scene = scene_of(4, camera__resolution=[480, 360])
    transport = render.trace(scene)
    stack = render.expose(transport, noise=False)
    truth = render.truth(scene, transport)
    board = scenes.board_truth(scene)
    paste = truth.region("paste")
    four, one = decode.reconstruct(stack), decode.reconstruct(stack, projector=0)
    # Threshold 0 would count the rounding of single pixels; 2 um is a fiftieth of a deposit.
    measured = measured_pads(four, board, threshold_mm=0.002)
    smallest = 0.299  # the polygon of a 0.3 mm disk is 0.1 um narrower
    assert sum(min(pad.size_mm) >= smallest for pad in board.pads) == 6
    for pad, true in zip(measured, board.pads, strict=True):
        assert pad.volume_mm3 == pytest.approx(true.volume_mm3, rel=0.01), true.name
    errors = pad_errors(measured, board, smallest)
    assert errors.unmeasured == 0
    shadow = paste & ~truth.lit_by[0]
    assert shadow.sum() > 0.01 * paste.sum()
    assert four.valid[paste].mean() >= 0.99
    assert four.valid[shadow].mean() >= 0.99
    assert one.valid[shadow].mean() < 0.5
    # The nearest valid height replaces the shadow next to paste: one projector's volumes are off by more.
    alone = pad_errors(measured_pads(one, board, threshold_mm=0.002), board, smallest)
    assert alone.volume_max_percent > 2 * errors.volume_max_percent
