"""Real rigs twinned, and rendered rigs calibrated."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import decode
import render
import scenes
from fringebench.chart import Chart, fitting, poses
from fringebench.cli import app
from fringebench.twin import twin
from fringebench.virtual_calibration import calibrate
from scenes import Calibration, opencv_calibration
from scenes.errors import FringebenchError
from scenes.opencv_calibration import Source
from scenes.rig import Projection

# A mid-sized lens: 44 degrees across, barrel distortion.
WIDE: dict[str, Any] = {
    "camera.resolution": [800, 600],
    "camera.calibrated_at": [800, 600],
    "camera.fx_px": 1000.0,
    "camera.fy_px": 1002.0,
    "camera.cx_px": 404.3,
    "camera.cy_px": 297.6,
    "camera.distortion": [-0.12, 0.08, 4e-4, -3e-4, 0.0],
    "projectors.0.fx_px": 1500.0,
    "projectors.0.fy_px": 1496.0,
    "projectors.0.cx_px": 509.0,
    "projectors.0.cy_px": 400.0,
    "projectors.0.distortion": [0.05, -0.06, -5e-4, 2e-4, 0.0],
}


def wide() -> scenes.Scene:
    return scenes.load("step", WIDE)


def same(one: Projection, two: Projection) -> None:
    for name in ("width", "height", "fx", "fy", "cx", "cy", "distortion", "max_radius"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-12)


def relative(rig: Calibration) -> tuple[np.ndarray, np.ndarray]:
    eye, lamp = rig.camera.projection(), rig.projectors[0].projection()
    return lamp.R @ eye.R.T, lamp.t - lamp.R @ eye.R.T @ eye.t


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_a_rig_saved_twinned_and_rendered_is_the_same_rig(tmp_path: Path, suffix: str) -> None:
    rig = Calibration.of(wide())
    path = tmp_path / f"rig{suffix}"
    opencv_calibration.write(path, rig)
    toml = tmp_path / "twin.toml"
    result = CliRunner().invoke(app, ["twin", str(path), "-o", str(toml), "--distance-mm", "300"])
    assert result.exit_code == 0, result.output
    small = {"camera.resolution": [32, 24]}
    render.trace(scenes.load(toml, small), samples=1).write(tmp_path / "transport.exr")
    rendered = render.Transport.read(tmp_path / "transport.exr").scene
    twinned = Calibration.of(scenes.load(toml))
    shrunk = Calibration.of(rendered).camera.projection()
    assert shrunk.fx == pytest.approx(twinned.camera.projection().fx * 32 / 800, rel=1e-12)
    same(rig.camera.projection(), twinned.camera.projection())
    same(rig.projectors[0].projection(), rendered.projectors[0].projection())
    (R1, t1), (R2, t2) = relative(rig), relative(Calibration.of(rendered))
    np.testing.assert_allclose(R2, R1, atol=1e-12)
    np.testing.assert_allclose(t2, t1, atol=1e-9)
    # this camera looks straight down from 300 mm: the worlds are one, too
    points = np.random.default_rng(0).uniform(-30, 30, (50, 3))
    np.testing.assert_allclose(
        twinned.camera.projection().project(points)[0],
        rig.camera.projection().project(points)[0],
        atol=1e-9,
    )


def test_a_twin_measures_its_own_objects(tmp_path: Path) -> None:
    opencv_calibration.write(tmp_path / "rig.yml", Calibration.of(wide()))
    source = Source(files=(tmp_path / "rig.yml",), distance_mm=300.0)
    scene = twin(source, "mine")
    scenes.save(scene, tmp_path / "mine.toml")
    scene = scenes.load(tmp_path / "mine.toml", {"camera.resolution": [160, 120]})
    transport = render.trace(scene, samples=16)
    rec = decode.reconstruct(render.expose(transport, seed=1))
    truth = render.truth(scene, transport)
    for label in scene.labels:
        region = truth.region(label) & truth.lit & rec.valid
        assert region.sum() > 50, label
        error = np.abs(rec.height_mm - truth.height_mm)[region]
        # a median over hundreds of pixels is well within the predicted noise of one
        assert np.median(error) < 2.0 * np.median(rec.sigma_mm[region]), label


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"distance_mm": 0.0}, "working distance"),
        ({"distance_mm": 20.0}, "in common"),
    ],
)
def test_a_twin_that_cannot_work_is_refused(
    tmp_path: Path, keys: dict[str, float], said: str
) -> None:
    opencv_calibration.write(tmp_path / "rig.yml", Calibration.of(wide()))
    with pytest.raises(FringebenchError, match=said):
        twin(Source(files=(tmp_path / "rig.yml",), **keys), "mine")  # type: ignore[arg-type]


def test_poses_are_seen_whole_by_both_devices_and_differ() -> None:
    scene = wide()
    chart = fitting(scene, "checkerboard")
    found = poses(scene, chart, 12, np.random.default_rng(0))
    for device in (scene.camera.projection(), scene.projectors[0].projection()):
        for pose in found:
            pixels = device.project(pose.place(chart.corners_mm))[0]
            assert ((pixels > 0) & (pixels < (device.width, device.height))).all()
    tilts = np.array([pose.rotation_deg[:2] for pose in found])
    assert (tilts.max(axis=0) > 8.0).all()
    assert (tilts.min(axis=0) < -8.0).all()


@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_opencv_knows_the_chart(kind: str) -> None:
    chart = Chart(kind, 8.0)  # type: ignore[arg-type]
    rows = np.array([[255 if cell == "." else 20 for cell in row] for row in chart.rows])
    scale = 60 if kind == "checkerboard" else 8
    image = np.kron(rows, np.ones((scale, scale))).astype(np.uint8)
    found = chart.find(image)
    assert found is not None
    pixels, ids = found
    assert len(ids) == 54
    # OpenCV counts centres as whole numbers: an edge between pixels k - 1 and k is at k - 0.5
    per_mm = image.shape[1] / chart.size_mm[0]
    wanted = chart.corners_mm[ids][:, :2] * (1, -1) * per_mm
    wanted += np.array([image.shape[1], image.shape[0]]) / 2 - 0.5
    np.testing.assert_allclose(pixels, wanted, atol=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_virtual_calibration_recovers_the_rendered_rig(kind: str) -> None:
    landed = calibrate(wide(), kind, 14, seed=1)  # type: ignore[arg-type]
    rows = {name: difference for name, _, _, difference in landed.rows()}
    assert landed.views >= 12
    for name in ("camera.fx_px", "camera.fy_px", "projector.fx_px", "projector.fy_px"):
        assert abs(rows[name]) < 1e-3, name
    assert abs(rows["baseline_mm"]) < 1e-3
    assert abs(rows["rotation_deg"]) < 0.05
    # OpenCV's RMS counts points, not coordinates; 12 or so parameters on some 700 corners take next to nothing away
    camera, projector = landed.corner_noise_px
    assert landed.camera_rms_px == pytest.approx(np.sqrt(2.0) * camera, rel=0.15)
    assert landed.projector_rms_px == pytest.approx(np.sqrt(2.0) * projector, rel=0.15)
    # and the corners themselves are as good as a detector's are
    assert camera < 0.1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["calibrate", "chapter"], "telecentric"),
        (["calibrate", "step", "--board", "dots"], "choose checkerboard or charuco"),
        (["twin", "none.yml", "-o", "x.toml", "--distance-mm", "300"], "does not exist"),
        (["twin", "a.yml", "-o", "x.toml", "--distance-mm", "3", "--name", "K"], "PART=NAME"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, FringebenchError)
    assert said in str(result.exception)
