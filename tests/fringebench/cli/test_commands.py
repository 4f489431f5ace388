"""The command line as a user meets it: results, files, messages, exit status."""

import json
from pathlib import Path

import numpy as np
import pytest

import scenes
from tests.commands import program
from tests.conftest import Call
from tests.evaluation.scoring.test_regions import REGION_KEYS

SMALL = ["--set", "camera.resolution=[64,48]", "--set", "sampling.samples=4"]


def test_run_leaves_every_file_and_prints_the_scores(call: Call, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    status, out, err = call("run", "bench", "-o", folder, *SMALL)
    assert status == 0, err
    exr = {f"{name}.exr" for name in ("transport", "stack", "truth", "reconstruction")}
    assert {"scene.toml", "cloud.ply", "scores.json", *exr} <= {p.name for p in folder.iterdir()}
    labels = {"base", "cap", "step", "ink", "solder"}
    assert all(label in out for label in labels)
    score = json.loads((folder / "scores.json").read_text())
    assert score["scene"] == "bench"
    assert set(score["regions"]) == labels
    assert all(set(REGION_KEYS) <= set(region) for region in score["regions"].values())
    assert all(set(f) == {"measured_mm", "truth_mm"} for f in score["features"].values())


def test_stages_one_by_one_give_the_scores_of_run_with_the_same_seed(
    call: Call, tmp_path: Path
) -> None:
    words = ("run", "step", "--json", "-o", tmp_path / "run", "--seed", "3", *SMALL)
    status, whole, err = call(*words)
    assert status == 0, err
    t, s, r, g, o = (tmp_path / f"{name}.exr" for name in ("t", "s", "r", "g", "o"))
    assert call("render", "step", "-o", t, "--truth", g, "--seed", "3", *SMALL)[0] == 0
    assert call("expose", t, "-o", s, "--seed", "3")[0] == 0
    assert call("decode", s, "-o", r)[0] == 0
    status, staged, _ = call("evaluate", r, g, "--json")
    assert status == 0
    written = json.loads((tmp_path / "run/scores.json").read_text())
    assert json.loads(staged) == json.loads(whole) == written
    assert call("expose", t, "-o", o, "--seed", "4")[0] == 0
    frames, same, other = (scenes.Stack.read(p).frames for p in (s, tmp_path / "run/stack.exr", o))
    np.testing.assert_array_equal(frames, same)
    assert (frames != other).any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "bnch"], "did you mean 'bench'"),
        (["run", "bench", "--set", "camera.resolutoin=[4,3]"], "did you mean 'resolution'"),
        (["run", "bench", "--set", "patterns.steps=2"], "greater than or equal to 3"),
        (["run", "bench", "--set", "nonsense"], "write key=value"),
        (
            ["run", "bench", "--set", "projectors.0.pose.origin_mm=[0,0,300]"],
            "no height can be measured",
        ),
        (["run", "nowhere.toml"], "does not exist"),
        (["run", "cap", "-o", "{file}"], "cannot create the folder"),
        (["run", "cap", "-o", "{file}/deeper"], "cannot create the folder"),
        (["render", "cap", "-o", "{missing}/t.exr"], "cannot write"),
        (["expose", "{missing}.exr"], "does not exist"),
        (["compare", "step", "--strategies", ","], "no strategy is named"),
        (["run", "--seed", "-1"], "--seed"),
        (["rn"], "No such command"),
    ],
)
def test_bad_input_is_one_message_and_status_2(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "file.exr"
    file.write_text("mine")
    words = [w.format(file=file, missing=tmp_path / "missing") for w in words]
    status, out, err = call(*words)
    assert status == 2
    assert said in err.replace("\n", " ")
    assert "Traceback" not in err + out
    assert file.read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["file.exr"]


def test_refused_decoding_keeps_the_file_that_was_there(
    call: Call, small_run: Path, tmp_path: Path
) -> None:
    out = tmp_path / "r.exr"
    out.write_text("mine")
    for words, said in (
        (("stack.exr", "--roi", 5, 5, 0, 9), "is empty"),
        (("truth.exr",), "is a truth file where a stack file is expected"),
    ):
        status, _, err = call("decode", small_run / words[0], "-o", out, *words[1:])
        assert (status, said in err) == (2, True), err
    assert out.read_text() == "mine"


def test_every_shipped_scene_is_listed_and_loads_from_its_printed_toml(
    call: Call, tmp_path: Path
) -> None:
    assert json.loads(call("scenes", "--schema")[1]) == scenes.schema()
    listed = json.loads(call("scenes", "--json")[1])
    assert set(listed) == set(scenes.shipped())
    assert all(listed.values()), "a scene without a description teaches nothing"
    for name in listed:
        (tmp_path / "mine.toml").write_text(call("scenes", name)[1])
        assert scenes.load(tmp_path / "mine.toml") == scenes.load(name)


def test_doctor_finds_this_machine_healthy(call: Call) -> None:
    status, out, _ = call("doctor", "--json")
    found = json.loads(out)
    assert status == 0
    assert found["healthy"]
    assert found["variant"] in {"llvm_ad_mono", "cuda_ad_mono"}


def test_listing_scenes_imports_no_renderer() -> None:
    code = "import sys; sys.argv=['fringebench','scenes']; from fringebench.cli.app import main\n"
    code += "try: main()\nexcept SystemExit: pass\nprint('mitsuba' in sys.modules, 'drjit' in sys.modules)"
    assert program(code).stdout.splitlines()[-1] == "False False"
