"""Entries of calibration files by name: OpenCV's YAML, XML and JSON, ROS camera_info, MATLAB's .mat, COLMAP's, numbers in text.

A text has blocks of numbers, each under a line with its name (``K1:`` or ``K1 =``) or, as in Zhang's files, without names;
then the blocks say what they are: a matrix with the last row 0 0 1 is an intrinsic matrix, an orthonormal one a rotation,
4 or 5 numbers a distortion, 3 a translation, 3 x 4 a pose ``[R | t]`` or a projection matrix ``K [R | t]``.
"""

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy.io
from numpy.typing import NDArray

from scenes.rig.calibration_numbers import off_rotation
from scenes.rig.colmap_files import colmap_nodes
from scenes.support.errors import FileError
from scenes.support.safe_parse import parse_json, parse_xml, parse_yaml

TEXT = (".txt", ".dat", ".cal", ".csv", ".m")
# Distortion models whose coefficients are Brown's, in OpenCV's order.
BROWN = ("plumb_bob", "radtan", "rational_polynomial", "brown", "opencv", "none", "pinhole", "")
# R R^T of a rotation written with four digits.
ORTHONORMAL = 1e-3


PARSERS: dict[str, tuple[Callable[[str], Any], str]] = {
    ".json": (parse_json, "JSON"),
    ".xml": (parse_xml, "XML"),
}


def entries(path: Path) -> dict[str, Any]:
    """Top-level entries of a file: arrays and numbers."""
    try:
        if path.suffix.lower() == ".mat":
            return _of_matlab(path)
        text = path.read_text("utf-8")
    except FileNotFoundError:
        raise FileError(f"calibration '{path}' does not exist: check the path") from None
    except (OSError, ValueError) as error:
        raise FileError(f"calibration '{path}' cannot be read: {error}") from error
    if path.suffix.lower() == ".txt" and (found := colmap_nodes(text, path)):
        return found
    if path.suffix.lower() in TEXT and not text.lstrip().startswith(("%YAML", "<", "{")):
        return _of_text(text, path)
    # Not by cv2.FileStorage: where a file is damaged it may never return, or write beyond its matrix and abort
    parse, kind = PARSERS.get(path.suffix.lower(), (parse_yaml, "YAML"))
    if kind == "YAML" and text.lstrip("\ufeff \t\r\n").startswith("<"):
        parse, kind = parse_xml, "XML"
    try:
        tree = parse(text)
    except ValueError as error:
        raise FileError(f"calibration '{path}' is not valid {kind}: {error}") from error
    if not isinstance(tree, dict):
        raise FileError(
            f"calibration '{path}' has no named entries: give a file (YAML, XML or JSON) as cv::FileStorage writes it, "
            "a .mat file, or a text of numbers"
        )
    model = str(tree.get("distortion_model", "")).casefold()
    if model not in BROWN:
        raise FileError(
            f"calibration '{path}' has the distortion model '{model}': calibrate with plumb_bob, Brown's k1 k2 p1 p2 k3"
        )
    return {key: _value(value) for key, value in tree.items()}


def _value(value: Any) -> Any:
    if isinstance(value, dict):
        return _matrix(_value(value.get("data")), value.get("rows"), value.get("cols"))
    if isinstance(value, list):
        return [_value(item) for item in value]
    # OpenCV's spelling of NaN and infinity.
    return value.replace(".Nan", "nan").replace(".Inf", "inf") if isinstance(value, str) else value


def _matrix(data: Any, rows: Any, columns: Any) -> NDArray[np.float64] | None:
    """A stored matrix, flat where it does not say its shape; None where it is none."""
    try:
        flat = np.asarray(data, dtype=np.float64).ravel()
        shape = (flat.size,) if rows is None else (int(float(rows)), int(float(columns)))
        # A negative size would be taken as "whatever fits".
        return flat.reshape(shape) if min(shape) > 0 else None
    except (TypeError, ValueError, OverflowError):
        return None


