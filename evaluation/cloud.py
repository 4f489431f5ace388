"""The measured surface as a coloured point cloud, for CloudCompare, MeshLab and the like."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reconstruction
from evaluation.score import height_error_mm
from scenes.errors import ScoreError
from scenes.replace_file import replacing
from scenes.truth import Truth

# Half width of the window a normal is fitted in: its noise falls with the square of the width, its detail with the width.
NORMAL_PX = 2


def write_cloud(
    path: str | Path,
    rec: Reconstruction,
    truth: Truth | None = None,
    gray: NDArray[np.floating] | None = None,
) -> None:
    """Write the valid points as binary little-endian PLY.

    Each vertex has x y z (float, mm) and its normal (`normals`); where they are known, a gray colour, ``scalar_sigma_mm``
    and, with `truth`, ``scalar_error_mm``: measured minus true height, NaN where there is no truth. "scal" in a name is
    what CloudCompare knows a scalar field by. `gray` (row, col), such as a mean frame, is stretched to its 99th
    percentile; absent, it is the modulation.

    Raises `ScoreError` when no pixel is valid or sizes differ, `DecodeError` without a calibration, `FileError` when the
    file cannot be written.
    """
    valid = rec.valid & np.isfinite(rec.xyz_mm).all(axis=-1)
    if not valid.any():
        raise ScoreError(
            "no pixel of the reconstruction is valid, so there is no cloud to write: see its reasons"
        )
    gray = rec.modulation_dn if gray is None else gray
    if gray.shape != valid.shape:
        raise ScoreError(
            f"the gray image is (rows, cols) = {gray.shape}, the reconstruction {valid.shape}: give one of its size"
        )
    columns: dict[str, NDArray[np.generic]] = {}
    for i, axis in enumerate("xyz"):
        columns[axis] = rec.xyz_mm[valid][:, i].astype("<f4")
    for i, axis in enumerate(("nx", "ny", "nz")):
        columns[axis] = normals(rec.xyz_mm, valid)[valid][:, i].astype("<f4")
    if np.isfinite(gray[valid]).any():
        columns |= dict.fromkeys(("red", "green", "blue"), _level(gray[valid]))
    if truth is not None:
        columns["scalar_error_mm"] = height_error_mm(rec, truth)[valid].astype("<f4")
    if np.isfinite(rec.sigma_mm[valid]).any():
        columns["scalar_sigma_mm"] = rec.sigma_mm[valid].astype("<f4")

    vertices = np.empty(int(valid.sum()), dtype=[(name, c.dtype) for name, c in columns.items()])
    for name, column in columns.items():
        vertices[name] = column
    kinds = {"f": "float", "u": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment fringebench; lengths in mm",
        f"element vertex {len(vertices)}",
        *(f"property {kinds[c.dtype.kind]} {name}" for name, c in columns.items()),
        "end_header",
    ]
    with replacing(path) as beside:
        beside.write_bytes(("\n".join(header) + "\n").encode("ascii") + vertices.tobytes())


def normals(xyz_mm: NDArray[np.floating], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(row, col, 3) unit normals facing up: of the plane ``z = a + b x + c y`` fitted to the valid points in 5 x 5 pixels.

    (0, 0, 1) where the window's points determine no plane.
    """
    # Sums over a window cancel least when the coordinates are small.
    centred = xyz_mm - np.median(xyz_mm[valid], axis=0)
    x, y, z = (np.where(valid, centred[..., i], 0.0).astype(np.float64) for i in range(3))

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(ndimage.uniform_filter(values, 2 * NORMAL_PX + 1, mode="constant"))

    weight = mean(valid.astype(np.float64))
    with np.errstate(divide="ignore", invalid="ignore"):
        mx, my, mz = (mean(v) / weight for v in (x, y, z))
        xx, xy, yy = (
            mean(x * x) / weight - mx * mx,
            mean(x * y) / weight - mx * my,
            mean(y * y) / weight - my * my,
        )
        xz, yz = mean(x * z) / weight - mx * mz, mean(y * z) / weight - my * mz
        determinant = xx * yy - xy * xy
        # Three points in a row determine no plane; what is left of the determinant is rounding.
        flat = ~(determinant > 1e-6 * (xx + yy) ** 2)
        slope_x = np.where(flat, 0.0, (xz * yy - yz * xy) / determinant)
        slope_y = np.where(flat, 0.0, (yz * xx - xz * xy) / determinant)
    up = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    unit: NDArray[np.float64] = up / np.linalg.norm(up, axis=-1, keepdims=True)
    return unit


def _level(gray: NDArray[np.floating]) -> NDArray[np.uint8]:
    known = np.where(np.isfinite(gray), gray, 0.0).astype(np.float64)
    white = float(np.percentile(known, 99.0))
    return np.clip(known * (255.0 / white if white > 0 else 0.0), 0.0, 255.0).astype(np.uint8)
