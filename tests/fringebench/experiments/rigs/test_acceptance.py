"""`fringebench accept` on rendered artefacts."""

import json

import numpy as np
import pytest

import scenes
from fringebench.experiments.rigs.acceptance import BARS, PLANES, SPHERE, _ends, accept
from fringebench.experiments.rigs.shared_field import common_field
from scenes.support.errors import SceneError
from tests.conftest import Call

SMALL = {"camera.resolution": [320, 240], "sampling.samples": 16}


# No bar across fits into it.
NARROW = {
    "camera.resolution": [640, 200],
    "camera.calibrated_at": [640, 200],
    "camera.cy_px": 100.0,
}


def test_every_bar_has_its_length_and_is_inside_the_volume() -> None:
    for name, change in (("step", {}), ("bench", {}), ("step", NARROW)):
        scene = scenes.load(name, change)
        field = common_field(scene.calibration())
        low, high = scene.height_range_mm
        diagonal = float(np.linalg.norm([*field.size_mm, high - low]))
        radius = min(0.5 * SPHERE * diagonal, 0.4 * (high - low))
        for direction, shift, heights in BARS:
            ends = _ends(field, (low, high), radius, 0.35 * diagonal, direction, shift, heights)
            assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(0.35 * diagonal, rel=1e-12)
            assert (ends[:, 2] >= low).all()
            assert (ends[:, 2] + radius <= high).all()
            for device in (scene.camera.projection(), scene.projectors[0].projection()):
                pixels = device.project(ends)[0]
                assert ((pixels > 0) & (pixels < (device.width, device.height))).all()


@pytest.mark.slow
def test_rig_without_faults_measures_to_its_noise() -> None:
    result = accept(scenes.load("step", SMALL))
    assert len(result.positions) == len(BARS) + len(PLANES)
    # VDI/VDE 2634-2: at least half of the volume's diagonal, and it is inside the field.
    field = common_field(scenes.load("step", SMALL).calibration()).size_mm
    assert 0.5 * result.diagonal_mm <= result.plane_mm[0] * (1 + 1e-9) < field[0]
    assert 0.5 * field[1] < result.plane_mm[1] < field[1]
    worst, noise = result.worst(), result.noise()
    # the largest of 14 and of 6 ranges; each scatters by some 8 % about its mean
    assert worst["probing form"] < 1.3 * noise["probing form"]
    assert worst["flatness"] < 1.3 * noise["flatness"]
    assert 0.5 * noise["flatness"] < worst["flatness"]
    # size and distance are means over hundreds of points: far below the noise of one
    assert worst["probing size"] < 0.5 * noise["probing form"]
    assert worst["sphere distance"] < 0.1 * noise["probing form"]


@pytest.mark.slow
def test_error_above_the_limit_is_exit_status_1(call: Call) -> None:
    settings = [f"--set={key}={value}" for key, value in SMALL.items()]
    status, out, _ = call("accept", "step", "--json", "--limit-um", 1, *settings)
    assert status == 1
    answer = json.loads(out)
    assert answer["worst_mm"]["flatness"] > 1e-3
    assert {p["artefact"] for p in answer["positions"]} == {"ball bar", "plane"}


def test_flat_volume_is_refused() -> None:
    with pytest.raises(SceneError, match="widen height_range_mm"):
        accept(scenes.load("step", {**SMALL, "height_range_mm": [-0.1, 0.1]}))
