"""Measured maps of illumination against the polynomial that they were sampled from, and as files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import decode
import render
import scenes
from scenes.support.errors import FileError, SceneError

Floats = NDArray[np.float64]
FALL = -0.4
SIZE = (96, 72)
SMALL: dict[str, Any] = {"camera.resolution": [96, 72], "sampling.samples": 4, "sampling.depth": 1, "sensor.psf": "none"}  # fmt: skip


def sampled(columns: int, rows: int) -> Floats:
    """``1 + a r^2`` at the centres of so many cells of an image of 4 : 3, r = 1 in the corners."""
    x, y = (np.arange(columns) + 0.5) / columns - 0.5, (np.arange(rows) + 0.5) / rows - 0.5
    return np.asarray(1.0 + FALL * 4.0 * ((x * 4) ** 2 + (y[:, None] * 3) ** 2) / 25.0)


def miss(columns: int, rows: int) -> float:
    """How far linear interpolation is off: an eighth of the curvature, and as much where it is divided by the centre's; half
    a cell's slope at the border, where it is constant."""
    curvature = -FALL * 8.0 / 25.0
    inside = curvature * ((4 / columns) ** 2 + (3 / rows) ** 2) / 8.0
    return float(2.0 * inside + curvature * (2 * 2 / columns + 1.5 * 1.5 / rows))


def light(**more: Any) -> render.Transport:
    return render.trace(scenes.load("step", SMALL | {k.replace("__", "."): v for k, v in more.items()}))  # fmt: skip


@pytest.mark.parametrize("device", ["camera", "projectors__0"])
@pytest.mark.parametrize("cells", [(96, 72), (1024, 768), (40, 30)])
def test_map_of_a_polynomial_is_that_polynomial(
    device: str, cells: tuple[int, int], tmp_path: Path
) -> None:
    np.save(tmp_path / "map.npy", 7.0 * sampled(*cells))
    measured = light(**{f"{device}__illumination_map__path": str(tmp_path / "map.npy")})
    formula = light(**{f"{device}__vignetting": [FALL]})
    even = light()
    for one, two in zip(*(render.through_lens(t).total[0] for t in (measured, formula)), strict=True):  # fmt: skip
        # Float32 through some ten operations.
        atol = (miss(*cells) + 1e-6) * float(np.abs(even.total[0]).max())
        np.testing.assert_allclose(one, two, atol=atol)
    # The comparison sees the map.
    assert np.abs(render.through_lens(measured).total - render.through_lens(even).total).max() > 0.05 * even.total.max()  # fmt: skip


def test_camera_pixels_read_a_map_of_their_size_as_it_is(tmp_path: Path) -> None:
    values = np.random.default_rng(0).uniform(0.5, 2.0, SIZE[::-1])
    np.save(tmp_path / "map.npy", values.astype(np.float32))
    Image.fromarray(np.rint(values * 20000).astype(np.uint16)).save(tmp_path / "map.png")
    camera = scenes.load("step", SMALL).camera
    column, row = np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1])[:, None] + 0.5
    centre = values[35:37, 47:49].mean()
    for name in ("map.npy", "map.png"):
        one = camera.model_copy(update={"illumination_map": scenes.IlluminationMap(path=tmp_path / name)})  # fmt: skip
        # A level of 16 bits is 1e-4 of the darkest value.
        np.testing.assert_allclose(one.relative_illumination(column, row), values / centre, rtol=2e-4)  # fmt: skip


def test_stack_names_the_file_and_decodes_without_it(tmp_path: Path) -> None:
    np.save(tmp_path / "flat.npy", sampled(40, 30))
    text = scenes.dumps(scenes.load("step", SMALL))
    (tmp_path / "mine.toml").write_text(text.replace("[camera.pose]", '[camera.illumination_map]\npath = "flat.npy"\n\n[camera.pose]'))  # fmt: skip
    scene = scenes.load(tmp_path / "mine.toml")
    named = scene.camera.illumination_map
    assert named is not None
    assert named.path == tmp_path / "flat.npy"
    transport = render.trace(scene)
    stack = render.expose(transport)
    transport.write(tmp_path / "light.exr")
    stack.write(tmp_path / "stack.exr")
    assert str(named.sha256) in scenes.Stack.read(tmp_path / "stack.exr").scene
    np.testing.assert_array_equal(render.expose(render.Transport.read(tmp_path / "light.exr")).frames, stack.frames)  # fmt: skip

    np.save(tmp_path / "flat.npy", sampled(41, 30))
    with pytest.raises(FileError, match="has changed"):
        render.expose(render.Transport.read(tmp_path / "light.exr"))
    (tmp_path / "flat.npy").unlink()
    assert decode.reconstruct(scenes.Stack.read(tmp_path / "stack.exr")).valid.any()
    with pytest.raises(FileError, match="does not exist"):
        render.expose(render.Transport.read(tmp_path / "light.exr"))


BAD: dict[str, Any] = {
    "dark.npy": np.eye(4), "cube.npy": np.ones((3, 4, 5)), "words.npy": np.array([["a"]]), "waves.npy": np.ones((3, 4)) * 1j,
    "gap.npy": np.array([[1.0, np.nan]]), "steep.npy": np.array([[1.0, 1e300]]), "empty.npy": np.ones((0, 3)),
    "wide.npy": np.ones((1, 9000)), "object.npy": np.array([[{}]]), "colour.png": Image.new("RGB", (4, 3), (9, 9, 9)),
    "cut.npy": b"\x93NUMPY\x01\x00", "text.tif": b"no image", "text.npy": b"no array", "gone.npy": None,
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_files_that_are_no_maps_are_refused_when_a_scene_is_loaded(
    name: str, tmp_path: Path
) -> None:
    file, content = tmp_path / name, BAD[name]
    if isinstance(content, Image.Image):
        content.save(file)
    elif isinstance(content, bytes):
        file.write_bytes(content)
    elif content is not None:
        np.save(file, content)
    with pytest.raises(SceneError, match=f"illumination map '.*{name}'"):
        scenes.load("step", {"camera.illumination_map.path": str(file)})
