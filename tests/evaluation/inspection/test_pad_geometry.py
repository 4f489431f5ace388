"""Pads seen in perspective, and pads with an unmeasured gap between them."""

import numpy as np
import pytest

import decode
import render
import scenes
from evaluation.inspection.pad_measurement import measure_pads
from scenes.rig.devices import LookAt, Pinhole
from tests.evaluation.inspection.test_pad_measurement import exact, scene_of

DISTANCE_MM = 20.0


def perspective(scene: scenes.Scene) -> scenes.Calibration:
    """The scene's rig with a pinhole camera 20 mm above the pads, which sees the same field there."""
    cols, rows = scene.camera.resolution
    focal_px = DISTANCE_MM * cols / 2.4
    surface_mm = scenes.board_truth(scene).pad_surface_mm
    camera = Pinhole(
        resolution=(cols, rows),
        pose=LookAt(origin_mm=(0.0, 0.0, surface_mm + DISTANCE_MM)),
        fx_px=focal_px, fy_px=focal_px, cx_px=cols / 2.0, cy_px=rows / 2.0,
    )  # fmt: skip
    return scene.calibration().model_copy(update={"camera": camera})


def test_pixels_shrink_with_the_square_of_the_distance() -> None:
    """The same pixels, raised by 1 and by 2 mm: volume per height falls as ((20 - 2) / (20 - 1))^2."""
    scene = scene_of()
    board, truth = scenes.board_truth(scene), render.truth(scene)
    assert truth.pad is not None
    volumes = []
    for raised_mm in (1.0, 2.0):
        height = np.where(truth.pad > 0, board.pad_surface_mm + raised_mm, truth.height_mm)
        rec = decode.Reconstruction.of_heights(height, calibration=perspective(scene))
        pads = measure_pads(rec, board, threshold_mm=0.0)
        volumes.append([(pad.volume_mm3 or 0.0) / raised_mm for pad in pads])
    ratio = np.divide(volumes[1], volumes[0])
    # A pixel at the border may belong to another pad once it has moved inwards by 5 % of its distance from the middle.
    assert float(np.median(ratio)) == pytest.approx((18.0 / 19.0) ** 2, rel=0.01)


def test_paste_on_both_sides_of_an_unmeasured_gap_is_no_bridge() -> None:
    scene = scene_of()
    board, truth = scenes.board_truth(scene), render.truth(scene)
    assert truth.pad is not None
    rec = exact(scene)
    # All that is not paste goes dark; what fills the gaps must not join the pads.
    measured = decode.Reconstruction.of_heights(rec.height_mm, near(truth.pad), scene.calibration())
    pads = measure_pads(measured, board)
    assert [pad.bridged_to for pad in pads] == [()] * len(board.pads)


def near(pad: np.ndarray) -> np.ndarray:
    """Pixels of a pad, and those left of the middle of the image's upper edge, which show the board."""
    mask: np.ndarray = pad > 0
    mask[:40] = True
    return mask
