"""A rig with a screen: commands that need a projector say so before any light is traced."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evaluation
import fringebench as fb
import scenes
from decode import Reconstruction
from fringebench.experiments.rigs.rig_twin import twin
from scenes import Scene
from scenes.scene_files import dumps, save
from scenes.support.errors import DecodeError, SceneError
from tests.conftest import Call


def stack_of(scene: Scene) -> scenes.Stack:
    """Black frames of the scene."""
    columns, rows = scene.camera.resolution
    frames = np.zeros((1, len(scene.frames), rows, columns), np.uint16)
    return scenes.Stack(
        frames, scene.frames, (1.0,), scene.sensor, scene.calibration(), scene=dumps(scene)
    )


def test_twin_of_a_screen_is_refused() -> None:
    scene = scenes.load("mirror-deflectometry", {"camera.resolution": [16, 12]})
    with pytest.raises(SceneError, match="needs a projector, and the rig has a screen"):
        twin(scene.calibration(), "twin", 300.0)


WRONG_COMMANDS = {
    "compare": ("compare", "{scene}"),
    "strategies": ("strategies", "{scene}"),
    "budget": ("budget", "{scene}"),
    "regress": ("regress", "decode:reconstruct", "--scene", "{scene}"),
    "accept": ("accept", "{scene}"),
    "calibrate": ("calibrate", "{scene}"),
    "pads": ("pads", "{scene}"),
    "pads of frames": ("pads", "{stack}"),
    "export": ("export", "{stack}", "-o", "{folder}/capture"),
}


@pytest.mark.parametrize("rig", ["screen", "pair", "board with a screen"])
@pytest.mark.parametrize("wrong", WRONG_COMMANDS)
def test_command_on_the_wrong_rig_is_refused_in_a_sentence(
    wrong: str, rig: str, tmp_path: Path, call: Call
) -> None:
    scene = _rig(rig)
    save(scene, tmp_path / "scene.toml")
    stack_of(scene).write(tmp_path / "stack.exr")
    paths = {name: str(tmp_path / file) for name, file in FILES.items()}
    status, _, err = call(*(word.format(**paths) for word in WRONG_COMMANDS[wrong]))
    assert status == 2
    assert "Traceback" not in err
    sentence = " ".join(err.split())
    what = "one camera" if rig == "pair" else "has a screen"
    board = "pads" in wrong and rig != "board with a screen"
    assert ("has no board" if board else what) in sentence


@pytest.mark.parametrize(
    ("rig", "choice", "said"),
    [
        ("screen", ("--height", "triangulation"), "the rig has a screen: use two-positions"),
        ("screen", ("--height", "reference-plane"), "the rig has a screen: use two-positions"),
        ("screen", ("--matcher", "sgbm"), "the rig has a screen"),
        ("screen", ("--axis", "column"), "the rig has a screen"),
        ("pair", ("--height", "integration"), "stacks of two cameras"),
        ("pair", ("--known-point", "1", "1", "1.0"), "stacks of two cameras"),
        ("pair", ("--projector", "0"), "stacks of two cameras"),
        ("pair", ("--unwrap", "temporal"), "two cameras without fringes"),
        ("projector", ("--height", "two-positions"), "calibration has none"),
        ("projector", ("--known-point", "1", "1", "1.0"), "calibration has none"),
        ("projector", ("--matcher", "bm"), "two cameras without fringes"),
    ],
)
def test_decoder_of_another_rig_is_refused_in_a_sentence(
    rig: str, choice: tuple[str, ...], said: str, tmp_path: Path, call: Call
) -> None:
    stack_of(_rig(rig)).write(tmp_path / "stack.exr")
    words = ("decode", tmp_path / "stack.exr", "-o", tmp_path / "rec.exr", *choice)
    status, _, err = call(*words)
    assert status == 2
    assert said in " ".join(err.split())
    assert not (tmp_path / "rec.exr").exists()


FILES = {"scene": "scene.toml", "stack": "stack.exr", "folder": "."}


def _rig(name: str) -> Scene:
    """A small scene of a screen, of two cameras with dots, of a board under a screen, or of a projector."""
    small: dict[str, Any] = {"camera.resolution": [32, 24], "sampling.samples": 1}
    if name != "board with a screen":
        shipped = {"screen": "mirror-deflectometry", "pair": "stereo", "projector": "step"}
        return scenes.load(shipped[name], small)
    screen = scenes.load("mirror-deflectometry")
    own = screen.model_dump(mode="json", exclude_none=True, include={"projectors", "patterns"})
    return scenes.load("spi", small | own)


def test_run_with_one_position_is_refused_before_light_is_traced(tmp_path: Path) -> None:
    scene = scenes.load("mirror-deflectometry")
    one = scene.model_copy(update={"projectors": scene.projectors[:1]})
    with pytest.raises(DecodeError, match="leaves the height open"):
        fb.run(one, tmp_path / "out")


def test_slope_scores_are_those_of_errors_made_on_purpose() -> None:
    """A tilt is an error of slopes and heights, and none of the form."""
    rows, columns = np.mgrid[0:20, 0:30] * 0.1
    flat, none = np.zeros((20, 30)), np.zeros((20, 30), np.float32)
    xyz = np.stack([columns, rows, flat], axis=-1).astype(np.float32)
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), xyz.shape)
    one = np.ones((1, 20, 30), np.float32)
    truth = scenes.Truth(
        xyz, up, np.ones((20, 30), np.uint16), ("mirror",), one > 0, one, one, one, 'name = "flat"'
    )
    bump = 1e-3 * np.where((np.arange(30) % 2 == 0), 1.0, -1.0)
    heights = Reconstruction.of_heights(0.02 * columns + bump)
    vars(heights).update(
        slope=np.stack([none + 3e-5, none - 4e-5]), slope_sigma=np.stack([none, none]) + 3.5e-5
    )
    found = evaluation.score(heights, truth).slopes
    assert found is not None
    mirror = found["mirror"]
    assert mirror.rms_urad == pytest.approx(np.sqrt((30**2 + 40**2) / 2), rel=1e-6)
    assert mirror.predicted_urad == pytest.approx(35.0)
    assert mirror.within_one_sigma == 0.5
    assert mirror.within_two_sigma == 1.0
    # Alternating signs have next to no slope of their own.
    assert mirror.form_um == pytest.approx(1.0, abs=0.01)
