"""A mesh whose file is in metres is seen by its extent."""

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scenes
from scenes.support.errors import FringebenchWarning


def said(tmp_path: Path, size: float, scale: float = 1.0) -> list[str]:
    """Warnings for a cube of that edge length, in units of the file, on the scene `step`."""
    file = tmp_path / "part.ply"
    trimesh.creation.box((size, size, size)).export(file)
    scene = scenes.load("step")
    shape = {"kind": "file", "path": str(file), "scale": scale}
    tree = scene.model_dump(mode="json")
    tree["objects"][-1]["shape"] = shape
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scenes.parts(scenes.Scene.model_validate(tree))
    return [str(w.message) for w in caught if issubclass(w.category, FringebenchWarning)]


@pytest.mark.parametrize(
    ("size", "scale", "unit"),
    [
        (10.0, 1.0, ""),
        (0.010, 1.0, "metres"),
        (0.010, 1000.0, ""),
        # A grain of dust: too small to be a part in metres either.
        (1e-5, 1.0, ""),
    ],
)
def test_mesh_in_another_unit_is_reported(
    tmp_path: Path, size: float, scale: float, unit: str
) -> None:
    words = said(tmp_path, size, scale)
    assert [f"is in {unit}, set shape.scale = 1000" in text for text in words] == (
        [True] if unit else []
    )


def test_scale_is_millimetres_per_unit_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "box.stl"
    trimesh.creation.box((1.0, 2.0, 3.0)).export(file)
    mesh = scenes.MeshFile(path=file, scale=10.0).mesh()
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (10.0, 20.0, 30.0))