def _of_matlab(path: Path) -> dict[str, Any]:
    """Variables of a .mat file; with the toolbox' focal lengths and principal points as matrices where it has none."""
    try:
        found = scipy.io.loadmat(path, squeeze_me=False)
    except FileNotFoundError:
        raise
    except NotImplementedError:
        raise FileError(
            f"calibration '{path}' is a .mat file of version 7.3: save it with save(..., '-v7')"
        ) from None
    # SciPy raises errors of many kinds for a damaged file.
    except Exception as error:
        raise FileError(f"calibration '{path}' is no readable .mat file: {error}") from error
    nodes = {
        name: value
        for name, value in found.items()
        if not name.startswith("__") and getattr(value, "dtype", np.dtype(object)).kind in "fiu"
    }
    for name in list(nodes):
        suffix = name[2:] if name.startswith("fc") else None
        if suffix is not None and f"cc{suffix}" in nodes and f"KK{suffix}" not in nodes:
            (fx, fy), (cx, cy) = (np.ravel(nodes[f"{n}{suffix}"])[:2] for n in ("fc", "cc"))
            skew = float(np.ravel(nodes.get(f"alpha_c{suffix}", 0.0))[0])
            nodes[f"KK{suffix}"] = np.array([[fx, skew * fx, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if "nx" in nodes and "ny" in nodes:
        nodes["image_size"] = np.ravel([nodes["nx"], nodes["ny"]])
    return nodes


def _of_text(text: str, path: Path) -> dict[str, Any]:
    """Blocks of numbers by name; ones without a name are named by what they are."""
    named: dict[str, Any] = {}
    plain: list[NDArray[np.float64]] = []
    for name, rows in _blocks(text):
        if len({len(row) for row in rows}) != 1:
            raise FileError(
                f"calibration '{path}': the rows of {name or 'a block'} have {[len(r) for r in rows]} numbers: "
                "separate blocks by an empty line"
            )
        block = np.array(rows)
        if name:
            named[name] = block if min(block.shape) > 1 else block.ravel()
        else:
            plain.append(block if min(block.shape) > 1 else block.ravel())
    return {**_recognised(plain, path), **named}


def _blocks(text: str) -> list[tuple[str, list[list[float]]]]:
    """Name, or an empty one, and rows of numbers of each block."""
    blocks: list[tuple[str, list[list[float]]]] = []
    fresh = True
    for line in text.splitlines():
        stripped = re.split(r"[#%]|//", line)[0].strip()
        words = re.split(r"[\s,;\[\]()=:]+", stripped)
        label = re.match(r"[A-Za-z][\w .\-]*", stripped)
        if label and not re.match(r"(nan|inf)\b", stripped, re.IGNORECASE):
            blocks.append((re.sub(r"[\s\-.]+", "_", label[0].strip()), []))
            rest = stripped[label.end() :]
            # MATLAB and Python write the rows of a matrix on one line.
            rows = [_numbers(part) for part in re.split(r";|\]\s*,?\s*\[", rest)]
            blocks[-1][1].extend(row for row in rows if row)
            fresh = False
        elif any(words):
            row = _numbers(stripped)
            if fresh or not blocks:
                blocks.append(("", []))
            blocks[-1][1].append(row)
            fresh = False
        elif blocks and blocks[-1][1]:
            fresh = True
    return [(name, rows) for name, rows in blocks if rows]


def _numbers(text: str) -> list[float]:
    words = [word for word in re.split(r"[\s,;\[\]()=:]+", text) if word]
    try:
        return [float(word) for word in words]
    except ValueError:
        return []


def _recognised(blocks: Sequence[NDArray[np.float64]], path: Path) -> dict[str, Any]:
    """Blocks without names under the project's names, first device then second."""
    matrices, distortions, poses, sizes = [], [], [], []
    found: dict[str, Any] = {}
    for block in blocks:
        if block.shape == (3, 3) and np.array_equal(block[2], (0.0, 0.0, 1.0)):
            matrices.append(block)
        elif block.shape == (3, 3) and _is_rotation(block):
            found["R"] = block
        elif block.shape in ((3, 4), (4, 4)):
            poses.append(block[:3])
        elif block.shape == (3,):
            found["T"] = block
        elif block.shape in ((4,), (5,)):
            distortions.append(block)
        elif block.shape == (2,):
            sizes.append(block)
        else:
            raise FileError(
                f"calibration '{path}' has a block of {' x '.join(map(str, block.shape))} numbers that is no matrix, distortion, "
                "rotation, translation or pose: write its name above it (K1, D1, K2, D2, R, T), or remove it"
            )
    if poses and not all(_is_rotation(pose[:, :3]) for pose in poses):
        poses, matrices = _decomposed(poses, matrices, path)
    if len(poses) == 2:
        (R1, t1), (R2, t2) = ((pose[:, :3], pose[:, 3]) for pose in poses)
        found["R"] = R2 @ R1.T
        found["T"] = t2 - found["R"] @ t1
    elif len(poses) == 1:
        found["R"], found["T"] = poses[0][:, :3], poses[0][:, 3]
    for kind, values in (("K", matrices), ("D", distortions), ("size", sizes)):
        found |= {f"{kind}{i}": value for i, value in enumerate(values, 1)}
    return found


def _decomposed(
    projections: Sequence[NDArray[np.float64]], matrices: Sequence[NDArray[np.float64]], path: Path
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Poses and intrinsic matrices of projection matrices ``K [R | t]``."""
    if matrices or len(projections) != 2:
        raise FileError(
            f"calibration '{path}' has {len(projections)} projection matrices and {len(matrices)} intrinsic ones: give two "
            "projection matrices, camera then projector, or intrinsic matrices and poses"
        )
    poses, found = [], []
    for projection in projections:
        # A projection matrix has any sign and scale.
        proper = projection * np.sign(np.linalg.det(projection[:, :3]))
        K, R, *_ = cv2.decomposeProjectionMatrix(proper)
        poses.append(np.column_stack([R, np.linalg.solve(K, proper[:, 3])]))
        K = np.asarray(K / K[2, 2], dtype=np.float64)
        # Rounding of the file's digits.
        K[0, 1] = 0.0 if abs(K[0, 1]) < ORTHONORMAL * K[0, 0] else K[0, 1]
        found.append(K)
    return poses, found


def _is_rotation(matrix: NDArray[np.float64]) -> bool:
    off, determinant = off_rotation(matrix)
    return off < ORTHONORMAL and determinant > 0
