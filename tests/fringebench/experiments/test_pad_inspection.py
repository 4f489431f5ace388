"""Inspection of a rendered board, its budget and its gauge study, on a board of two chips."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from fringebench.experiments.pad_inspection import gauge, inspect, pad_budget
from scenes.support.errors import SceneError
from tests.conftest import Call

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


@pytest.mark.slow
def test_ideal_board_is_measured_well_and_one_projector_measures_it_worse(
    scene: scenes.Scene,
) -> None:
    laser = scene.projectors[0].model_copy(update={"speckle_contrast": 0.1})
    projectors = (laser, *scene.projectors[1:])
    rows = pad_budget(scene.model_copy(update={"projectors": projectors}))
    assert set(rows) == {
        *("ideal", "one projector", "metal", "grains", "interreflection", "noise"),
        *("threshold", "psf", "speckle", "render-noise"),
        *("metal, interreflection", "metal, grains, interreflection", "all"),
    }
    # Along the 2.4 mm around a pad of 0.35 mm2 half a pixel of 10 um is 3.4 % of its area; the rim is at a third of
    # the plateau.
    assert abs(rows["ideal"].volume_bias_percent) < 3.4 * 0.5
    assert abs(rows["one projector"].volume_bias_percent) > abs(rows["ideal"].volume_bias_percent)
    # What the threshold takes is volume; noise only widens.
    assert rows["threshold"].volume_bias_percent < rows["ideal"].volume_bias_percent
    assert rows["threshold"].area_bias_percent < rows["ideal"].area_bias_percent
    assert rows["psf"].volume_bias_percent < rows["ideal"].volume_bias_percent
    assert all(row.pads == 4 for row in rows.values())


def test_gauge_study_separates_noise_from_places_and_pads(scene: scenes.Scene) -> None:
    volume = {"kind": "uniform", "low": 0.6, "high": 1.4}
    board = scenes.load("spi", SETTINGS | {"board.paste.volume": volume}).board
    uneven = scene.model_copy(update={"board": board})
    study = gauge(uneven, appraisers=2, repeats=2, shift_mm=0.04)
    assert study.parts.degrees == 3
    assert study.repeatability.degrees == 4 * 2
    # Noise of a pixel is a micrometre or so, a pad has thousands.
    assert 0.0 < study.ev < 0.5
    pads = scenes.board_truth(uneven).pads
    spread = np.std([100.0 * p.volume_mm3 / p.nominal_volume_mm3 for p in pads], ddof=1)
    assert spread > 15.0
    # Rims are measured up to 5 % too low, by 1.5 % more or less from pad to pad: a tenth of this spread.
    assert study.pv == pytest.approx(spread, rel=0.15)


def test_command_prints_what_it_measured(
    scene: scenes.Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    path = tmp_path / "board.toml"
    scenes.save(scene, path)
    answer = json.loads(call("pads", path, "--json")[1])
    found = inspect(scene)
    assert answer["errors"] == asdict(found.errors)
    assert [pad["pad"] for pad in answer["pads"]] == [1, 2, 3, 4]
    assert answer["confusion"] == json.loads(json.dumps(found.confusion.to_dict()))
    monkeypatch.setenv("COLUMNS", "60")
    status, printed, _ = call("pads", path, "--budget", "--set=camera.resolution=[100,75]")
    assert status == 0
    assert "accept or reject" in printed and "metal, interreflection" in printed
    # as rich shortens what does not fit: a figure cut short is a wrong one
    assert "…" not in printed


def test_command_writes_machines_columns_of_scenes_and_of_frames(
    scene: scenes.Scene, tmp_path: Path, call: Call
) -> None:
    def pads(*words: object) -> dict[str, Any]:
        status, out, err = call("pads", *words, "--json")
        assert status == 0, err
        answer: dict[str, Any] = json.loads(out)
        return answer

    scenes.save(scene, tmp_path / "board.toml")
    measured, true = tmp_path / "measured.csv", tmp_path / "truth.csv"
    of_scene = pads(tmp_path / "board.toml", "-o", measured, "--truth", true)
    board = scenes.board_truth(scene)
    found = evaluation.confusion(evaluation.read_spi_csv(measured), board)
    assert json.loads(json.dumps(found.to_dict())) == of_scene["confusion"]
    assert len(evaluation.read_spi_csv(true)) == 4
    # The same frames as a file, and as if they were a capture of which only the artwork is known.
    render.expose(render.trace(scene)).write(tmp_path / "stack.exr")
    of_frames = pads(tmp_path / "stack.exr", "-o", tmp_path / "again.csv")
    assert of_frames == of_scene
    assert (tmp_path / "again.csv").read_text() == measured.read_text()
    capture = pads(tmp_path / "stack.exr", "--board", tmp_path / "board.toml")
    assert capture["pads"] == of_scene["pads"]
    assert sum(capture["verdicts"].values()) >= 4


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("stack.exr", "--budget"), "give the scene"),
        (("spi", "--board", "spi"), "give a stack"),
        (("stack.exr", "--board", "spi", "--truth", "t.csv"), "not known"),
    ],
)
def test_command_refuses_options_that_do_not_fit(
    words: tuple[str, ...], message: str, call: Call
) -> None:
    status, _, err = call("pads", *words)
    assert (status, message in err) == (2, True), err


def test_scene_without_a_board_has_no_pads() -> None:
    step = scenes.load("step")
    for ask in (inspect, pad_budget, gauge):
        with pytest.raises(SceneError, match="has no board"):
            ask(step)


def test_four_projectors_light_what_one_leaves_in_shadow() -> None:
    four = scenes.load("spi-four", {"camera.resolution": [320, 240], "sampling.samples": 8})
    transport = render.trace(four)
    truth, stack = render.truth(four, transport), render.expose(transport)
    seen = {
        projector: evaluation.score(decode.reconstruct(stack, projector=projector), truth)
        for projector in (None, 0, 1, 2, 3)
    }
    # Of pixels that one projector or more lights, as scores count: one alone lacks its own shadow, and steep metal that faces
    # away from it.
    paste = {projector: score.regions["paste"].coverage for projector, score in seen.items()}
    all_four = paste.pop(None)
    assert all_four is not None
    assert all_four >= 0.99
    assert all(alone is not None and alone < 0.97 for alone in paste.values())
