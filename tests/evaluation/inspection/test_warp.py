"""Tilt and bow of a board: its geometry, and what measuring pads makes of it."""

from typing import Any

import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from evaluation.inspection.pad_measurement import PadMeasure, measured_warp
from scenes.board.board_solids import bodies
from scenes.board.warp import WarpedPlane
from scenes.support.errors import ScoreError

BOW = {"slope_x": 0.004, "slope_y": -0.002, "bow_mm": 0.2, "span_mm": 50.0}
PLANE = WarpedPlane(0.004, -0.002, -0.2 / 25.0**2)


def chips(warp: dict[str, float], **overrides: Any) -> scenes.Scene:
    """Six chips over 50 mm, seen without noise under direct light alone."""
    scene = scenes.load(
        "spi",
        {
            "camera.resolution": [640, 480],
            "camera.field_width_mm": 52.0,
            "projectors.0.field_width_mm": 70.0,
            "patterns.periods_px": [16.0, 1024.0],
            "sampling": {"samples": 4, "depth": 1},
            "height_range_mm": [-1.0, 1.0],
            "board.size_mm": [50.0, 38.0],
            "board.parts": [
                {"package": "chip", "size": "1206", "name": f"C{x}{y}", "position_mm": [x, y]}
                for x in (-20.0, 0.0, 20.0)
                for y in (-14.0, 14.0)
            ],
            "board.defects": {},
            "board.paste": {"step_mm": 0.1, "transfer": {"spread": 0.0}},
            "board.warp": warp,
        }
        | overrides,
    )
    paint = scenes.Diffuse(reflectance=0.5)
    assert scene.board is not None
    return scene.model_copy(update={"materials": dict.fromkeys(scene.board.materials, paint)})


def test_warp_lifts_every_point_and_keeps_all_volumes() -> None:
    flat, bent = chips({}), chips(BOW)
    assert flat.board is not None and bent.board is not None
    assert scenes.board_truth(flat) == scenes.board_truth(bent)
    for before, after in zip(bodies(flat.board), bodies(bent.board), strict=True):
        assert before.label == after.label
        bent_z = after.vertices[:, 2] - PLANE.z_mm(after.vertices[:, :2])
        assert set(np.round(bent_z, 9)) == set(np.round(before.vertices[:, 2], 9))
        corners = after.vertices[after.faces]
        up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
        first = before.vertices[before.faces]
        flat_up = np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0])[:, 2]
        # Seen from above both cover the same area; tops point up.
        assert up.sum() == pytest.approx(flat_up.sum(), rel=1e-6)
        if after.label == "mask":
            longest = np.linalg.norm(np.roll(corners, 1, axis=1) - corners, axis=-1).max()
            assert longest < 1.5


def test_warp_of_references_is_found_and_pads_in_a_row_are_refused() -> None:
    truth = scenes.board_truth(chips({}))
    z = PLANE.z_mm(np.array([(pad.x_mm, pad.y_mm) for pad in truth.pads]))
    pads = [PadMeasure(p.pad, p.name, 1.0, float(at)) for p, at in zip(truth.pads, z, strict=True)]
    found = measured_warp(pads, truth)
    assert found.slope_x == pytest.approx(PLANE.slope_x)
    assert found.curvature_per_mm == pytest.approx(PLANE.curvature_per_mm)
    with pytest.raises(ScoreError, match="four are needed"):
        measured_warp(pads[:3], truth)


@pytest.mark.slow
def test_warp_of_a_fifth_of_a_millimetre_is_measured_and_removed() -> None:
    measured = {}
    for name, warp in (("flat", {}), ("bent", BOW)):
        scene = chips(warp)
        stack = render.expose(render.trace(scene), noise=False)
        board = scenes.board_truth(scene)
        measured[name] = evaluation.measure_pads(decode.reconstruct(stack), board)
    found = measured_warp(measured["bent"], board)
    # A micrometre at the board's edge, 25 mm from its middle.
    assert found.slope_x == pytest.approx(PLANE.slope_x, abs=1e-3 / 25)
    assert found.slope_y == pytest.approx(PLANE.slope_y, abs=1e-3 / 25)
    assert found.curvature_per_mm == pytest.approx(PLANE.curvature_per_mm, abs=1e-3 / 25**2)
    for flat, bent in zip(measured["flat"], measured["bent"], strict=True):
        assert bent.mean_height_mm == pytest.approx(flat.mean_height_mm, abs=1e-3)
