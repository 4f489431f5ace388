"""Inspection of a rendered board, its budget and its gauge study, on a board of two chips."""

import json
import sys
from dataclasses import asdict

import pytest

import decode
import evaluation
import render
import scenes
from fringebench.cli import main
from fringebench.pads import gauge, inspect, pad_budget
from scenes.errors import SceneError

# Two projectors on either side, 10 um pixels, 3 x 2.25 mm.
SETTINGS = {
    "camera.resolution": [300, 225],
    "camera.field_width_mm": 3.0,
    "projectors.0.resolution": [512, 384],
    "projectors.0.field_width_mm": 4.0,
    "patterns.periods_px": [16.0, 512.0],
    "sampling.samples": 4,
    "sensor.prnu": 0.01,
    "board.size_mm": [4.0, 3.0],
    "board.defects": {},
    "board.parts": [
        {"package": "chip", "size": "0402", "position_mm": [0.0, 0.5]},
        {"package": "chip", "size": "0402", "position_mm": [0.0, -0.4]},
    ],
    "board.region": {"centre_mm": [0.0, 0.0], "size_mm": [3.0, 2.25]},
}


@pytest.fixture(scope="module")
def scene() -> scenes.Scene:
    one = scenes.load("spi", SETTINGS)
    other = one.projectors[0].model_copy(
        update={"pose": one.projectors[0].pose.model_copy(update={"origin_mm": (50.0, 0.0, 100.0)})}
    )
    return one.model_copy(update={"projectors": (one.projectors[0], other)})


def test_an_ideal_board_is_measured_well_and_one_projector_measures_it_worse(
    scene: scenes.Scene,
) -> None:
    rows = pad_budget(scene)
    assert set(rows) == {
        *("ideal", "one projector", "metal", "grains", "interreflection", "noise"),
        *("threshold", "metal, interreflection", "all"),
    }
    # Along the 2.4 mm around a pad of 0.35 mm2 half a pixel of 10 um is 3.4 % of its area; the rim stands at a third of
    # the plateau.
    assert abs(rows["ideal"].volume_bias_percent) < 3.4 * 0.5
    assert abs(rows["one projector"].volume_bias_percent) > abs(rows["ideal"].volume_bias_percent)
    # What the threshold takes is volume; noise only widens.
    assert rows["threshold"].volume_bias_percent < rows["ideal"].volume_bias_percent
    assert rows["threshold"].area_bias_percent < rows["ideal"].area_bias_percent
    assert all(row.pads == 4 for row in rows.values())


def test_a_gauge_study_tells_noise_from_places_and_pads(scene: scenes.Scene) -> None:
    study = gauge(scene, appraisers=2, repeats=2, shift_mm=0.04)
    assert study.parts.degrees == 3
    assert study.repeatability.degrees == 4 * 2
    # Noise of a pixel is a micrometre or so, a pad has thousands: far below the pads' own 6 %.
    assert 0.0 < study.ev < 0.5
    assert study.pv > 2.0


def test_the_command_prints_what_it_measured(
    scene: scenes.Scene,
    tmp_path: object,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = f"{tmp_path}/board.toml"
    scenes.save(scene, path)
    monkeypatch.setattr(sys, "argv", ["fringebench", "pads", path, "--json"])
    main_status(0)
    answer = json.loads(capsys.readouterr().out)
    found = inspect(scene)
    assert answer["errors"] == asdict(found.errors)
    assert [pad["pad"] for pad in answer["pads"]] == [1, 2, 3, 4]
    assert answer["confusion"] == json.loads(json.dumps(found.confusion.to_dict()))
    monkeypatch.setattr(sys, "argv", ["fringebench", "pads", path, "--budget"])
    monkeypatch.setenv("COLUMNS", "60")
    main_status(0)
    printed = capsys.readouterr().out
    assert "accept or reject" in printed and "metal, interreflection" in printed
    # as rich shortens what does not fit: a figure cut short is a wrong one
    assert "…" not in printed


def main_status(expected: int) -> None:
    try:
        main()
        status = 0
    except SystemExit as leaving:
        status = int(leaving.code or 0)
    assert status == expected


def test_a_scene_without_a_board_has_no_pads(capsys: pytest.CaptureFixture[str]) -> None:
    step = scenes.load("step")
    for ask in (inspect, pad_budget, gauge):
        with pytest.raises(SceneError, match="has no board"):
            ask(step)


def test_four_projectors_leave_in_shadow_what_one_does() -> None:
    four = scenes.load("spi-four", {"camera.resolution": [320, 240], "sampling.samples": 8})
    transport = render.trace(four)
    truth, stack = render.truth(four, transport), render.expose(transport)
    seen = {
        projector: evaluation.score(decode.reconstruct(stack, projector=projector), truth)
        for projector in (None, 0, 1, 2, 3)
    }
    # Of what one projector at least lights, as scores count: one alone lacks its own shadow, and steep metal that faces
    # away from it.
    paste = {projector: score.regions["paste"].coverage for projector, score in seen.items()}
    all_four = paste.pop(None)
    assert all_four is not None
    assert all_four >= 0.99
    assert all(alone is not None and alone < 0.97 for alone in paste.values())
