"""Real rigs twinned, and rendered rigs calibrated."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decode
import render
import scenes
from fringebench.experiments.rigs.chart import Chart, fitting, poses
from fringebench.experiments.rigs.data_sheet import rig_of_sheets
from fringebench.experiments.rigs.rig_twin import twin
from fringebench.experiments.rigs.shared_field import common_field
from fringebench.experiments.rigs.virtual_calibration import _projector_pixel, calibrate
from scenes import Calibration
from scenes.rig import opencv_calibration
from scenes.rig.opencv_calibration import Source
from scenes.rig.projection import Projection
from scenes.support.errors import FringebenchError, SceneError
from tests.conftest import Call

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
def test_twin_of_a_saved_rig_is_the_same_rig(call: Call, tmp_path: Path, suffix: str) -> None:
    rig = wide().calibration()
    path = tmp_path / f"rig{suffix}"
    opencv_calibration.write(path, rig)
    toml = tmp_path / "twin.toml"
    status, _, err = call("twin", path, "-o", toml, "--distance-mm", 300)
    assert status == 0, err
    small = {"camera.resolution": [32, 24]}
    render.trace(scenes.load(toml, small), samples=1).write(tmp_path / "transport.exr")
    rendered = render.Transport.read(tmp_path / "transport.exr").scene
    twinned = scenes.load(toml).calibration()
    shrunk = rendered.calibration().camera.projection()
    assert shrunk.fx == pytest.approx(twinned.camera.projection().fx * 32 / 800, rel=1e-12)
    same(rig.camera.projection(), twinned.camera.projection())
    same(rig.projectors[0].projection(), rendered.projectors[0].projection())
    (R1, t1), (R2, t2) = relative(rig), relative(rendered.calibration())
    np.testing.assert_allclose(R2, R1, atol=1e-12)
    np.testing.assert_allclose(t2, t1, atol=1e-9)
    # this camera looks straight down from 300 mm: the worlds are one, too
    points = np.random.default_rng(0).uniform(-30, 30, (50, 3))
    np.testing.assert_allclose(
        twinned.camera.projection().project(points)[0],
        rig.camera.projection().project(points)[0],
        atol=1e-9,
    )


def test_twin_measures_its_objects(tmp_path: Path) -> None:
    opencv_calibration.write(tmp_path / "rig.yml", wide().calibration())
    source = Source(files=(tmp_path / "rig.yml",), distance_mm=300.0)
    scene = twin(source.calibration(), "mine", 300.0)
    scenes.save(scene, tmp_path / "mine.toml")
    scene = scenes.load(tmp_path / "mine.toml", {"camera.resolution": [160, 120]})
    # They are high enough to be seen, and leave half of the range above them.
    width, height = common_field(scene.calibration()).size_mm
    tops = {part.label: float(part.mesh.bounds[1, 2]) for part in scenes.parts(scene)}
    for label in ("cap", "step"):
        assert 0.025 * min(width, height) < tops[label] <= 0.5 * scene.height_range_mm[1], label
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
    [({"distance_mm": 0.0}, "working distance"), ({"distance_mm": 20.0}, "share 0%")],
)
def test_impossible_twin_is_refused(tmp_path: Path, keys: dict[str, float], said: str) -> None:
    opencv_calibration.write(tmp_path / "rig.yml", wide().calibration())
    with pytest.raises(FringebenchError, match=said):
        source = Source(files=(tmp_path / "rig.yml",), **keys)
        twin(source.calibration(), "mine", source.distance_mm)


def test_rig_of_data_sheets_has_their_angles_and_lights_what_the_camera_sees() -> None:
    sheets = rig_of_sheets(
        "2448x2048, 3.45 um, f 16 mm, f/4", "1280x800, throw 1.4, offset 100 %", 400.0, 100.0
    )
    assert sheets.sensor == {"pixel_um": 3.45, "f_number": 4.0}
    planned = sheets.calibration
    camera, light = planned.camera.projection(), planned.projectors[0].projection()
    # A chip of 2448 x 3.45 um behind 16 mm, 400 mm away.
    edges = camera.points_at(0.0, np.array([[0.0, 1024.0], [2448.0, 1024.0]]))
    assert np.ptp(edges[:, 0]) == pytest.approx(2448 * 3.45e-3 / 16.0 * 400.0)
    # Both images have their middle at the origin.
    origin = np.zeros((1, 3))
    assert camera.project(origin)[0] == pytest.approx(np.array([[1224.0, 1024.0]]))
    assert light.project(origin)[0] == pytest.approx(np.array([[640.0, 400.0]]))
    # At an offset of 100 % the lower edge is as high as the lens, whatever the distance.
    lens = -light.R.T @ light.t
    below = light.points_at(0.0, np.array([[640.0, 800.0]]))
    assert below[0, 1] == pytest.approx(lens[1])
    # Throw: distance along the axis over image width, in a plane across the axis.
    rays = np.array([[0.0 - 640.0, 0.0], [1280.0 - 640.0, 0.0]]) / light.fx
    assert 1.0 / np.ptp(rays[:, 0]) == pytest.approx(1.4)


def test_modules_by_name_are_the_devices_of_the_measured_rig() -> None:
    measured = scenes.load("measured-rig")
    planned = rig_of_sheets("IMX342, f 51.3 mm", "DLP4710LC", 800.0, 200.0).calibration
    # Pixel pitch and the calibrated focal length, 51.3 mm; the camera's axis is not the middle of its chip, within 1 %.
    camera = measured.camera.projection()
    assert planned.camera.projection().fx / 6464 == pytest.approx(
        camera.fx / camera.width, rel=3e-3
    )
    named, light = planned.projectors[0].projection(), measured.projectors[0].projection()
    assert (named.fx, named.cy) == pytest.approx((light.fx, light.cy), rel=1e-3)


@pytest.mark.parametrize(
    ("camera", "projector", "said"),
    [
        ("2448x2048, f 16 mm", "1280x800, throw 1.4", "add the pixel pitch"),
        ("IMX25, f 16 mm", "1280x800, throw 1.4", "did you mean 'imx250'"),
        ("IMX250, f 16 mm", "1280x800, throw -1", "more than 0"),
        ("IMX250, f 16 mm", "DLP4710", "did you mean 'dlp4710lc'"),
        ("IMX250, f 16 mm, f 8 mm", "1280x800, throw 1", "given twice"),
        ("IMX250, f 16 mm", "1280x800, throw 1, throw.", "none of"),
    ],
)
def test_data_sheet_that_cannot_be_read_is_refused(camera: str, projector: str, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        rig_of_sheets(camera, projector, 300.0, 100.0)


def test_poses_are_fully_visible_to_both_devices_and_differ() -> None:
    scene = wide()
    chart = fitting(scene, "checkerboard")
    found = poses(scene, chart, 100, np.random.default_rng(0))
    half = np.array([*chart.size_mm, 0.0]) / 2.0
    outline = half * [(-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)]
    for device in (scene.camera.projection(), scene.projectors[0].projection()):
        for pose in found:
            pixels = device.project(pose.place(outline))[0]
            assert ((pixels > 0) & (pixels < (device.width, device.height))).all()
    found = found[:12]
    tilts = np.array([pose.rotation_deg[:2] for pose in found])
    assert (tilts.max(axis=0) > 8.0).all()
    assert (tilts.min(axis=0) < -8.0).all()
    # Of 12 numbers spread evenly, all fall into some half of the range once in 200 draws.
    reach = 0.35 * chart.size_mm[0]
    heights = np.array([pose.position_mm[2] for pose in found])
    assert np.abs(heights).max() <= reach < np.ptp(heights)


@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
@pytest.mark.parametrize("resolution", [[800, 600], [800, 300], [300, 600]])
def test_chart_fits_into_the_common_field(kind: str, resolution: list[int]) -> None:
    middle = {"camera.cx_px": resolution[0] / 2, "camera.cy_px": resolution[1] / 2}
    size = {"camera.resolution": resolution, "camera.calibrated_at": resolution}
    scene = scenes.load("step", WIDE | size | middle)
    field = np.array(common_field(scene.calibration()).size_mm)
    share = np.array(fitting(scene, kind).size_mm) / field  # type: ignore[arg-type]
    # 0.7 of it leaves room for tilts.
    assert share.max() == pytest.approx(0.7)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_opencv_finds_the_corners_of_the_chart(kind: str, turned: bool) -> None:
    """The first corner of a checkerboard is the upper left one, of the picture if that is upside down; ChArUco's are known."""
    chart = Chart(kind, 8.0)  # type: ignore[arg-type]
    rows = np.array([[255 if cell == "." else 20 for cell in row] for row in chart.rows])
    scale = 60 if kind == "checkerboard" else 8
    image = np.kron(rows, np.ones((scale, scale))).astype(np.uint8)
    found = chart.find(np.rot90(image, 2).copy() if turned else image)
    assert found is not None
    pixels, ids = found
    assert len(ids) == 54
    if turned and kind == "charuco":
        pixels = np.array([image.shape[1], image.shape[0]]) - 1 - pixels
    # OpenCV counts centres as whole numbers: an edge between pixels k - 1 and k is at k - 0.5
    per_mm = image.shape[1] / chart.size_mm[0]
    wanted = chart.corners_mm[ids][:, :2] * (1, -1) * per_mm
    wanted += np.array([image.shape[1], image.shape[0]]) / 2 - 0.5
    np.testing.assert_allclose(pixels, wanted, atol=0.2)


