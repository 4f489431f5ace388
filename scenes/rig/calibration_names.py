"""Which entry of a calibration file is which part of the calibration: other programs' names, and what is left over."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from scenes.rig.colmap_files import CAMERAS, IMAGES, colmap_parts
from scenes.support.errors import FileError, nearest

# What other programs call each part, first device then second; compared without case, spaces, dots and underscores.
NAMES: dict[str, tuple[str, ...]] = {
    "first_matrix": (
        "cam_K", "camera_matrix", "cameraMatrix", "cameraMatrix1", "camera_matrix_1", "camera_matrix1", "K1", "M1",
        "cam_int", "cam_intrinsics", "camera_intrinsics", "camera_K", "Kc", "mtx", "mtx1", "KK", "left_K", "K_left",
        "M1_left", "KK_left", "KK_cam", "camera_intrinsic", "K",
    ),
    "first_distortion": (
        "cam_kc", "distortion_coefficients", "distCoeffs", "distCoeffs1", "dist_coeffs", "dist_coeffs_1", "D1",
        "cam_dist", "cam_distortion", "camera_distortion", "kc", "dist", "dist1", "left_D", "D_left", "kc_left", "kc_cam", "D",
    ),
    "first_size": ("cam_size", "image_size", "imageSize", "camera_size", "camera_resolution", "size1", "img_size", "size_1"),
    "second_matrix": (
        "pro_K", "proj_K", "projector_matrix", "projector_K", "cameraMatrix2", "camera_matrix_2", "camera_matrix2",
        "K2", "M2", "proj_int", "prj_int", "projector_intrinsics", "proj_intrinsics", "Kp", "mtx2", "right_K", "K_right",
        "KK_right", "KK_proj", "projector_intrinsic",
    ),
    "second_distortion": (
        "pro_kc", "proj_kc", "projector_distortion", "distCoeffs2", "dist_coeffs_2", "D2", "proj_dist", "prj_dist",
        "projector_dist", "dist2", "kp", "right_D", "D_right", "kc_right", "kc_proj",
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
NONE = "none"
"""In `names`: there is no such part."""
# Numbers of terms that OpenCV's distortion models have.
DISTORTION_TERMS = (4, 5, 8, 12, 14)
# Larger numbers are no distortion terms of a lens.
MAX_TERM = 1e3


def parts_by_name(
    nodes: Mapping[str, Any], own: Mapping[str, str], where: str, require_all: bool = True
) -> dict[str, Any]:
    """Entries of a file by part; `own` gives the file's name of a part, or "none" for an absent one.

    Raises `FileError` if a required part is missing, or an unused entry looks like an optional part that is missing.
    """
    for part, name in own.items():
        if part not in NAMES:
            raise FileError(f"calibration.names has '{part}': {nearest(part, NAMES)}")
        if name not in nodes and name != NONE:
            raise FileError(f"{where} has no '{name}' for {part}: {nearest(name, nodes)}")
    # `T` and `t`, `K` and `k`: an exact name goes before one that differs in case.
    plain = {_plain(key): key for key in reversed(list(nodes))}
    chosen: dict[str, str] = {}
    for part, usual in NAMES.items():
        names = [own[part]] if part in own else [n for n in usual if n in nodes]
        names = names or [plain[_plain(n)] for n in usual if _plain(n) in plain]
        if names and names[0] != NONE:
            chosen[part] = names[0]
    parts = {part: nodes[name] for part, name in chosen.items()}
    for part, (width, height) in WIDTHS.items():
        if part not in parts and width in nodes and height in nodes:
            parts[part] = [nodes[width], nodes[height]]
    missing = [part for part in REQUIRED if part not in parts]
    if missing and require_all:
        raise FileError(
            f"{where} has {sorted(nodes)}: none is known as {', '.join(missing)}; say which with "
            f'names = {{ {missing[0]} = "..." }}'
        )
    if require_all:
        _check_unused(nodes, chosen, own, where)
    return parts


def parts_of(
    files: Sequence[Mapping[str, Any]], own: Mapping[str, str], where: str
) -> dict[str, Any]:
    """Parts of a calibration in one file, in several that complete each other, or in one file a device.

    Two files that both have a first device's matrix and no second's are the first and the second device, as ROS writes
    them. Their rectification and projection matrices then give rotation and translation, in metres.
    """
    nodes: dict[str, Any] = {}
    for file in files:
        nodes |= file
    if CAMERAS in nodes or IMAGES in nodes:
        return colmap_parts(nodes, own, where)
    each = [parts_by_name(file, {}, where, require_all=False) for file in files]
    devices = [parts for parts in each if "first_matrix" in parts]
    if own or len(devices) != 2 or any("second_matrix" in parts for parts in each):
        return parts_by_name(nodes, own, where)
    for file, device in zip(files, each, strict=True):
        left_out = [n for n, v in file.items() if not any(v is part for part in device.values())]
        alike = [name for name in left_out if _is_distortion(file[name])]
        if "first_matrix" in device and "first_distortion" not in device and alike:
            raise FileError(
                f"{where}: a device has no distortion, but '{alike[0]}' is unused and has as many numbers: rename it to "
                "distortion_coefficients, or remove it"
            )
    first, second = devices
    parts = {part: value for p in each for part, value in p.items() if not part.startswith("first")}
    parts |= {part: value for part, value in first.items() if part.startswith("first")}
    parts |= {
        part.replace("first", "second"): value
        for part, value in second.items()
        if part.startswith("first")
    }
    infos = [file for file in files if "projection_matrix" in file]
    if "rotation" not in parts and len(infos) == 2:
        parts |= _rectified(infos[0], infos[1], where)
    missing = [part for part in REQUIRED if part not in parts]
    if missing:
        raise FileError(
            f"{where} have one device each, but no {' and no '.join(missing)}: add a file with R and T, which take the first "
            "device's points to the second's"
        )
    return parts


def _rectified(first: Mapping[str, Any], second: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Rotation and translation of a rectified pair: ``R2 x2 = R1 x1 + d``, with d in the second projection matrix."""
    try:
        R1, R2 = (
            np.asarray(f["rectification_matrix"], dtype=np.float64).reshape(3, 3)
            for f in (first, second)
        )
        P1, P2 = (
            np.asarray(f["projection_matrix"], dtype=np.float64).reshape(3, 4)
            for f in (first, second)
        )
        focal = np.array([P2[0, 0], P2[1, 1], 1.0])
        shift = (P2[:, 3] - P1[:, 3]) / focal
    except (KeyError, TypeError, ValueError) as error:
        raise FileError(
            f"{where}: rectification_matrix or projection_matrix is damaged: {error}"
        ) from error
    if not np.isfinite(shift).all() or not shift.any():
        raise FileError(
            f"{where}: the projection matrices have no baseline: calibrate the two as a stereo pair, or add a file with R and T"
        )
    return {"rotation": R2.T @ R1, "translation": R2.T @ shift, "mm_per_unit": 1000.0}


