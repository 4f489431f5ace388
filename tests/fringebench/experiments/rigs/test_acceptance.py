"""`fringebench accept` on rendered artefacts."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import scenes
from evaluation.scoring.reference_bodies import expected_range
from fringebench.experiments.rigs import acceptance
from fringebench.experiments.rigs.acceptance import BARS, PLANES, SPHERE, Position, _ends, accept
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


@pytest.mark.parametrize("name", ["step", "bench"])
def test_every_plane_is_inside_the_volume(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    planes = []
    none = Position("none", {}, {}, 0)

    def placed(_: scenes.Scene, middle: Any, tilt: Any, size: Any, __: int) -> Position:
        corners = np.multiply([(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)], [*size, 0.0]) / 2.0
        planes.append(
            Rotation.from_euler("xyz", [*tilt, 0.0], degrees=True).apply(corners) + middle
        )
        return none

    monkeypatch.setattr(acceptance, "_bar", lambda *_: none)
    monkeypatch.setattr(acceptance, "_plane", placed)
    scene = scenes.load(name)
    accept(scene)
    field = common_field(scene.calibration())
    low, high = scene.height_range_mm
    for corners in planes:
        assert (low <= corners[:, 2]).all()
        assert (corners[:, 2] <= high).all()
        assert (np.abs(corners[:, :2] - field.middle_mm) <= np.array(field.size_mm) / 2.0).all()
    assert len({corners.tobytes() for corners in planes}) == len(PLANES)


@pytest.mark.parametrize("worse", [0, 1])
def test_bar_reports_the_worse_of_its_spheres(worse: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each direction has a point as far outside as another is inside, so the spheres fitted are the true ones."""
    ends = np.array([[-5.0, 0.0, 1.0], [5.0, 0.0, 1.0]])
    off = np.array([0.01, 0.01])
    off[worse] = 0.05
    # 240 points: too few for the guideline to leave one out.
    rays = np.random.default_rng(0).normal(size=(120, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    points = [
        np.concatenate([end + (2.0 + d) * rays, end + (2.0 - d) * rays])
        for end, d in zip(ends, off, strict=True)
    ]
    sigma_mm = np.repeat(off[:, None], 240, axis=1)
    rec = SimpleNamespace(xyz_mm=np.stack(points), sigma_mm=sigma_mm)
    regions = [np.repeat(np.eye(2, dtype=bool)[i][:, None], 240, axis=1) for i in (0, 1)]
    monkeypatch.setattr(acceptance, "_measure", lambda *_: (rec, regions))
    found = acceptance._bar(scenes.load("step"), ends, 2.0, 0)
    # From 0.05 inside to 0.05 outside.
    assert found.error_mm["probing form"] == pytest.approx(0.1, rel=1e-6)
    assert found.error_mm["probing form D95"] == pytest.approx(0.1, rel=1e-6)
    assert found.error_mm["probing size"] == pytest.approx(0.0, abs=1e-6)
    assert found.error_mm["sphere distance"] == pytest.approx(0.0, abs=1e-6)
    assert found.noise_mm["probing form"] == pytest.approx(0.05 * expected_range(240))


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
