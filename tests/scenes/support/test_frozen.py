"""Parts of a scene made in Python: impossible ones are refused in the project's own words."""

import pickle
from collections.abc import Callable
from typing import Any

import pytest

import scenes
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt, Telecentric
from scenes.support.errors import FringebenchError, ImpossibleError, SceneError

MISSPELT: dict[str, Any] = {"periods_px": (16,), "stepps": 4}
NO_POSE: dict[str, Any] = {"resolution": (4, 4), "field_width_mm": 1.0}


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: scenes.PhaseShift(periods_px=(16,), steps=2), r"^PhaseShift\.steps: .*3 \(got 2\)$"),
        (lambda: scenes.PhaseShift(**MISSPELT), r"^unknown key 'PhaseShift\.stepps': did you mean 'steps'\?$"),
        (lambda: Telecentric(**NO_POSE), r"^key 'Telecentric\.pose' is missing"),
        (lambda: LookAt(origin_mm=(0, 0, float("nan"))), r"^LookAt\.origin_mm\.2: .*finite"),
    ],
)  # fmt: skip
def test_invalid_part_is_refused_in_our_words(make: Callable[[], Any], said: str) -> None:
    with pytest.raises(FringebenchError, match=said) as caught:
        make()
    assert isinstance(caught.value, ImpossibleError)
    # Callers that catch a ValueError still do.
    assert isinstance(caught.value, ValueError)


def test_invalid_part_in_a_scene_file_keeps_its_location() -> None:
    with pytest.raises(SceneError, match=r"^bench: patterns\.steps: .*\(got 2\)$") as caught:
        scenes.load("bench", {"patterns.steps": 2})
    assert not isinstance(caught.value, ImpossibleError)


def test_parts_can_be_copied_and_pickled() -> None:
    scene = scenes.load("bench")
    assert pickle.loads(pickle.dumps(scene)) == scene
    assert scene.model_copy(update={"name": "b"}).name == "b"
    made = Calibration(camera=scene.camera, projectors=scene.projectors, height_range_mm=(-1, 1))
    assert Calibration.model_validate(made.model_dump()) == made