def _check_unused(
    nodes: Mapping[str, Any], chosen: Mapping[str, str], own: Mapping[str, str], where: str
) -> None:
    """Refuse to leave out an entry that looks like a distortion where one is missing: heights would be off unnoticed."""
    unused = [name for name in nodes if name not in chosen.values()]
    for part in ("first_distortion", "second_distortion"):
        alike = [name for name in unused if _is_distortion(nodes[name])]
        if part in chosen or part in own or not alike:
            continue
        # "M4" belongs to "D4": the name that shares most with the matrix' is named first.
        matrix = chosen[part.replace("distortion", "matrix")]
        alike.sort(key=lambda name: -len(set(name) & set(matrix)))
        raise FileError(
            f"{where} has nothing known as {part}, but '{alike[0]}' is unused and has as many numbers as a distortion"
            + (f" (so have {', '.join(alike[1:])})" if alike[1:] else "")
            + f': say names = {{ {part} = "{alike[0]}" }}, or "{NONE}" if the device has none'
        )


def _is_distortion(value: Any) -> bool:
    try:
        terms = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    vector = terms.ndim >= 1 and terms.size == max(terms.shape, default=0)
    likely = vector and terms.size in DISTORTION_TERMS and np.isfinite(terms).all()
    return bool(likely and np.any(terms) and np.all(np.abs(terms) < MAX_TERM))


def _plain(name: str) -> str:
    return name.casefold().translate(str.maketrans("", "", "_-. "))
