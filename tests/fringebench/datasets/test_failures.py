"""A sample that cannot be made is recorded and passed over; an output that cannot be written stops the run."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import fringebench
import scenes
from fringebench.datasets.building import build, repair
from fringebench.datasets.dataset_plan import DatasetPlan
from scenes.support.errors import DatasetError

Call = Callable[..., tuple[int, str, str]]


@pytest.fixture
def call(call: Call) -> Call:
    """Run ``fringebench dataset``."""
    return lambda *words: call("dataset", *words)


@pytest.fixture(scope="module")
def fickle(scene_file: Path) -> DatasetPlan:
    """Half of its samples ask for an exposure level beyond saturation: they cannot be."""
    text = scene_file.read_text()
    text += '"exposures.auto.level_dn" = { kind = "choice", values = [1200.0, 9000.0] }\n'
    return DatasetPlan.of(scenes.parse(text), 6, seed=1)


@pytest.mark.usefixtures("here")
def test_failing_sample_is_recorded_and_does_not_stop_the_run(
    fickle: DatasetPlan, tmp_path: Path
) -> None:
    built = build(fickle, tmp_path / "set")
    lost = {record.index for record in built.failed}
    assert 0 < len(lost) < 6
    assert all("level_dn 9000 cannot be reached" in record.reason for record in built.failed)
    assert {s.index for s in fringebench.Dataset(tmp_path / "set")} == set(range(6)) - lost
    assert not any((tmp_path / "set" / f"samples/{i:06d}").exists() for i in lost)
    # Tried again, it fails again: the record stays.
    assert repair(tmp_path / "set").repaired == ()


@pytest.mark.usefixtures("here")
def test_strict_stops_at_the_first_failure_and_keeps_what_was_made(
    fickle: DatasetPlan, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match=r"cannot be made: .*level_dn 9000.*is kept"):
        build(fickle, tmp_path / "set", strict=True)
    assert build(fickle, tmp_path / "set").made < 6


@pytest.mark.usefixtures("here")
def test_set_without_any_sample_is_an_error(scene_file: Path, tmp_path: Path) -> None:
    scene = scenes.load(scene_file, {"exposures.auto.level_dn": 9000.0})
    with pytest.raises(DatasetError, match="none of the 2 samples"):
        build(DatasetPlan.of(scene, 2), tmp_path / "set")


def test_scene_of_which_no_sample_can_be_drawn_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    draws = {"projectors.0.gamma": {"kind": "uniform", "low": -3.0, "high": -2.0}}
    scene = scenes.load("step", {"randomise": draws})
    with pytest.raises(
        DatasetError, match=r"nothing was written; sample 0: .*projectors\.0\.gamma"
    ):
        build(DatasetPlan.of(scene, 1000), tmp_path / "set")
    assert [file for file in (tmp_path / "set").rglob("*") if file.name != ".lock"] == []


def test_output_that_cannot_be_written_stops_the_run_at_once(
    plan: DatasetPlan, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DatasetError, match="cannot use"):
        build(plan, tmp_path / "file" / "set")


def test_folder_full_of_something_else_is_not_taken_over(tmp_path: Path, plan: DatasetPlan) -> None:
    (tmp_path / "dataset.toml").write_text("[tool]\nname = 1\n")
    with pytest.raises(DatasetError, match="is not the plan of a data set"):
        build(plan, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["dataset.toml"]


@pytest.mark.usefixtures("here")
def test_command_makes_verifies_and_repairs(call: Call, scene_file: Path, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    words = (scene_file, "--count", 2, "-o", folder, "--workers", 1, "--json")
    status, out, err = call(*words, "--set", "sampling.depth=1", "--split", "all=1")
    assert status == 0, err
    answer = json.loads(out)
    assert (answer["samples"], answer["made"], answer["failed"]) == (2, 2, [])
    assert answer["splits"] == {"all": 2}
    assert fringebench.Dataset(folder)[0].scene.sampling.depth == 1
    (folder / "samples/000001/truth.exr").unlink()
    status, out, _ = call("--verify", "-o", folder)
    assert status == 1
    assert "samples/000001/truth.exr: missing" in out
    assert call("--repair", "-o", folder, "--workers", 1)[0] == 0
    assert call("--verify", "-o", folder)[0] == 0
    assert {path.name for path in folder.iterdir()} == {
        *("coco", "dataset.toml", "manifest.parquet", "report.html", "samples")
    }


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("spi", "--count", 2), "-o"),
        (("spi", "-o", "x"), "--count"),
        (("nonesuch", "--count", 2, "-o", "x"), "unknown scene"),
        (("spi", "--count", 2, "-o", "x", "--split", "train=0.5"), "sum to 0.5"),
        (("spi", "--count", 2, "-o", "x", "--split", "train"), "name=share"),
        (("spi", "--count", 2, "-o", "x", "--workers", 2, "--scheduler", "y"), "exclude"),
        (("spi", "--count", 2, "-o", "nonesuch://x"), "cannot open 'nonesuch://x'"),
        (("spi", "--count", 2, "-o", "x", "--set", "camera.colour=1"), "unknown key"),
        (("--verify", "-o", "x"), "holds no data set"),
        (("spi", "--count", 2, "-o", ""), "output (-o) is empty"),
        (("spi", "--count", 2, "-o", "file://"), "place of the data set is empty"),
        (("spi", "--count", 2, "-o", "memory://set"), "lost when it ends"),
        (("spi", "--count", 2, "-o", "simplecache::memory://set"), "lost when it ends"),
    ],
)
def test_bad_use_is_one_message_and_leaves_nothing(
    call: Call,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: tuple[object, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, err = call(*words)
    assert status == 2
    assert message in err
    assert "Traceback" not in err
    assert out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_run_from_a_folder_with_a_module_of_our_names_works(
    scene_file: Path, tmp_path: Path
) -> None:
    # Workers must find this project's packages, not those of the user's folder.
    (tmp_path / "scenes.py").write_text("raise RuntimeError('not this one')\n")
    words = ["dataset", str(scene_file), "--count", "1", "-o", "set", "--workers", "1"]
    root = str(Path(fringebench.__file__).parents[1])
    run = subprocess.run(
        [sys.executable, "-P", "-c", "from fringebench.cli.app import main; main()", *words],
        cwd=tmp_path,
        env={**__import__("os").environ, "PYTHONPATH": root},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""  # no progress where there is no terminal
