"""OpenCV calibration files (YAML, XML, JSON) as rigs: camera and projector, or two cameras.

Two conventions change on the way in. OpenCV counts a pixel's centre as a whole number, so principal points grow by half
a pixel. And a calibration has no world, only the first camera's frame (y down, z forward); the world made here has the
same x, y up and z towards the camera, and z = 0 is `distance_mm` in front of it: height grows towards the camera.
"""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, ValidationError

from scenes.rig.calibration import Calibration
from scenes.rig.calibration_files import entries
from scenes.rig.calibration_names import parts_of
from scenes.rig.calibration_numbers import coefficients, rotation, shaped
from scenes.rig.devices import Extrinsics, Pinhole, Resolution
from scenes.rig.projection import Coefficients
from scenes.rig.projectors import PinholeProjector
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, FringebenchWarning
from scenes.support.frozen import Frozen
from scenes.support.validation_words import in_words

# A working volume where nothing states it: structured light is rarely used nearer or farther than this many baselines.
DEPTH_IN_BASELINES = (0.5, 50.0)
# Two devices are never so near each other: the unit is another one.
NEAREST_MM = 1.0


class Source(Frozen):
    """Where a calibration is, and how to read it."""

    files: Annotated[tuple[Path, ...], Field(min_length=1)]
    """One file, or several that complete each other (intrinsics.yml, extrinsics.yml)."""
    names: dict[str, str] = {}
    """The files' name of a part, where it is none of the usual names: first_matrix, second_distortion, rotation ... "none":
    there is no such part."""
    mm_per_unit: PositiveFloat | None = None
    """Millimetres per unit of the translation: 1000 for metres, the square's side for squares; absent: 1, or 1000 for the
    projection matrices of ROS, which are in metres. COLMAP's models have no unit: give it."""
    second_to_first: bool = False
    """R and T take the second device's points to the first's; OpenCV's own take the first's to the second's."""
    distance_mm: Annotated[float, Field(ge=0.0)] = 0.0
    """How far in front of the first camera z = 0 is."""
    depth_range_mm: tuple[PositiveFloat, PositiveFloat] | None = None
    """Nearest and farthest depth of the working volume; absent: half to fifty times the baseline."""

    def pair(self) -> "Pair":
        """The two devices. Raises `FileError`."""
        return Pair.read(self)

    def calibration(
        self, camera: Resolution | None = None, projector: Resolution | None = None
    ) -> Calibration:
        """The rig of a camera and a projector with these resolutions (columns, rows), each absent: the file's.

        Raises `FileError` if a size is unknown or is not the file's.
        """
        return self.pair().calibration(self, camera, projector)

    def camera_pair(self, camera: Resolution, projector: Resolution | None = None) -> Calibration:
        """Two cameras of one resolution (columns, rows), and a projector of which the size alone counts.

        Raises `FileError` as `calibration` does.
        """
        rig = self.calibration(camera, camera)
        light = rig.projectors[0]
        right = Pinhole.model_validate(
            light.model_dump(include=set(Pinhole.model_fields) - {"model"})
        )
        size = projector or camera
        middle = {"cx_px": size[0] / 2.0, "cy_px": size[1] / 2.0}
        unknown = light.model_copy(update={"resolution": size, "calibrated_at": size, **middle})
        return rig.model_copy(update={"second_camera": right, "projectors": (unknown,)})


@dataclass(frozen=True)
class Intrinsics:
    """One device as OpenCV knows it."""

    matrix: NDArray[np.float64]
    """(3, 3), pixel centres at whole numbers."""
    distortion: Coefficients
    size: Resolution | None
    """Columns, rows, if the file says."""

    def keys(self, size: Resolution) -> dict[str, Any]:
        """The keys of a `Pinhole` in this project's pixels, without its pose."""
        return {
            "resolution": size,
            "calibrated_at": size,
            "fx_px": float(self.matrix[0, 0]),
            "fy_px": float(self.matrix[1, 1]),
            "cx_px": float(self.matrix[0, 2]) + 0.5,
            "cy_px": float(self.matrix[1, 2]) + 0.5,
            "distortion": self.distortion,
        }


