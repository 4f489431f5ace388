"""OpenCV calibration files (YAML, XML, JSON) as rigs: camera and projector, or two cameras.

Two conventions change on the way in. OpenCV counts a pixel's centre as a whole number, so principal points grow by half
a pixel. And a calibration has no world, only the first camera's frame (y down, z forward); the world made here has the
same x, y up and z towards the camera, and z = 0 lies `distance_mm` in front of it: height grows towards the camera.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, ValidationError

from scenes.calibration import Calibration
from scenes.emission import PinholeProjector
from scenes.errors import FileError, nearest
from scenes.foreign_text import parse_json, parse_xml, parse_yaml
from scenes.frozen import Frozen
from scenes.replace_file import replacing
from scenes.rig import Coefficients, Extrinsics, Pinhole, Resolution

# What other programs call each part, first device then second; compared without case, spaces, dots and underscores.
NAMES: dict[str, tuple[str, ...]] = {
    "first_matrix": (
        "cam_K", "camera_matrix", "cameraMatrix", "cameraMatrix1", "camera_matrix_1", "camera_matrix1", "K1", "M1",
        "cam_int", "cam_intrinsics", "camera_intrinsics", "camera_K", "Kc", "mtx", "mtx1", "KK", "left_K", "K_left",
        "M1_left", "K",
    ),
    "first_distortion": (
        "cam_kc", "distortion_coefficients", "distCoeffs", "distCoeffs1", "dist_coeffs", "dist_coeffs_1", "D1",
        "cam_dist", "cam_distortion", "camera_distortion", "kc", "dist", "dist1", "left_D", "D_left", "D",
    ),
    "first_size": ("cam_size", "image_size", "imageSize", "camera_size", "camera_resolution", "size1", "img_size"),
    "second_matrix": (
        "pro_K", "proj_K", "projector_matrix", "projector_K", "cameraMatrix2", "camera_matrix_2", "camera_matrix2",
        "K2", "M2", "proj_int", "prj_int", "projector_intrinsics", "proj_intrinsics", "Kp", "mtx2", "right_K", "K_right",
    ),
    "second_distortion": (
        "pro_kc", "proj_kc", "projector_distortion", "distCoeffs2", "dist_coeffs_2", "D2", "proj_dist", "prj_dist",
        "projector_dist", "dist2", "kp", "right_D", "D_right",
    ),
    "second_size": ("pro_size", "proj_size", "projector_size", "projector_resolution", "size2"),
    "rotation": ("R", "rotation", "rotation_matrix", "stereo_R", "R12", "cam_proj_rmat", "rmat"),
    "translation": ("T", "t", "translation", "translation_vector", "stereo_T", "T12", "cam_proj_tvec", "tvec"),
}  # fmt: skip
REQUIRED = ("first_matrix", "second_matrix", "rotation", "translation")
WIDTHS = {
    "first_size": ("image_width", "image_height"),
    "second_size": ("proj_width", "proj_height"),
}
# A working volume where nothing tells: structured light is rarely used nearer or farther than this many baselines.
DEPTH_IN_BASELINES = (0.5, 50.0)


class Source(Frozen):
    """Where a calibration is, and how to read it."""

    files: Annotated[tuple[Path, ...], Field(min_length=1)]
    """One file, or several that complete each other (intrinsics.yml, extrinsics.yml)."""
    names: dict[str, str] = {}
    """What the files call a part, where it is none of the usual names: first_matrix, second_distortion, rotation ..."""
    mm_per_unit: PositiveFloat = 1.0
    """Millimetres per unit of the translation: 1000 for metres, the square's side for squares."""
    second_to_first: bool = False
    """R and T take the second device's points to the first's; OpenCV's own take the first's to the second's."""
    distance_mm: Annotated[float, Field(ge=0.0)] = 0.0
    """How far in front of the first camera z = 0 lies."""
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
    t_mm: NDArray[np.float64]
    where: str

    @classmethod
    def read(cls, source: Source) -> Self:
        """Read the files of a source. Raises `FileError`, naming the part that is missing or impossible."""
        where = ", ".join(f"'{path}'" for path in source.files)
        nodes: dict[str, Any] = {}
        for path in source.files:
            nodes |= entries(path)
        parts = _parts(nodes, source.names, where)
        rotation = _rotation(parts["rotation"], where)
        translation = _shaped(parts["translation"], (3,), "translation", where)
        if source.second_to_first:
            rotation, translation = rotation.T, -rotation.T @ translation
        return cls(
            _intrinsics(parts, "first", where),
            _intrinsics(parts, "second", where),
            rotation,
            translation * source.mm_per_unit,
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
                message = error.errors()[0]["msg"].removeprefix("Value error, ")
                raise FileError(f"{self.where}: {name} device: {message}") from None
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
                f"{self.where}: the {name} device's principal point ({cx:.1f}, {cy:.1f}) lies far outside its "
                f"{size[0]} x {size[1]} pixels: the calibration belongs to another size"
            )
        if not 0.5 * fy < fx < 2.0 * fy:
            raise FileError(
                f"{self.where}: the {name} device's focal lengths {fx:.1f} and {fy:.1f} px differ by more than a "
                "factor of two: is this its intrinsic matrix?"
            )
        return size


PARSERS: dict[str, tuple[Callable[[str], Any], str]] = {
    ".json": (parse_json, "JSON"),
    ".xml": (parse_xml, "XML"),
}


