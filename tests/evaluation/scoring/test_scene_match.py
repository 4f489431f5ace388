"""A reconstruction is scored against the truth of its own scene and rig, in its own unit."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from decode import Reconstruction
from evaluation.scoring.scene_match import differing_parts, other_unit
from render import Transport
from scenes import Stack, Truth
from scenes.scene_identity import identity
from scenes.support.errors import FringebenchWarning, ScoreError
from tests.evaluation.synthetic_truth import Floats, TruthMaker

SMALL: dict[str, object] = {"camera.resolution": [64, 48], "sampling.samples": 1}


@pytest.fixture(scope="module")
def scene() -> scenes.Scene:
    return scenes.load("step", SMALL)


@pytest.fixture(scope="module")
def rec(scene: scenes.Scene) -> Reconstruction:
    return decode.reconstruct(render.expose(render.trace(scene), seed=1))


def test_truth_of_another_rig_or_scene_is_refused(scene: scenes.Scene, rec: Reconstruction) -> None:
    own = render.truth(scene)
    assert differing_parts(rec, own) == {}
    assert "forced" not in evaluation.score(rec, own).to_dict()
    for part in ("camera", "objects"):
        other = replace(own, identity=identity(changed(scene, part)))
        both = rec.identity[part], other.identity[part]
        assert differing_parts(rec, other) == {part: both}
        with pytest.raises(
            ScoreError, match=rf"differ in {part} \({both[0]}, {both[1]}\).*--force"
        ):
            evaluation.score(rec, other)
        assert evaluation.score(rec, other, force=True).to_dict()["forced"] == [part]


def changed(scene: scenes.Scene, part: str) -> scenes.Scene:
    """The scene with another focal length, or its last object moved."""
    if part == "camera":
        camera = scene.camera.model_copy(update={"fx_px": 1234.0})
        return scene.model_copy(update={"camera": camera})
    moved = scene.objects[-1].model_copy(update={"position_mm": (1.0, 0.0, 0.0)})
    return scene.model_copy(update={"objects": (*scene.objects[:-1], moved)})


def test_every_file_of_a_scene_carries_its_digests(
    scene: scenes.Scene, rec: Reconstruction, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("identity")
    light = render.trace(scene)
    stack = render.expose(light, seed=1)
    truth = render.truth(scene, light)
    for number, file in enumerate((light, stack, truth, rec)):
        assert isinstance(file, (Transport, Stack, Truth, Reconstruction))
        assert file.identity == identity(scene)
        file.write(folder / f"{number}.exr")
        assert type(file).read(folder / f"{number}.exr").identity == file.identity


def test_file_of_a_version_without_digests_is_scored_with_a_note(
    scene: scenes.Scene, rec: Reconstruction
) -> None:
    truth = render.truth(scene)
    for name, old_rec, old_truth in (
        ("reconstruction", replace(rec, identity={}), truth),
        ("truth", rec, replace(truth, identity={})),
    ):
        with pytest.warns(FringebenchWarning, match=f"not known: the {name} is of a version"):
            evaluation.score(old_rec, old_truth)


def test_reconstruction_without_a_scene_is_scored(truth_of: TruthMaker) -> None:
    height = np.zeros((20, 30))
    assert evaluation.score(Reconstruction.of_heights(height), truth_of(height)).forced == ()


RAMP: Floats = np.linspace(0.0, 5.0, 600).reshape(20, 30)


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        (1e-3, "metres"),
        (1 / 25.4, "inches"),
        (1e3, "micrometres"),
        (1.0, ""),
        (1.1, ""),
        (-1.0, ""),
        (0.85e-3, ""),
    ],
)
def test_heights_in_another_unit_are_reported(
    truth_of: TruthMaker, factor: float, unit: str
) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.01, RAMP.shape)
    rec = Reconstruction.of_heights(factor * (RAMP + noise))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        evaluation.score(rec, truth_of(RAMP))
    said = [str(w.message) for w in caught if issubclass(w.category, FringebenchWarning)]
    assert [f"in {unit}:" in text for text in said] == ([True] if unit else [])


def test_flat_truth_shows_no_unit() -> None:
    assert other_unit(np.full((20, 30), 1e-3), np.zeros((20, 30))) == ""


@pytest.mark.parametrize(("pixels", "unit"), [(29, ""), (30, "metres")])
def test_unit_is_named_from_thirty_high_pixels_on(pixels: int, unit: str) -> None:
    true = np.zeros((20, 30))
    true.ravel()[:pixels] = 2.0
    assert other_unit(true / 1000.0, true) == unit