def test_projector_pixel_of_a_corner_follows_from_a_chart_seen_obliquely() -> None:
    # A plane's projector pixels are a homography of its camera pixels; at the corner that is evaluated exactly.
    homography = np.array([[1.5, 0.1, 200.0], [-0.05, 1.4, 90.0], [1e-3, -2e-3, 1.0]])
    v, u = np.mgrid[0:30, 0:40].astype(np.float64)
    x, y, w = np.moveaxis(np.stack([u, v, np.ones_like(u)], axis=-1) @ homography.T, -1, 0)
    coordinates = np.stack([x / w, y / w], axis=-1)
    corner = np.array([20.3, 14.6])
    found = _projector_pixel(corner, 6.0, np.ones((30, 40), bool), coordinates)
    wanted = homography @ [*corner, 1.0]
    assert found is not None
    np.testing.assert_allclose(found, wanted[:2] / wanted[2], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["checkerboard", "charuco"])
def test_virtual_calibration_recovers_the_rendered_rig(kind: str) -> None:
    result = calibrate(wide(), kind, 14, seed=1)  # type: ignore[arg-type]
    rows = {name: difference for name, _, _, difference in result.rows()}
    for name, rendered, found, difference in result.rows():
        relative = name.partition(".")[2] in ("fx_px", "fy_px") or name == "baseline_mm"
        assert difference == pytest.approx((found - rendered) / (rendered if relative else 1.0))
    assert result.views >= 12
    for name in ("camera.fx_px", "camera.fy_px", "projector.fx_px", "projector.fy_px"):
        assert abs(rows[name]) < 1e-3, name
    assert abs(rows["baseline_mm"]) < 1e-3
    assert abs(rows["rotation_deg"]) < 0.05
    # Neither lens has a sixth-order term, so none is fitted.
    assert rows["camera.k3"] == rows["projector.k3"] == 0.0
    # The found rig differs by its poses, a thousandth of the distance.
    np.testing.assert_allclose(result.found.height_range_mm, result.true.height_range_mm, atol=0.3)
    # OpenCV's RMS counts points, not coordinates; 12 or so parameters on some 700 corners take next to nothing away
    camera, projector = result.corner_noise_px
    assert result.camera_rms_px == pytest.approx(np.sqrt(2.0) * camera, rel=0.15)
    assert result.projector_rms_px == pytest.approx(np.sqrt(2.0) * projector, rel=0.15)
    # and the corners themselves are as good as a detector's are
    assert camera < 0.1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("calibrate chapter", "telecentric"),
        ("calibrate step --board dots", "choose checkerboard or charuco"),
        ("twin none.yml -o x.toml --distance-mm 300", "does not exist"),
        ("twin a.yml -o x.toml --distance-mm 3 --name K", "PART=NAME"),
    ],
)
def test_invalid_rig_command_is_refused_in_one_line(call: Call, words: str, said: str) -> None:
    status, _, err = call(*words.split())
    assert (status, err.count("\n")) == (2, 1)
    assert said in err