def entries(path: Path) -> dict[str, Any]:
    """Top-level entries of a file: arrays and numbers."""
    try:
        text = path.read_text("utf-8")
    except FileNotFoundError:
        raise FileError(f"calibration '{path}' does not exist: check the path") from None
    except (OSError, ValueError) as error:
        raise FileError(f"calibration '{path}' cannot be read: {error}") from error
    # not by cv2.FileStorage: where a file is damaged it may never return, or write beyond its matrix and abort
    parse, kind = PARSERS.get(path.suffix.lower(), (parse_yaml, "YAML"))
    if kind == "YAML" and text.lstrip("\ufeff \t\r\n").startswith("<"):
        parse, kind = parse_xml, "XML"
    try:
        tree = parse(text)
    except ValueError as error:
        raise FileError(f"calibration '{path}' is not valid {kind}: {error}") from error
    if not isinstance(tree, dict):
        raise FileError(
            f"calibration '{path}' has no named entries: give a file (YAML, XML or JSON) as cv::FileStorage writes it"
        )
    return {key: _value(value) for key, value in tree.items()}


def _value(value: Any) -> Any:
    if isinstance(value, dict):
        return _matrix(_value(value.get("data")), value.get("rows"), value.get("cols"))
    if isinstance(value, list):
        return [_value(item) for item in value]
    # so OpenCV spells NaN and infinity
    return value.replace(".Nan", "nan").replace(".Inf", "inf") if isinstance(value, str) else value


def _matrix(data: Any, rows: Any, columns: Any) -> NDArray[np.float64] | None:
    """A stored matrix, flat where it does not say its shape; None where it is none."""
    try:
        flat = np.asarray(data, dtype=np.float64).ravel()
        shape = (flat.size,) if rows is None else (int(float(rows)), int(float(columns)))
        # reshape takes a negative size for "whatever fits"
        return flat.reshape(shape) if min(shape) > 0 else None
    except (TypeError, ValueError, OverflowError):
        return None


def _parts(nodes: Mapping[str, Any], own: Mapping[str, str], where: str) -> dict[str, Any]:
    """The file's entries under this module's names."""
    for part, name in own.items():
        if part not in NAMES:
            raise FileError(f"calibration.names has '{part}': {nearest(part, NAMES)}")
        if name not in nodes:
            raise FileError(f"{where} has no '{name}' for {part}: {nearest(name, nodes)}")
    # `T` and `t`, `K` and `k`: an exact name goes before one that differs in case
    plain = {_plain(key): key for key in reversed(list(nodes))}
    parts: dict[str, Any] = {}
    for part, usual in NAMES.items():
        names = [own[part]] if part in own else [n for n in usual if n in nodes]
        names = names or [plain[_plain(n)] for n in usual if _plain(n) in plain]
        if names:
            parts[part] = nodes[names[0]]
    for part, (width, height) in WIDTHS.items():
        if part not in parts and width in nodes and height in nodes:
            parts[part] = [nodes[width], nodes[height]]
    missing = [part for part in REQUIRED if part not in parts]
    if missing:
        raise FileError(
            f"{where} has {sorted(nodes)}: none is known as {', '.join(missing)}; say which with "
            f'names = {{ {missing[0]} = "..." }}'
        )
    return parts


def _plain(name: str) -> str:
    return name.casefold().translate(str.maketrans("", "", "_-. "))


def _intrinsics(parts: Mapping[str, Any], which: str, where: str) -> Intrinsics:
    matrix = _shaped(parts[f"{which}_matrix"], (3, 3), f"{which}_matrix", where)
    if abs(matrix[0, 1]) > 1e-6 * matrix[0, 0]:
        raise FileError(
            f"{where}: {which}_matrix has skew {matrix[0, 1]:g}: calibrate without skew"
        )
    size = parts.get(f"{which}_size")
    columns, rows = (None, None) if size is None else _shaped(size, (2,), f"{which}_size", where)
    return Intrinsics(
        matrix,
        _coefficients(parts.get(f"{which}_distortion"), which, where),
        None if columns is None or rows is None else (int(columns), int(rows)),
    )


def _coefficients(value: Any, which: str, where: str) -> Coefficients:
    terms = np.zeros(5) if value is None else _numbers(value, f"{which}_distortion", where).ravel()
    if np.any(terms[5:]):
        raise FileError(
            f"{where}: {which}_distortion has {terms.size} terms (rational, thin-prism or tilted model): "
            "calibrate with k1 k2 p1 p2 k3 alone (OpenCV's default)"
        )
    k1, k2, p1, p2, k3 = (float(term) for term in np.resize(np.append(terms[:5], np.zeros(5)), 5))
    return k1, k2, p1, p2, k3


def _rotation(value: Any, where: str) -> NDArray[np.float64]:
    array = _numbers(value, "rotation", where)
    if array.size == 3:
        return np.asarray(cv2.Rodrigues(array.reshape(3))[0], dtype=np.float64)
    matrix = _shaped(value, (3, 3), "rotation", where)
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
        determinant = float(np.linalg.det(matrix))
    if not (off <= 1e-4 and determinant > 0):
        raise FileError(
            f"{where}: rotation is no rotation (R R^T is off the identity by {off:.3g}, determinant {determinant:.3g})"
        )
    return matrix


def _shaped(value: Any, shape: Sequence[int], part: str, where: str) -> NDArray[np.float64]:
    array = _numbers(value, part, where)
    if array.size != np.prod(shape):
        raise FileError(
            f"{where}: {part} has not the shape {tuple(shape)}: it has {array.size} numbers"
        )
    return array.reshape(shape)


def _numbers(value: Any, part: str, where: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise FileError(f"{where}: {part} is no list of numbers") from None
    if value is None:
        raise FileError(f"{where}: {part} is no list of numbers")
    if not np.isfinite(array).all():
        raise FileError(f"{where}: {part} has values that are NaN or infinite")
    return array


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
    with replacing(path) as beside:
        storage = cv2.FileStorage(str(beside), cv2.FILE_STORAGE_WRITE)
        for name, value in parts.items():
            storage.write(name, value)
        storage.release()
