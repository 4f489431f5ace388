"""COLMAP's text model as a calibration: two images of cameras.txt and images.txt are the two devices.

COLMAP counts from an image's upper left corner, so half a pixel is taken off its principal points to become OpenCV's. Its
poses take the world's points to the camera's, and its lengths have the unit that the model was scaled to.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scenes.support.errors import FileError, nearest

# Places in each model's parameters: focal lengths, principal point, distortion in OpenCV's order.
MODELS: dict[str, tuple[tuple[int, int, int, int], tuple[int, ...]]] = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)),
    "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), tuple(range(4, 12))),
}
OTHER_MODELS = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "FOV")  # fmt: skip
CAMERAS, IMAGES = "COLMAP cameras", "COLMAP images"


def colmap_nodes(text: str, path: Path) -> dict[str, Any] | None:
    """Cameras or images of a COLMAP text by number or name; None if the text is none of COLMAP's.

    Raises `FileError` for a camera model without Brown's distortion, and for damaged lines.
    """
    lines = [line.split() for line in text.splitlines() if not line.lstrip().startswith("#")]
    filled = [words for words in lines if words]
    if not filled or len(filled[0]) < 5:
        return None
    try:
        if filled[0][1] in (*MODELS, *OTHER_MODELS):
            return {CAMERAS: {words[0]: _camera(words) for words in filled}}
        if len(filled[0]) >= 10 and not _is_number(filled[0][9]):
            # Every other line has the image's points, and may be empty.
            while lines and not lines[0]:
                lines.pop(0)
            return {IMAGES: {" ".join(w[9:]): w for w in lines[::2] if len(w) >= 10}}
    except (ValueError, IndexError) as error:
        raise FileError(f"calibration '{path}' is a damaged COLMAP text: {error}") from None
    return None


def colmap_parts(nodes: Mapping[str, Any], own: Mapping[str, str], where: str) -> dict[str, Any]:
    """Parts of the calibration of two images, which `own` names as first_matrix and second_matrix if there are more.

    Raises `FileError` if a file is missing, or it is not clear which two images are the devices.
    """
    if CAMERAS not in nodes or IMAGES not in nodes:
        raise FileError(f"{where}: COLMAP's model needs both cameras.txt and images.txt: give both")
    images = nodes[IMAGES]
    names = [own[part] for part in ("first_matrix", "second_matrix") if part in own]
    names = names or list(images)
    unknown = [name for name in names if name not in images]
    if unknown:
        raise FileError(f"{where} has no image '{unknown[0]}': {nearest(unknown[0], images)}")
    if len(names) != 2:
        raise FileError(
            f"{where} has the images {sorted(images)[:8]}: say which two are the devices, with "
            'names = { first_matrix = "...", second_matrix = "..." }'
        )
    parts: dict[str, Any] = {}
    poses = []
    for which, name in zip(("first", "second"), names, strict=True):
        words = images[name]
        try:
            w, x, y, z, *t = (float(word) for word in words[1:8])
            parts |= {f"{which}_{key}": value for key, value in nodes[CAMERAS][words[8]].items()}
            poses.append((Rotation.from_quat((x, y, z, w)).as_matrix(), np.array(t)))
        except (KeyError, ValueError) as error:
            raise FileError(f"{where}: the line of image '{name}' is damaged: {error}") from None
    (R1, t1), (R2, t2) = poses
    R = R2 @ R1.T
    # Structure from motion fixes no scale: only the user knows it.
    return parts | {"rotation": R, "translation": t2 - R @ t1, "mm_per_unit": None}


def _camera(words: list[str]) -> dict[str, Any]:
    _, model, width, height, *rest = words
    if model not in MODELS:
        raise ValueError(
            f"the camera model {model} is not Brown's: use OPENCV or PINHOLE in COLMAP"
        )
    numbers = [float(word) for word in rest]
    (fx, fy, cx, cy), terms = MODELS[model]
    K = [[numbers[fx], 0.0, numbers[cx] - 0.5], [0.0, numbers[fy], numbers[cy] - 0.5], [0, 0, 1]]
    distortion = [numbers[i] for i in terms]
    distortion += [0.0] * (4 - len(distortion))
    return {"matrix": np.array(K), "distortion": distortion, "size": [int(width), int(height)]}


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