@dataclass(frozen=True)
class Pair:
    """Two devices and ``x_second = R x_first + t``, t in mm."""

    first: Intrinsics
    second: Intrinsics
    R: NDArray[np.float64]
    """(3, 3) rotation from the first device's frame to the second's."""
    t_mm: NDArray[np.float64]
    """(3,) translation, mm."""
    where: str

    @classmethod
    def read(cls, source: Source) -> Self:
        """Read the files of a source. Raises `FileError`, naming the part that is missing or impossible."""
        where = ", ".join(f"'{path}'" for path in source.files)
        parts = parts_of([entries(path) for path in source.files], source.names, where)
        turn = rotation(parts["rotation"], where)
        translation = shaped(parts["translation"], (3,), "translation", where)
        scale = source.mm_per_unit or parts.get("mm_per_unit", 1.0)
        if scale is None:
            raise FileError(
                f"{where}: COLMAP's lengths have no unit: set mm_per_unit, the millimetres of one of its units"
            )
        if source.second_to_first:
            turn, translation = turn.T, -turn.T @ translation
        apart_mm = float(np.linalg.norm(translation * scale))
        if 0.0 < apart_mm < NEAREST_MM and source.mm_per_unit is None:
            warnings.warn(
                f"{where}: the two devices are {apart_mm:.3g} mm apart: if the translation is in metres, set mm_per_unit = 1000",
                FringebenchWarning,
                stacklevel=4,
            )
        return cls(
            _intrinsics(parts, "first", where),
            _intrinsics(parts, "second", where),
            turn,
            translation * scale,
            where,
        )

    @property
    def baseline_mm(self) -> float:
        """Distance of the two centres."""
        return float(np.linalg.norm(self.t_mm))

    def cameras(
        self,
        first: Resolution | None = None,
        second: Resolution | None = None,
        distance_mm: float = 0.0,
    ) -> tuple[Pinhole, Pinhole]:
        """Both devices as cameras in the world of this module. Raises `FileError` as `Source.calibration` does."""
        down = np.diag([1.0, -1.0, -1.0])
        ahead = np.array([0.0, 0.0, distance_mm])
        devices = []
        for device, size, name, R, t in (
            (self.first, first, "first", down, ahead),
            (self.second, second, "second", self.R @ down, self.R @ ahead + self.t_mm),
        ):
            resolution = self._size(device, size, name)
            try:
                pose = Extrinsics.model_validate({"R": R.tolist(), "t_mm": t.tolist()})
                devices.append(Pinhole.model_validate({**device.keys(resolution), "pose": pose}))
            except ValidationError as error:
                raise FileError(f"{self.where}: {name} device: {in_words(error)}") from None
        return devices[0], devices[1]

    def calibration(
        self, source: Source, camera: Resolution | None, projector: Resolution | None
    ) -> Calibration:
        """The pair as camera and projector."""
        if self.baseline_mm < 1e-6:
            raise FileError(
                f"{self.where}: the translation is zero, so nothing can be triangulated"
            )
        eye, light = self.cameras(camera, projector, source.distance_mm)
        near, far = source.depth_range_mm or tuple(
            factor * self.baseline_mm for factor in DEPTH_IN_BASELINES
        )
        if not near < far:
            raise FileError(f"depth_range_mm {[near, far]}: the first must be below the second")
        keys = light.model_dump(exclude={"model"})
        return Calibration(
            camera=eye,
            projectors=(PinholeProjector(**keys, reference_mm=source.distance_mm or near),),
            height_range_mm=(source.distance_mm - far, source.distance_mm - near),
        )

    def _size(self, device: Intrinsics, asked: Resolution | None, name: str) -> Resolution:
        if device.size and asked and tuple(device.size) != tuple(asked):
            raise FileError(
                f"{self.where} calibrates a {name} device of {device.size[0]} x {device.size[1]} pixels, but here it has "
                f"{asked[0]} x {asked[1]}: use the calibration of this device, at this resolution"
            )
        size = asked or device.size
        if size is None:
            raise FileError(
                f"{self.where} does not say the {name} device's size: give it (columns, rows)"
            )
        fx, fy = device.matrix[0, 0], device.matrix[1, 1]
        cx, cy = device.matrix[0, 2], device.matrix[1, 2]
        # Shifted projectors have principal points far off centre, but within an image's size of it.
        if not (-size[0] < cx < 2 * size[0] and -size[1] < cy < 2 * size[1]):
            raise FileError(
                f"{self.where}: the {name} device's principal point ({cx:.1f}, {cy:.1f}) is far outside its "
                f"{size[0]} x {size[1]} pixels: the calibration belongs to another size"
            )
        if not 0.5 * fy < fx < 2.0 * fy:
            raise FileError(
                f"{self.where}: the {name} device's focal lengths {fx:.1f} and {fy:.1f} px differ by more than a "
                "factor of two: is this its intrinsic matrix?"
            )
        return size


def _intrinsics(parts: Mapping[str, Any], which: str, where: str) -> Intrinsics:
    matrix = shaped(parts[f"{which}_matrix"], (3, 3), f"{which}_matrix", where)
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise FileError(
            f"{where}: {which}_matrix has skew {matrix[0, 1]:g}: calibrate without skew"
        )
    size = parts.get(f"{which}_size")
    columns, rows = (None, None) if size is None else shaped(size, (2,), f"{which}_size", where)
    return Intrinsics(
        matrix,
        coefficients(parts.get(f"{which}_distortion"), which, where),
        None if columns is None or rows is None else (int(columns), int(rows)),
    )


def write(path: str | Path, calibration: Calibration, projector: int = 0) -> None:
    """Write camera and one projector as an OpenCV file (by suffix YAML, XML or JSON) that `Source` reads.

    Raises `FileError` for a telecentric device, which OpenCV has no model for, and for a file that cannot be written.
    """
    camera, light = calibration.camera, calibration.projectors[projector]
    suffix = Path(path).suffix.lower()
    if suffix not in (".yml", ".yaml", ".xml", ".json"):
        raise FileError(f"cannot write '{path}': OpenCV files end in .yml, .yaml, .xml or .json")
    if not (isinstance(camera, Pinhole) and isinstance(light, Pinhole)):
        raise FileError(
            f"cannot write '{path}': OpenCV has no model of a telecentric device; use pinholes"
        )
    eye, lamp = camera.projection(), light.projection()
    parts: dict[str, Any] = {}
    for name, device in (("cam", eye), ("proj", lamp)):
        parts[f"{name}_size"] = np.array([device.width, device.height], dtype=np.float64)
        parts[f"{name}_K"] = np.array(
            [[device.fx, 0.0, device.cx - 0.5], [0.0, device.fy, device.cy - 0.5], [0.0, 0.0, 1.0]]
        )
        parts[f"{name}_kc"] = np.array(device.distortion)
    parts["R"] = lamp.R @ eye.R.T
    parts["T"] = lamp.t - parts["R"] @ eye.t
    with replacing(path) as temporary:
        storage = cv2.FileStorage(str(temporary), cv2.FILE_STORAGE_WRITE)
        for name, value in parts.items():
            storage.write(name, value)
        storage.release()
