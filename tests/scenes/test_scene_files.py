"""Scenes from TOML: what is accepted, what is refused, and how the refusal reads."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import scenes
from scenes.support.errors import FileError, FringebenchError, MeshError, SceneError


def test_shipped_scenes_survive_toml_unchanged() -> None:
    for name in scenes.shipped():
        scene = scenes.load(name)
        assert scenes.parse(scenes.dumps(scene)) == scene, name


def test_documented_scenes_are_shipped() -> None:
    promised = {"cap", "step", "ink", "solder", "bench", "chapter", "chapter-dim", "chapter-trap"}
    assert promised <= set(scenes.shipped())


def test_fewer_pixels_keep_the_field_of_view() -> None:
    for name in ("bench", "chapter"):
        fine, coarse = scenes.load(name), scenes.load(name, {"camera.resolution": [64, 48]})
        a, b = fine.camera.projection(), coarse.camera.projection()
        corner = np.array([[0.0, 0.0], [1.0, 1.0]])
        np.testing.assert_allclose(
            a.rays(corner * [a.width, a.height]), b.rays(corner * [b.width, b.height]), atol=1e-12
        )


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        (
            {"camera.resolutoin": [4, 3]},
            "unknown key 'camera.resolutoin': did you mean 'resolution'",
        ),
        ({"camra": 1}, "unknown key 'camra': did you mean 'camera'"),
        ({"objects.0.shape.sizemm": [1, 2]}, "did you mean 'size_mm'"),
        (
            {"patterns.steps": 2},
            "patterns.steps: Input should be greater than or equal to 3 (got 2)",
        ),
        ({"patterns.periods_px": [16.0, 8.0]}, "finest first, e.g. [8.0, 16.0]"),
        ({"objects.0.material": "gold2"}, "did you mean 'gold'"),
        ({"exposures.auto.label": "bse"}, "not an object's label"),
        (
            {"exposures": {"times_ms": [1.0], "relative": [1.0, 4.0]}},
            "scales what auto finds, but times_ms is given",
        ),
        ({"exposures.times_ms": [1.0]}, "set the whole table: exposures = {times_ms = [2.0, 8.0]}"),
        ({"camera.fx_px": float("nan")}, "camera.fx_px: Input should be a finite number"),
        (
            {"camera.pose": {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 2]], "t_mm": [0, 0, 0]}},
            "no rotation",
        ),
        (
            {"camera.pose.origin_mm": [0, 0, 0]},
            "bench: camera.pose: origin_mm and target_mm coincide",
        ),
        (
            {"camera.model": "fisheye"},
            "bench: camera.model: there is no 'fisheye': known: pinhole, tele",
        ),
        (
            {"sensor.kind": "emva"},
            "bench: sensor.kind: there is no 'emva': did you mean 'emva1288'?",
        ),
        (
            {"camera": {"resolution": [4, 3]}},
            "key 'camera.model' is missing: it is required, one of pinhole, telecentric",
        ),
        ({"board": {}}, "key 'board.kind' is missing: it is required, one of gerber, parametric"),
        ({"camera": 3}, "camera: Input should be a table (got 3)"),
        (
            {"camera.resolution": "160x120"},
            "camera.resolution: Input should be a list (got '160x120')",
        ),
        ({"camera.resolution": [4, 3, 1]}, "The list should have at most 2 items, not 3"),
        ({"projectors.0.pose": {"origin_mm": [0, 0, 300]}}, "no height can be measured"),
        ({"camera.distortion": [-60, 0, 0, 0, 0]}, "folds over"),
        ({"objects.99.label": "x"}, "use 0 to"),
        ({"camera.resolution.x": 3}, "not an index into a list"),
        ({"name.first": 3}, "is a value, not a table"),
        ({"height_range_mm": [3.0, 1.0]}, "must be below"),
    ],
)
def test_bad_key_or_value_is_named_with_what_is_allowed(
    override: dict[str, object], expected: str
) -> None:
    with pytest.raises(SceneError) as caught:
        scenes.load("bench", override)
    assert expected in str(caught.value)


def test_overrides_that_are_not_a_dict_are_refused() -> None:
    wrong: Any
    for wrong in (["camera.fx_px=3"], "camera.fx_px=3", 3):
        with pytest.raises(SceneError, match="give a dict of dotted keys"):
            scenes.load("bench", wrong)


def test_unknown_scene_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(SceneError, match=r"and no TOML file either: did you mean 'bench'\?$"):
        scenes.load("bnch")
    with pytest.raises(FileError, match="does not exist"):
        scenes.load("nowhere/mine.toml")


def test_broken_toml_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("[camera\n")
    with pytest.raises(SceneError, match=r"mine\.toml: not valid TOML.*line 1"):
        scenes.load(path)


def test_failed_save_keeps_the_old_scene(tmp_path: Path) -> None:
    target = tmp_path / "folder"
    target.mkdir()
    with pytest.raises(FringebenchError, match="is a folder"):
        scenes.save(scenes.load("cap"), target)
    with pytest.raises(FileError, match="cannot write"):
        scenes.save(scenes.load("cap"), tmp_path / "missing" / "scene.toml")
    scenes.save(scenes.load("cap"), tmp_path / "scene.toml")
    assert tomllib.loads((tmp_path / "scene.toml").read_text())["name"] == "cap"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["folder", "scene.toml"]


def own_mesh(tmp_path: Path, mesh: trimesh.Trimesh, suffix: str = "stl") -> scenes.Scene:
    mesh.export(tmp_path / f"part.{suffix}")
    text = scenes.source("step").replace(
        'kind = "box", size_mm = [8.0, 8.0, 1.5]', f'kind = "file", path = "part.{suffix}"'
    )
    (tmp_path / "mine.toml").write_text(text)
    return scenes.load(tmp_path / "mine.toml")


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_mesh_file_is_placed_where_the_scene_says(tmp_path: Path, suffix: str) -> None:
    scene = own_mesh(tmp_path, trimesh.creation.box(extents=(2, 4, 6)), suffix)
    np.testing.assert_allclose(scenes.meshes(scene)["step"].extents, [2, 4, 6], atol=1e-6)


def test_broken_or_missing_mesh_file_is_refused(tmp_path: Path) -> None:
    scene = own_mesh(tmp_path, trimesh.creation.box(), "ply")
    (tmp_path / "part.ply").write_bytes(b"ply\nnot really")
    with pytest.raises(MeshError, match="cannot be read"):
        scenes.meshes(scene)
    (tmp_path / "part.ply").unlink()
    with pytest.raises(MeshError, match="does not exist"):
        scenes.meshes(scene)


def test_folder_in_place_of_a_file_is_refused(tmp_path: Path) -> None:
    for read in (scenes.load, scenes.Stack.read):
        with pytest.raises(FileError, match="is a folder: give"):
            read(tmp_path)
