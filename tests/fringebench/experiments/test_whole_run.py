"""Whole runs: into the folder of an earlier one, with mistakes, and what they do once for all."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import decode
import render
import scenes
from fringebench import run
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import attempt
from fringebench.experiments.cause_budget import budget
from fringebench.experiments.hdr_comparison import compare
from fringebench.experiments.whole_run import FILES, middle_exposure_alone
from scenes.acquisition.patterns import PhaseShift
from scenes.shapes.solids import Plate
from scenes.support.errors import DecodeError, FileError, RenderError
from tests.conftest import Call
from tests.decode.synthetic import calibrated_stack, hills, rig

SMALL = {"camera.resolution": [24, 18], "sampling.samples": 2}
# From below the plate the camera sees nothing lit: light is traced, and then no exposure suits it.
DARK = SMALL | {"camera.pose.origin_mm": [0.0, 0.0, -300.0]}


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture
def earlier(small_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_run, tmp_path / "run"))


def test_failed_run_keeps_the_files_of_an_earlier_run(earlier: Path) -> None:
    before = contents(earlier)
    assert set(before) == set(FILES)
    with pytest.raises(RenderError, match="is dark"):
        run(scenes.load("bench", DARK | {"exposures.auto.label": "base"}), earlier)
    assert contents(earlier) == before


def test_successful_run_replaces_every_file_of_an_earlier_run(earlier: Path) -> None:
    before = contents(earlier)
    result = run(scenes.load("cap", SMALL), earlier, seed=1)
    after = contents(earlier)
    assert set(after) == set(before)
    assert not [name for name in FILES if after[name] == before[name]]
    assert result.seconds["write"] > 0.0


def test_failed_run_in_an_empty_folder_keeps_its_light(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="is dark"):
        run(scenes.load("step", DARK), tmp_path)
    assert render.Transport.read(tmp_path / "transport.exr").scene.name == "step"
    assert not (tmp_path / "stack.exr").exists()


def test_folder_with_files_of_two_runs_is_reported(
    earlier: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(self: decode.Reconstruction, path: Path) -> None:
        raise FileError(f"cannot write '{path}': No space left on device")

    monkeypatch.setattr(decode.Reconstruction, "write", full)
    with pytest.raises(
        FileError, match=r"No space left.*scene\.toml.*stack\.exr.* are of this run"
    ):
        run(scenes.load("cap", SMALL), earlier)


def test_misspelt_fusion_rule_is_refused_before_light_is_traced(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_light(*_: object, **__: object) -> None:
        pytest.fail("light was traced")

    monkeypatch.setattr(render, "trace", no_light)
    status, _, err = call("run", "step", "-o", tmp_path / "out", "--fusion", "max-modulatoin")
    assert (status, "did you mean 'max-modulation'?" in err) == (2, True)
    assert not list(tmp_path.iterdir())
    with pytest.raises(DecodeError, match="did you mean 'max-modulation'"):
        budget(scenes.load("step", SMALL), fusion="max-modulatoin")


def test_run_and_single_take_the_same_exposure() -> None:
    made = calibrated_stack(rig(), hills(), PhaseShift(periods_px=(16.0, 80.0)), sigma_dn=1.0)
    times = (4.0, 1.0, 2.0)
    frames = np.concatenate([made.frames * t for t in times])
    stack = replace(made, frames=frames, exposure_ms=times)
    alone = middle_exposure_alone(stack)
    assert alone.exposure_ms == (2.0,)
    chosen = int(decode.reconstruct(stack, fusion="single").exposure[0, 0])
    assert stack.exposure_ms[chosen] == 2.0


SCENE = scenes.load("step", {"camera.resolution": [32, 24], "sampling.samples": 4})


def sample(folder: Path) -> None:
    plan = DatasetPlan.of(SCENE, 1)
    assert attempt(plan, plan.load_scene(), 0, folder).status == "made"


WAYS: dict[str, Callable[[Path], object]] = {
    "run": lambda folder: run(SCENE, folder),
    "passes to a phase error": lambda folder: render.trace(SCENE, phase_error_rad=0.05),
    "data set": sample,
    "compare": lambda folder: compare(SCENE, repeats=1),
    "budget": lambda folder: budget(SCENE, repeats=1),
}


@pytest.mark.parametrize("way", WAYS)
def test_scene_is_meshed_once(way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Plate] = []
    own = Plate.mesh

    def counted(plate: Plate) -> trimesh.Trimesh:
        made.append(plate)
        return own(plate)

    monkeypatch.setattr(Plate, "mesh", counted)
    WAYS[way](tmp_path)
    # The scene's one plate is its base.
    assert len(made) == 1
