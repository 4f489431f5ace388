"""The command line as a user meets it: results, files, messages, exit status."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import scenes
from tests.evaluation.test_score import REGION_KEYS

SMALL = ["--set", "camera.resolution=[64,48]", "--set", "sampling.samples=4"]
Call = Callable[..., tuple[int, str, str]]


def test_run_leaves_every_file_and_prints_the_scores(call: Call, tmp_path: Path) -> None:
    status, out, err = call("run", "bench", "-o", tmp_path / "a" / "b", *SMALL)
    assert status == 0, err
    made = {p.name for p in (tmp_path / "a" / "b").iterdir()}
    assert {
        "scene.toml",
        "transport.exr",
        "stack.exr",
        "truth.exr",
        "reconstruction.exr",
        "cloud.ply",
        "scores.json",
    } <= made
    for label in ("base", "cap", "step", "ink", "solder"):
        assert label in out


def test_the_stages_one_by_one_give_what_run_gives(call: Call, tmp_path: Path) -> None:
    status, whole, err = call("run", "step", "--json", "-o", tmp_path / "run", *SMALL)
    assert status == 0, err
    t, s, r, g = (tmp_path / f"{name}.exr" for name in ("t", "s", "r", "g"))
    assert call("render", "step", "-o", t, "--truth", g, *SMALL)[0] == 0
    assert call("expose", t, "-o", s)[0] == 0
    assert call("decode", s, "-o", r)[0] == 0
    status, staged, _ = call("evaluate", r, g, "--json")
    assert status == 0
    assert (
        json.loads(staged)
        == json.loads(whole)
        == json.loads((tmp_path / "run/scores.json").read_text())
    )


def test_scores_json_keeps_its_contract(call: Call, tmp_path: Path) -> None:
    score = json.loads(call("run", "bench", "--json", "-o", tmp_path, *SMALL)[1])
    assert score["scene"] == "bench"
    assert set(score["regions"]) == {"base", "cap", "step", "ink", "solder"}
    assert all(set(REGION_KEYS) <= set(region) for region in score["regions"].values())
    assert all(set(f) == {"measured_mm", "truth_mm"} for f in score["features"].values())


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(
    call: Call, tmp_path: Path
) -> None:
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert call("run", "cap", "-o", tmp_path / name, "--seed", seed, *SMALL)[0] == 0
    read = {name: scenes.Stack.read(tmp_path / name / "stack.exr").frames for name in "abc"}
    np.testing.assert_array_equal(read["a"], read["b"])
    assert (read["a"] != read["c"]).any()


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
        (["run", "cap", "-o", "{file}"], "cannot make the folder"),
        (["run", "cap", "-o", "{file}/deeper"], "cannot make the folder"),
        (["render", "cap", "-o", "{missing}/t.exr"], "cannot write"),
        (["expose", "{missing}.exr"], "does not exist"),
        (["expose", "{text}"], "truncated, damaged or no OpenEXR file"),
        (["decode", "{text}"], "truncated, damaged or no OpenEXR file"),
        (["evaluate", "{text}", "{text}"], "truncated, damaged or no OpenEXR file"),
        (["run", "--seed", "-1"], "--seed"),
        (["rn"], "No such command"),
    ],
)
def test_bad_input_is_one_message_status_2_and_no_harm(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "file.exr"
    file.write_text("mine")
    words = [w.format(file=file, text=file, missing=tmp_path / "missing") for w in words]
    status, out, err = call(*words)
    assert status == 2
    assert said in err.replace("\n", " ")
    assert "Traceback" not in err + out
    assert file.read_text() == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["file.exr"]


def test_an_empty_region_of_interest_is_refused(call: Call, tmp_path: Path) -> None:
    call("run", "step", "-o", tmp_path, *SMALL)
    before = (tmp_path / "reconstruction.exr").read_bytes()
    status, _, err = call(
        "decode",
        tmp_path / "stack.exr",
        "-o",
        tmp_path / "reconstruction.exr",
        "--roi",
        *["5", "5", "0", "9"],
    )
    assert status == 2
    assert "is empty" in err
    assert (tmp_path / "reconstruction.exr").read_bytes() == before


def test_a_file_of_another_stage_is_named(call: Call, tmp_path: Path) -> None:
    call("run", "step", "-o", tmp_path, *SMALL)
    status, _, err = call("decode", tmp_path / "truth.exr", "-o", tmp_path / "r.exr")
    assert status == 2
    assert "is a truth file where a stack file is expected" in err


def test_every_shipped_scene_is_listed_printed_and_loads_from_its_print(
    call: Call, tmp_path: Path
) -> None:
    listed = json.loads(call("scenes", "--json")[1])
    assert set(listed) == set(scenes.shipped())
    assert all(listed.values()), "a scene without a description teaches nothing"
    for name in listed:
        (tmp_path / "mine.toml").write_text(call("scenes", name)[1])
        assert scenes.load(tmp_path / "mine.toml") == scenes.load(name)


def test_the_schema_names_the_keys(call: Call) -> None:
    schema = json.loads(call("scenes", "--schema")[1])
    assert {"camera", "projectors", "objects", "patterns", "sensor", "exposures"} <= set(
        schema["properties"]
    )


def test_doctor_finds_this_machine_healthy(call: Call) -> None:
    status, out, _ = call("doctor", "--json")
    found = json.loads(out)
    assert status == 0
    assert found["healthy"]
    assert found["variant"] in {"llvm_ad_mono", "cuda_ad_mono"}


def test_help_shows_an_example_for_every_command(call: Call) -> None:
    commands = [line.split()[1] for line in call("--help")[1].splitlines() if line.startswith("│ ")]
    commands = [c for c in commands if not c.startswith("-") and c.islower()]
    for command in {"run", "scenes", "chapter", "doctor"} | (
        set(commands) & {"compare", "regress", "budget"}
    ):
        assert f"fringebench {command}" in call(command, "--help")[1]


def test_asking_for_help_does_not_wait_for_a_renderer() -> None:
    code = "import sys; sys.argv=['fringebench','scenes']; from fringebench.cli import main\n"
    code += "try: main()\nexcept SystemExit: pass\nprint('mitsuba' in sys.modules, 'drjit' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False False"
