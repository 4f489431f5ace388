"""Digests change with what the truth depends on, contents of files included, and with nothing else."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import trimesh

import render
import scenes
from scenes.scene_identity import PARTS, identity
from scenes.support.errors import RenderError


def differing(one: scenes.Scene, other: scenes.Scene) -> list[str]:
    mine, its = identity(one), identity(other)
    return [part for part in PARTS if mine[part] != its[part]]


@pytest.mark.parametrize(
    ("key", "value", "parts"),
    [
        ("camera.fx_px", 4801.0, ["camera"]),
        ("camera.resolution", [320, 240], ["camera"]),
        ("projectors.0.pose.origin_mm", [-60.0, 1.0, 120.0], ["projectors"]),
        ("projectors.0.resolution", [640, 480], ["projectors"]),
        ("objects.1.position_mm", [0.001, 0.0, 0.0], ["objects"]),
        ("objects.1.label", "other", ["objects"]),
        ("objects.1.material", "white-paint", ["materials"]),
        ("projectors.0.gamma", 2.2, []),
        ("projectors.0.irradiance_w_m2", 7.0, []),
        ("camera.vignetting", [-0.2], []),
        ("sampling.samples", 3, []),
        ("exposures", {"times_ms": [3.0]}, []),
        ("sensor", {"kind": "simple", "sigma_dn": 7.0}, []),
        ("name", "other", []),
    ],
)
def test_only_what_the_truth_depends_on_changes_a_digest(
    key: str, value: Any, parts: list[str]
) -> None:
    assert differing(scenes.load("step"), scenes.load("step", {key: value})) == parts


def test_seed_of_a_print_is_part_of_the_board() -> None:
    one, other = (scenes.load("spi", {"board.seed": seed}) for seed in (1, 2))
    assert differing(one, other) == ["board"]


def test_digests_survive_the_scene_s_text() -> None:
    for name in ("spi", "bench", "chapter"):
        scene = scenes.load(name)
        assert identity(scenes.parse(scenes.dumps(scene))) == identity(scene)


def test_a_mesh_counts_by_its_contents_not_by_its_place(tmp_path: Path) -> None:
    file, copy = tmp_path / "part.ply", tmp_path / "copy.ply"
    trimesh.creation.box((2.0, 2.0, 1.0)).export(file)
    shutil.copy(file, copy)
    small = {"camera.resolution": [16, 12], "sampling.samples": 1}

    def scene(path: Path) -> scenes.Scene:
        return scenes.load("step", small | {"objects.1.shape": {"kind": "file", "path": str(path)}})

    light = render.trace(scene(file))
    assert differing(scene(file), scene(copy)) == []
    trimesh.creation.box((2.0, 2.0, 1.5)).export(file)
    assert differing(scene(file), scene(copy)) == ["objects"]
    with pytest.raises(RenderError, match="traced from another scene"):
        render.truth(scene(file), light)
