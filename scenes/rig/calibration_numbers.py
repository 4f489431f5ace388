"""Numbers of calibration files, checked; `FileError` names the part that has others."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.rig.projection import Coefficients
from scenes.support.errors import FileError


def coefficients(value: Any, which: str, where: str) -> Coefficients:
    """k1, k2, p1, p2, k3 of a device; 0 for None."""
    terms = np.zeros(5) if value is None else _numbers(value, f"{which}_distortion", where).ravel()
    if np.any(terms[5:]):
        raise FileError(
            f"{where}: {which}_distortion has {terms.size} terms (rational, thin-prism or tilted model): "
            "calibrate with k1 k2 p1 p2 k3 alone (OpenCV's default)"
        )
    k1, k2, p1, p2, k3 = (float(term) for term in np.resize(np.append(terms[:5], np.zeros(5)), 5))
    return k1, k2, p1, p2, k3


def rotation(value: Any, where: str) -> NDArray[np.float64]:
    """A rotation matrix (3, 3), from a matrix or a Rodrigues vector."""
    array = _numbers(value, "rotation", where)
    if array.size == 3:
        return np.asarray(cv2.Rodrigues(array.reshape(3))[0], dtype=np.float64)
    matrix = shaped(value, (3, 3), "rotation", where)
    off, determinant = off_rotation(matrix)
    if not (off <= 1e-4 and determinant > 0):
        raise FileError(
            f"{where}: rotation is no rotation (R R^T is off the identity by {off:.3g}, determinant {determinant:.3g})"
        )
    return matrix


def off_rotation(matrix: ArrayLike) -> tuple[float, float]:
    """Largest difference of ``R R^T`` from the identity, and the determinant."""
    R = np.asarray(matrix, np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.abs(R @ R.T - np.eye(3)).max()), float(np.linalg.det(R))


def shaped(value: Any, shape: Sequence[int], part: str, where: str) -> NDArray[np.float64]:
    """Numbers of that shape."""
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
