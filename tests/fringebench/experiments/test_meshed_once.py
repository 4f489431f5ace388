"""A scene's meshes, a quarter of a second on larger ones, are made once for its light, its truth and all its variants."""

from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

import render
import scenes
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import attempt
from fringebench.experiments.cause_budget import budget
from fringebench.experiments.hdr_comparison import compare
from fringebench.verbs import run
from scenes.shapes.solids import Plate

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
