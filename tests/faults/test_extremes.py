"""Extreme numbers and shapes: the right answer or a clear error, never a warning.

pytest turns warnings into errors, so a case that passes has issued none.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import decode
import evaluation
import render
import scenes
from scenes.files import exr
from scenes.support.errors import DecodeError, FringebenchError, MeshError, RenderError, SceneError

SMALL = {"camera.resolution": [48, 36], "sampling.samples": 4}
STEP = "objects.1.shape"


def through(scene: scenes.Scene) -> tuple[scenes.Truth, decode.Reconstruction, evaluation.Score]:
    """Trace, expose, decode and score in memory."""
    light = render.trace(scene)
    truth = render.truth(scene, light)
    found = decode.reconstruct(render.expose(light))
    return truth, found, evaluation.score(found, truth)


def step(**changes: Any) -> scenes.Scene:
    return scenes.load("step", SMALL | {key.replace("__", "."): v for key, v in changes.items()})


AWAY = {"origin_mm": [50, 0, 100], "target_mm": [50, 0, 300]}
BEYOND: dict[str, tuple[dict[str, Any], type[FringebenchError], str]] = {
    "projector sees nothing": ({"projectors__0__pose": AWAY}, RenderError, "is dark"),
    "camera sees nothing": ({"camera__pose": AWAY}, RenderError, "seen by no pixel"),
    "camera inside the step": (
        {"camera__pose": {"origin_mm": [0, 0, 0.3], "target_mm": [0, 0, 0]}, STEP.replace(".", "__"): {"kind": "box", "size_mm": [50, 50, 1]}},
        RenderError,
        "is dark",
    ),
    "denormal light": ({"projectors__0__irradiance_w_m2": 1e-310}, RenderError, "is dark"),
    "light beyond float32": ({"projectors__0__irradiance_w_m2": 1e300}, RenderError, "32 bits"),
    "light at float32's end": ({"projectors__0__irradiance_w_m2": 1e38}, RenderError, "32 bits"),
    "ambient beyond float32": ({"ambient__radiance_w_m2_sr": 1e300}, RenderError, "32 bits"),
    "no modulation": ({"projectors__0__contrast": 1e-300}, DecodeError, "no pixel could be decoded"),
    "denormal amplitude": ({"patterns__amplitude": 1e-310}, DecodeError, "no pixel could be decoded"),
    "denormal exposure": ({"exposures": {"times_ms": [1e-310]}}, DecodeError, "no pixel could be"),
    "endless exposure": ({"exposures": {"times_ms": [1e308]}}, DecodeError, "saturated 100"),
    "camera at the end of numbers": ({"camera__pose": {"origin_mm": [0, 0, 1e200]}}, SceneError, "1e\\+200"),
    "object at the end of numbers": ({"objects__0__position_mm": [1e300, 0, 0]}, MeshError, "1e\\+300"),
    "endless object": ({STEP.replace(".", "__"): {"kind": "box", "size_mm": [1e300] * 3}}, MeshError, "step"),
    "object of no size": ({STEP.replace(".", "__"): {"kind": "box", "size_mm": [1e-300] * 3}}, MeshError, "zero area"),
    "endless period": ({"patterns__periods_px": [1e300]}, SceneError, "periods_px"),
    "NaN": ({"camera__pose": {"origin_mm": [0, 0, float("nan")]}}, SceneError, "finite"),
    "infinity": ({"projectors__0__irradiance_w_m2": float("inf")}, SceneError, "finite"),
    "volume elsewhere": ({"height_range_mm": [1000, 1001]}, DecodeError, "do not overlap"),
    "more samples than count": ({"sampling__samples": 2**40}, SceneError, "samples"),
}  # fmt: skip


@pytest.mark.parametrize("case", BEYOND)
def test_unmeasurable_scene_is_refused(case: str) -> None:
    changes, error, says = BEYOND[case]
    with pytest.raises(error, match=says):
        through(step(**changes))


@pytest.mark.parametrize("resolution", [[1, 1], [1, 36], [48, 1], [2, 1], [1, 2], [3, 3]])
def test_images_of_a_pixel_or_a_line_are_measured_or_refused(resolution: list[int]) -> None:
    scene = scenes.load("step", SMALL | {"camera.resolution": resolution})
    try:
        truth, found, score = through(scene)
    except (RenderError, DecodeError) as error:
        # One pixel may see too little to set the exposure, or to decode.
        assert "seen by no pixel" in str(error) or "no pixel could be decoded" in str(error)
        return
    assert found.height_mm.shape == truth.height_mm.shape == (resolution[1], resolution[0])
    assert sum(r.pixels for r in score.regions.values()) <= resolution[0] * resolution[1]


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_files_of_a_pixel_or_a_line_read_back_the_same(
    size: tuple[int, int], tmp_path: Path
) -> None:
    plane = np.full(size[::-1], 1e-45, np.float32)
    exr.write(tmp_path / "a.exr", "thing", {"x": plane}, {})
    assert exr.read(tmp_path / "a.exr", "thing")[0]["x"].tobytes() == plane.tobytes()


@pytest.mark.parametrize("seed", [-1, 2**32, 2**63, 1.5])
def test_seeds_beyond_32_bits_are_refused(seed: Any) -> None:
    with pytest.raises(RenderError, match="seed"):
        render.trace(step(), seed=seed)


def frames(stack: scenes.Stack, change: Callable[[np.ndarray], None]) -> scenes.Stack:
    """The same stack in float32, some samples changed."""
    sensor = scenes.SimpleSensor(bits=0, sigma_dn=1.0, saturated_from_dn=1e6)
    changed = stack.frames.astype(np.float32)
    change(changed)
    return scenes.Stack(
        changed, stack.patterns, stack.exposure_ms, sensor, stack.calibration, stack.scene
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45])
@pytest.mark.parametrize("fusion", ["max-modulation", "single"])
def test_samples_that_are_no_numbers_reject_only_their_pixel(value: float, fusion: str) -> None:
    # A pixel is 19 projector pixels wide: the shipped period of 16 would leave no fringes.
    scene = step(patterns__periods_px=[128.0, 1024.0])
    clean = frames(render.expose(render.trace(scene), seed=1), lambda f: None)

    def spoil(f: np.ndarray) -> None:
        f[0, :, 5:8, 5:8] = value

    good = decode.reconstruct(clean, fusion=fusion)
    bad = decode.reconstruct(frames(clean, spoil), fusion=fusion)
    spoilt = np.zeros(good.valid.shape, bool)
    spoilt[5:8, 5:8] = True
    assert good.valid[spoilt].all()
    assert not bad.valid[spoilt].any()
    assert np.array_equal(bad.height_mm[~spoilt], good.height_mm[~spoilt], equal_nan=True)
    # Next to black pixels, dim ones count as the edge of a shadow.
    spoilt[4:9, 4:9] |= 0.0 < value < 1.0
    assert np.array_equal(bad.valid[~spoilt], good.valid[~spoilt])


@pytest.mark.parametrize("level", [0.0, 100.0, np.nan])
def test_frames_without_modulation_are_refused(level: float) -> None:
    def flat(f: np.ndarray) -> None:
        f[:] = level

    stack = frames(render.expose(render.trace(step())), flat)
    with pytest.raises(DecodeError, match="no pixel could be decoded"):
        decode.reconstruct(stack)


def as_file(mesh: trimesh.Trimesh, folder: Path) -> dict[str, Any]:
    mesh.export(folder / "mesh.ply")
    return {STEP: {"kind": "file", "path": str(folder / "mesh.ply")}}


def block() -> trimesh.Trimesh:
    """The step of the shipped scene."""
    return scenes.load("step").objects[1].shape.mesh()


def with_faces(extra: list[list[int]]) -> trimesh.Trimesh:
    mesh = block()
    return trimesh.Trimesh(mesh.vertices, np.vstack([mesh.faces, extra]), process=False)


def flipped() -> trimesh.Trimesh:
    mesh = block()
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def with_sliver() -> trimesh.Trimesh:
    mesh = block()
    near = mesh.vertices[0] + [[0, 0, 0], [1e-12, 0, 0], [0, 1e-30, 0]]
    points = np.vstack([mesh.vertices, near])
    n = len(mesh.vertices)
    return trimesh.Trimesh(points, np.vstack([mesh.faces, [[n, n + 1, n + 2]]]), process=False)


ODD: dict[str, Callable[[], trimesh.Trimesh]] = {
    "flipped normals": flipped,
    "degenerate triangles": lambda: with_faces([[0, 0, 1], [2, 2, 2]] * 500),
    "sliver": with_sliver,
    "every triangle twice": lambda: with_faces(block().faces.tolist()),
    "every triangle twice, once flipped": lambda: with_faces(block().faces[:, ::-1].tolist()),
}


@pytest.mark.parametrize("case", ODD)
@pytest.mark.parametrize("smooth", [False, True])
def test_odd_meshes_of_one_surface_have_the_same_truth(
    case: str, smooth: bool, tmp_path: Path
) -> None:
    changes = {"objects.1.smooth": smooth}
    plain = render.truth(scenes.load("step", SMALL | changes))
    scene = scenes.load("step", SMALL | changes | as_file(ODD[case](), tmp_path))
    truth, found, _ = through(scene)
    # The file holds float32.
    np.testing.assert_allclose(truth.height_mm, plain.height_mm, atol=1e-5)
    assert np.array_equal(truth.label, plain.label)
    assert found.valid.any()


def test_surface_behind_a_hole_is_seen(tmp_path: Path) -> None:
    mesh = block()
    top = mesh.triangles_center[:, 2] == mesh.triangles_center[:, 2].max()
    mesh.update_faces(~top)
    plain, holed = (
        render.truth(scenes.load("step", SMALL | change))
        for change in ({}, as_file(mesh, tmp_path))
    )
    inside = (plain.region("step")) & (plain.normal[..., 2] > 0.99)
    assert inside.sum() > 20
    # The base is below.
    assert (holed.height_mm[inside] < plain.height_mm[inside] - 0.01).all()
    through(scenes.load("step", SMALL | as_file(mesh, tmp_path)))


def test_coincident_surfaces_are_one_surface() -> None:
    base = scenes.load("step").objects[0]
    twice = step().model_copy(update={"objects": (base, base)})
    once = step().model_copy(update={"objects": (base,)})
    two, found, _ = through(twice)
    one, single, _ = through(once)
    np.testing.assert_allclose(two.height_mm, one.height_mm, atol=1e-5)
    assert np.array_equal(two.lit, one.lit)
    # No surface shades itself: the same amount of light returns as from one.
    assert np.count_nonzero(found.valid) == pytest.approx(np.count_nonzero(single.valid), rel=0.02)


@pytest.mark.slow
def test_millions_of_triangles_are_rendered(tmp_path: Path) -> None:
    n = 1200
    x, y = np.meshgrid(np.linspace(-3, 3, n), np.linspace(-3, 3, n))
    at = np.arange(n * n).reshape(n, n)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])
    assert len(faces) > 2_800_000
    points = np.stack([x, y, np.full_like(x, 0.5)], -1).reshape(-1, 3)
    mesh = trimesh.Trimesh(points, faces, process=False)
    scene = scenes.load(
        "step", SMALL | as_file(mesh, tmp_path) | {"objects.1.position_mm": [0, 0, 0]}
    )
    truth = render.truth(scene, render.trace(scene))
    seen = truth.region("step")
    assert seen.any()
    np.testing.assert_allclose(truth.height_mm[seen], 0.5, atol=1e-5)
