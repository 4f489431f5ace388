"""Calibration charts as objects of a scene, and the poses they are shown in."""

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fringebench.experiments.rigs.shared_field import common_field
from scenes import Scene
from scenes.rig.projection import Projection
from scenes.support.errors import RenderError

Kind = Literal["checkerboard", "charuco"]
Floats = NDArray[np.float64]

SQUARES = (10, 7)
"""Squares of a chart, columns and rows: one number odd, so that a checkerboard has no half turn."""
# Modules across a ChArUco square: a 4 x 4 marker, its black frame, and a white one.
MODULES = 8
MARGIN = 1
# As shares of the common field at the working distance: the sides of the chart, and the offset of its middle.
FILLS = 0.7
STRAY = 0.25
TILT_DEG = (12.0, 42.0)
TURN_DEG = 20.0
# As a share of the width of the chart, in front of and behind the working distance.
DEPTH = 0.35
# Beyond this angle a surface returns little light and covers few pixels.
STEEPEST_DEG = 62.0
TRIES = 4000


@dataclass(frozen=True)
class Chart:
    """A flat printed chart."""

    kind: Kind
    square_mm: float

    @property
    def rows(self) -> tuple[str, ...]:
        """Cells of the chart, '#' black and '.' white, with a white margin of one square."""
        columns, rows = SQUARES
        size = MODULES if self.kind == "charuco" else 1
        black = np.zeros(((rows + 2 * MARGIN) * size, (columns + 2 * MARGIN) * size), dtype=bool)
        inner = black[MARGIN * size : -MARGIN * size, MARGIN * size : -MARGIN * size]
        if self.kind == "charuco":
            drawn = self.board().generateImage((columns * size, rows * size), marginSize=0)
            inner[:] = drawn < 128
        else:
            inner[:] = np.indices((rows, columns)).sum(axis=0) % 2 == 0
        return tuple("".join("#" if cell else "." for cell in row) for row in black)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height with the margin."""
        columns, rows = (count + 2 * MARGIN for count in SQUARES)
        return columns * self.square_mm, rows * self.square_mm

    @property
    def corners_mm(self) -> Floats:
        """Inner corners (corner, 3) in mm in the frame of the chart, row by row from the top left, y up, z to the viewer."""
        columns, rows = SQUARES
        x, y = np.meshgrid(np.arange(1, columns) - columns / 2, rows / 2 - np.arange(1, rows))
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1)
        return np.asarray(flat * self.square_mm)

    def board(self) -> Any:
        """OpenCV's ChArUco board."""
        words = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        marker = self.square_mm * (MODULES - 2) / MODULES
        return cv2.aruco.CharucoBoard(SQUARES, self.square_mm, marker, words)

    def objects(self, rotation_deg: Any, position_mm: Any) -> list[dict[str, Any]]:
        """The chart as two objects of a scene, ``white`` and ``black``."""
        cell = self.square_mm / (MODULES if self.kind == "charuco" else 1)
        placed = {"rotation_deg": list(rotation_deg), "position_mm": list(position_mm)}
        return [
            {
                "label": label,
                "material": f"chart-{label}",
                "shape": {"kind": "tiles", "chart": self.rows, "mark": mark, "cell_mm": cell},
                **placed,
            }
            for label, mark in (("white", "."), ("black", "#"))
        ]

    def find(self, image: NDArray[np.uint8]) -> tuple[Floats, NDArray[np.intp]] | None:
        """Inner corners that OpenCV finds in an image (row, col): pixels (corner, 2), centres at whole numbers, and indices."""
        count = (SQUARES[0] - 1) * (SQUARES[1] - 1)
        if self.kind == "charuco":
            corners, ids, *_ = cv2.aruco.CharucoDetector(self.board()).detectBoard(image)
            if ids is None or len(ids) < count // 2:
                return None
            return corners.reshape(-1, 2).astype(np.float64), ids.ravel().astype(np.intp)
        inner = (SQUARES[0] - 1, SQUARES[1] - 1)
        flags = cv2.CALIB_CB_EXHAUSTIVE + cv2.CALIB_CB_ACCURACY
        found, corners = cv2.findChessboardCornersSB(image, inner, flags=flags)
        if not found:
            return None
        pixels = corners.reshape(-1, 2).astype(np.float64)
        # The detector may start at the opposite corner; the first row of the chart is the upper one.
        if pixels[0, 1] + pixels[0, 0] > pixels[-1, 1] + pixels[-1, 0]:
            pixels = pixels[::-1]
        return pixels, np.arange(count)


@dataclass(frozen=True)
class ChartPose:
    """Position and orientation of a chart in the world."""

    rotation_deg: tuple[float, float, float]
    position_mm: tuple[float, float, float]

    def place(self, points_mm: Floats) -> Floats:
        """Points (point, 3) in mm of the frame of the chart in world coordinates."""
        turn = Rotation.from_euler("xyz", self.rotation_deg, degrees=True)
        return np.asarray(turn.apply(points_mm) + np.array(self.position_mm))


def fitting(scene: Scene, kind: Kind) -> Chart:
    """A chart that fills most of the common field of camera and projector at z = 0."""
    width, height = common_field(scene.calibration()).size_mm
    one = Chart(kind, 1.0).size_mm
    return Chart(kind, FILLS * min(width / one[0], height / one[1]))


def poses(scene: Scene, chart: Chart, count: int, rng: np.random.Generator) -> list[ChartPose]:
    """Random poses in which both devices see every corner, tilted, near and far.

    Raises `RenderError` where the fields of view leave no room.
    """
    camera, light = scene.camera.projection(), scene.projectors[0].projection()
    field = common_field(scene.calibration())
    reach = DEPTH * chart.size_mm[0]
    width, height = chart.size_mm
    outline = np.array(
        [[x, y, 0.0] for x in (-width / 2, width / 2) for y in (-height / 2, height / 2)]
    )
    found: list[ChartPose] = []
    for _ in range(TRIES):
        # The golden angle spreads the tilts evenly around the axis.
        around = 2.0 * np.pi * (len(found) + rng.uniform(-0.4, 0.4)) * 0.381966
        tilt = rng.uniform(*TILT_DEG)
        rotation = (
            float(tilt * np.cos(around)),
            float(tilt * np.sin(around)),
            float(rng.uniform(-TURN_DEG, TURN_DEG)),
        )
        x, y = field.middle_mm + rng.uniform(-STRAY, STRAY, 2) * field.size_mm
        pose = ChartPose(rotation, (float(x), float(y), float(rng.uniform(-reach, reach))))
        if all(_sees(device, pose, outline) for device in (camera, light)):
            found.append(pose)
            if len(found) == count:
                return found
    raise RenderError(
        f"only {len(found)} of {count} chart poses are fully visible to camera and projector: their fields of view overlap too "
        "little, or the projector is too far to the side; use another rig or fewer poses"
    )


def _sees(device: Projection, pose: ChartPose, outline: Floats) -> bool:
    points = pose.place(outline)
    pixels = device.project(points)[0]
    inside = (pixels > 2.0) & (pixels < (device.width - 2.0, device.height - 2.0))
    normal = pose.place(np.array([[0.0, 0.0, 1.0]]))[0] - np.array(pose.position_mm)
    view = device.origin_mm - points.mean(axis=0)
    cosine = float(normal @ view / np.linalg.norm(view))
    return bool(inside.all()) and cosine > np.cos(np.deg2rad(STEEPEST_DEG))
