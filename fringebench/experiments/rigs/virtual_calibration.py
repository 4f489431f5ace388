"""Virtual calibration of a rig: charts are rendered in several poses, calibrated with OpenCV, and compared with the rig.

The camera sees the corners of the chart in the mean of the fringe frames. The projector pixel of each corner follows from
the decoded columns and rows around it by a local homography (Moreno & Taubin, 3DIMPVT 2012); the projector is then
calibrated like a camera.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import decode
import render
from fringebench.experiments.rigs.chart import Chart, ChartPose, Kind, fitting, poses
from fringebench.progress import Steps
from scenes import Calibration, Scene
from scenes.rig.devices import Pinhole
from scenes.rig.opencv_calibration import Intrinsics, Pair, Source
from scenes.rig.projection import Coefficients
from scenes.support.errors import RenderError

Floats = NDArray[np.float64]

# Radius around a corner in which projector pixels are read, as a share of a square.
REACH = 0.45
FEWEST_NEIGHBOURS = 24
FEWEST_POSES = 4
# Sampling a pixel on a grid moves an edge in it; with 8 x 8 samples a corner moves by 0.01 px.
SAMPLES = 64


@dataclass(frozen=True)
class ChartView:
    """Corners of the chart found in one pose, in both devices."""

    chart_mm: Floats
    """(corner, 3), frame of the chart."""
    camera_px: Floats
    """(corner, 2), pixel centres at whole numbers, as in OpenCV."""
    projector_px: Floats
    """(corner, 2), pixel centres at whole numbers."""


@dataclass(frozen=True)
class CalibrationResult:
    """The calibration that OpenCV found, and the rendered rig."""

    found: Calibration
    """Found calibration, with z = 0 at the same distance from the camera as in the rendered rig."""
    true: Calibration
    camera_rms_px: float
    """RMS reprojection error of the camera calibrated separately."""
    projector_rms_px: float
    stereo_rms_px: float
    corner_noise_px: tuple[float, float]
    """RMS distance of the found corners from the true ones, per coordinate: camera, projector."""
    views: int
    corners: int

    def rows(self) -> list[tuple[str, float, float, float]]:
        """(name, rendered, found, difference): lengths in mm, pixels, angles in degrees; relative difference for the
        focal lengths and the baseline."""
        rows = []
        devices = zip(_devices(self.true), _devices(self.found), strict=True)
        for name, pair in zip(("camera", "projector"), devices, strict=True):
            for part in ("fx", "fy", "cx", "cy"):
                a, b = (float(getattr(p.projection(), part)) for p in pair)
                rows.append((f"{name}.{part}_px", a, b, b / a - 1.0 if part[0] == "f" else b - a))
            for i, term in enumerate(("k1", "k2", "p1", "p2", "k3")):
                a, b = (device.distortion[i] for device in pair)
                rows.append((f"{name}.{term}", a, b, b - a))
        (R1, t1), (R2, t2) = (_relative(c) for c in (self.true, self.found))
        baseline, found = (float(np.linalg.norm(t)) for t in (t1, t2))
        rows.append(("baseline_mm", baseline, found, found / baseline - 1.0))
        turn = np.linalg.norm(cv2.Rodrigues(R2 @ R1.T)[0])
        rows.append(("rotation_deg", 0.0, float(np.rad2deg(turn)), float(np.rad2deg(turn))))
        return rows

    def to_dict(self) -> dict[str, Any]:
        """In JSON's types."""
        return {
            "views": self.views,
            "corners": self.corners,
            "camera_rms_px": self.camera_rms_px,
            "projector_rms_px": self.projector_rms_px,
            "stereo_rms_px": self.stereo_rms_px,
            "corner_noise_px": list(self.corner_noise_px),
            "rows": [
                {"name": name, "rendered": a, "found": b, "difference": d}
                for name, a, b, d in self.rows()
            ],
        }


