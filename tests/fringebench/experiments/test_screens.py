"""A rig with a screen: commands that need a projector say so before any light is traced."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import evaluation
import fringebench as fb
import scenes
from decode import Reconstruction
from fringebench.exchange.capture_export import export
from fringebench.experiments.rigs.rig_twin import twin
from fringebench.experiments.rigs.virtual_calibration import calibrate
from scenes import Scene
from scenes.support.errors import DecodeError, SceneError


def stack_of(scene: Scene) -> scenes.Stack:
    """Black frames of the scene."""
    columns, rows = scene.camera.resolution
    frames = np.zeros((1, len(scene.frames), rows, columns), np.uint16)
    return scenes.Stack(frames, scene.frames, (1.0,), scene.sensor, scene.calibration())


@pytest.mark.parametrize(
    "command",
    [
        fb.accept,
        calibrate,
        fb.budget,
        fb.compare,
        lambda scene: fb.regress("decode:reconstruct", scenes=[scene]),
        lambda scene: twin(scene.calibration(), "twin", 300.0),
        lambda scene: export(stack_of(scene), Path("nowhere")),
    ],
)
def test_commands_for_projectors_refuse_a_screen(command: Callable[[Scene], Any]) -> None:
    scene = scenes.load("mirror-deflectometry", {"camera.resolution": [16, 12]})
    with pytest.raises(SceneError, match="needs a projector, and the rig has a screen"):
        command(scene)


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
