"""Parts of a scene made in Python: what cannot be is refused in the project's own words."""

import pickle
from collections.abc import Callable
from typing import Any

import pytest

import scenes
from scenes.calibration import Calibration
from scenes.errors import FringebenchError, ImpossibleError, SceneError
from scenes.rig import LookAt, Telecentric


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: scenes.PhaseShift(periods_px=(16,), steps=2), r"^PhaseShift\.steps: .*3 \(got 2\)$"),
        (lambda: scenes.PhaseShift(periods_px=(16,), stepps=4), r"^PhaseShift\.stepps does not exist: did you mean 'steps'\?$"),
        (lambda: Telecentric(resolution=(4, 4)), r"^Telecentric\.pose is missing"),
        (lambda: LookAt(origin_mm=(0, 0, float("nan"))), r"^LookAt\.origin_mm\.2: .*finite"),
    ],
)  # fmt: skip
def test_an_impossible_part_shows_pydantics_error(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(FringebenchError, match=said) as caught:
        make()
    assert isinstance(caught.value, ImpossibleError)
    # as before: whoever caught a ValueError still does
    assert isinstance(caught.value, ValueError)


def test_a_part_inside_a_scene_file_loses_its_place() -> None:
    with pytest.raises(SceneError, match=r"^bench: patterns\.steps: .*\(got 2\)$") as caught:
        scenes.load("bench", {"patterns.steps": 2})
    assert not isinstance(caught.value, ImpossibleError)


def test_parts_are_copied_and_pickled_without_being_made_anew() -> None:
    scene = scenes.load("bench")
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene.model_copy(update={"name": "b"}).name == "b"
    made = Calibration(camera=scene.camera, projectors=scene.projectors, height_range_mm=(-1, 1))
    assert Calibration.model_validate(made.model_dump()) == made