def calibrate(
    scene: Scene,
    kind: Kind = "checkerboard",
    count: int = 15,
    seed: int = 0,
    steps: Steps | None = None,
) -> CalibrationResult:
    """Render `count` poses of a chart in front of the rig of `scene`, and calibrate camera and first projector from them.

    Devices, sensor and noise are those of the scene; its objects are left out. Raises `RenderError` for a telecentric device,
    and for poses that do not suffice.
    """
    scene.calibration().require_projectors("a calibration")
    if not all(isinstance(device, Pinhole) for device in _devices(scene.calibration())):
        raise RenderError(
            "OpenCV calibrates pinholes only, and this rig has a telecentric device: choose a scene with pinholes, such as "
            "bench"
        )
    if count < FEWEST_POSES:
        raise RenderError(f"{count} poses are too few: give at least {FEWEST_POSES}, preferably 12")
    steps = steps or Steps()
    rng = np.random.default_rng(seed)
    chart = fitting(scene, kind)
    views: list[ChartView] = []
    for i, pose in enumerate(poses(scene, chart, count, rng)):
        with steps.step(f"pose {i + 1} of {count}"):
            views += _view(_posed(scene, chart, pose), chart, seed + i)
    if len(views) < FEWEST_POSES:
        raise RenderError(
            f"OpenCV found the chart in {len(views)} of {count} pictures, {FEWEST_POSES} are needed: raise the camera's "
            "resolution or the light"
        )
    with steps.step("calibrate"):
        return _calibrated(scene, views)


def _posed(scene: Scene, chart: Chart, pose: ChartPose) -> Scene:
    """The rig in front of a chart, showing fringes along both axes."""
    light = scene.projectors[0]
    periods = [max(4.0, np.ceil(max(light.resolution) / 64.0))]
    while periods[-1] < max(light.resolution):
        periods.append(periods[-1] * 8.0)
    reach = 2.0 * chart.size_mm[0]
    return Scene.model_validate(
        {
            **scene.model_dump(exclude={"objects", "patterns", "exposures", "materials"}),
            "projectors": [light],
            "objects": chart.objects(pose.rotation_deg, pose.position_mm),
            "materials": {
                # Print on matt paper; the black still returns fringes.
                "chart-white": {"kind": "diffuse", "reflectance": 0.8},
                "chart-black": {"kind": "diffuse", "reflectance": 0.08},
            },
            "patterns": {
                "kind": "phase-shift",
                "steps": 4,
                "periods_px": periods,
                "axes": ["column", "row"],
            },
            "exposures": {
                "auto": {
                    "label": "white",
                    "level_dn": 0.55 * min(scene.sensor.saturation_dn, 65535.0),
                    "statistic": "peak",
                }
            },
            "sampling": {"samples": SAMPLES, "depth": 1},
            "height_range_mm": [-reach, reach],
        }
    )


def _view(scene: Scene, chart: Chart, seed: int) -> Iterator[ChartView]:
    """Render, decode and find corners: one view, or none if OpenCV does not find the chart."""
    stack = render.expose(render.trace(scene, seed=seed), seed=seed)
    maps = {
        axis: decode.reconstruct(stack, height="phase", anchor="field", axis=axis)
        for axis in ("column", "row")
    }
    texture = maps["column"].offset_dn
    bright = float(np.percentile(texture, 99.5))
    image = np.clip(texture * (230.0 / bright), 0.0, 255.0).astype(np.uint8)
    found = chart.find(image)
    if found is None:
        return
    pixels, ids = found
    valid = maps["column"].valid & maps["row"].valid
    coordinates = np.stack(
        [maps[axis].phases[axis].coordinate_px - 0.5 for axis in ("column", "row")], axis=-1
    )
    spacing = float(np.median(np.linalg.norm(np.diff(pixels, axis=0), axis=1)))
    read = [_projector_pixel(at, REACH * spacing, valid, coordinates) for at in pixels]
    kept = [i for i, value in enumerate(read) if value is not None]
    if len(kept) < 12:
        return
    yield ChartView(
        chart.corners_mm[ids[kept]],
        pixels[kept],
        np.array([read[i] for i in kept], dtype=np.float64),
    )


def _projector_pixel(
    corner: Floats, reach_px: float, valid: NDArray[np.bool_], coordinates: Floats
) -> Floats | None:
    """Projector pixel at a corner, by the homography of the camera pixels around it."""
    rows, columns = valid.shape
    x, y = corner
    row = np.arange(max(0, int(y - reach_px)), min(rows, int(y + reach_px) + 2))
    column = np.arange(max(0, int(x - reach_px)), min(columns, int(x + reach_px) + 2))
    v, u = np.meshgrid(row, column, indexing="ij")
    near = valid[v, u] & (np.hypot(u - x, v - y) <= reach_px)
    if near.sum() < FEWEST_NEIGHBOURS:
        return None
    source = np.stack([u[near] - x, v[near] - y], axis=-1)
    target = coordinates[v[near], u[near]]
    middle = target.mean(axis=0)
    homography = cv2.findHomography(source, target - middle, cv2.LMEDS)[0]
    if homography is None:
        return None
    return np.asarray(homography[:2, 2] / homography[2, 2] + middle)


def _calibrated(scene: Scene, views: list[ChartView]) -> CalibrationResult:
    true = scene.calibration()
    camera, light = _devices(true)
    chart = [view.chart_mm.astype(np.float32) for view in views]
    eye = [view.camera_px.astype(np.float32) for view in views]
    lamp = [view.projector_px.astype(np.float32) for view in views]
    # The lens model a user would choose for these lenses.
    sixth_order = any(device.distortion[4] for device in (camera, light))
    flags = 0 if sixth_order else cv2.CALIB_FIX_K3
    one, K1, D1, *_ = cv2.calibrateCamera(chart, eye, camera.resolution, None, None, flags=flags)
    two, K2, D2, *_ = cv2.calibrateCamera(chart, lamp, light.resolution, None, None, flags=flags)
    # Refine jointly: the intrinsics of neither device are certain enough to be kept fixed.
    both, K1, D1, K2, D2, R, T, *_ = cv2.stereoCalibrate(
        chart, eye, lamp, K1, D1, K2, D2, camera.resolution,
        flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS,
        criteria=(cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9),
    )  # fmt: skip
    pair = Pair(
        Intrinsics(K1, _terms(D1), camera.resolution),
        Intrinsics(K2, _terms(D2), light.resolution),
        R,
        T.ravel(),
        "the virtual calibration",
    )
    distance = float(camera.projection().origin_mm[2])
    low, high = true.height_range_mm
    source = Source(
        files=("virtual",), distance_mm=distance, depth_range_mm=(distance - high, distance - low)
    )
    found = pair.calibration(source, camera.resolution, light.resolution)
    return CalibrationResult(
        found,
        true,
        float(one),
        float(two),
        float(both),
        (_noise(camera, chart, eye), _noise(light, chart, lamp)),
        len(views),
        sum(len(view.chart_mm) for view in views),
    )


def _noise(device: Pinhole, chart: list[Any], seen: list[Any]) -> float:
    """RMS per coordinate, px, of the corners about their projections by the rendered device, with a pose fitted per view."""
    p = device.projection()
    K = np.array([[p.fx, 0.0, p.cx - 0.5], [0.0, p.fy, p.cy - 0.5], [0.0, 0.0, 1.0]])
    squares, count = 0.0, 0
    for points, pixels in zip(chart, seen, strict=True):
        terms = np.array(device.distortion)
        _, rvec, tvec = cv2.solvePnP(points, pixels, K, terms)
        off = cv2.projectPoints(points, rvec, tvec, K, terms)[0][:, 0] - pixels
        squares += float((off**2).sum())
        count += off.size - 6
    return float(np.sqrt(squares / count))


def _devices(calibration: Calibration) -> tuple[Any, Any]:
    return calibration.camera, calibration.projectors[0]


def _relative(calibration: Calibration) -> tuple[Floats, Floats]:
    eye, lamp = (device.projection() for device in _devices(calibration))
    R = lamp.R @ eye.R.T
    return R, lamp.t - R @ eye.t


def _terms(distortion: Any) -> Coefficients:
    k1, k2, p1, p2, k3 = (float(term) for term in np.ravel(distortion)[:5])
    return k1, k2, p1, p2, k3
