"""The measured surface as a coloured point cloud or mesh, for CloudCompare, MeshLab and the like."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reconstruction
from evaluation.scoring.regions import height_error_mm
from scenes.files.truth_maps import Truth
from scenes.support.atomic_file import replacing
from scenes.support.errors import ScoreError

# Half width of the window in which a normal is fitted: noise decreases with the square of the width, detail with the width.
NORMAL_PX = 2
GRAZING_DEG = 85.0


def write_cloud(
    path: str | Path,
    rec: Reconstruction,
    truth: Truth | None = None,
    gray: NDArray[np.floating] | None = None,
    faces: bool = False,
) -> None:
    """Write the valid points as a binary little-endian PLY file.

    Parameters
    ----------
    path
        The file.
    rec
        The reconstruction, with a calibration.
    truth
        Adds ``scalar_error_mm`` to each vertex: measured minus true height, NaN where there is no truth.
    gray
        (row, col) image for the colour of the vertices, such as a mean frame, scaled to its 99th percentile; None for the
        modulation.
    faces
        Also write the triangles between neighbouring points, see `triangles`.

    Raises
    ------
    ScoreError
        When no pixel is valid or sizes differ.
    DecodeError
        Without a calibration.
    FileError
        When the file cannot be written.

    Notes
    -----
    Each vertex has x y z (float, mm), its normal (see `normals`), and, where they are known, a gray colour and
    ``scalar_sigma_mm``. CloudCompare reads properties whose names contain "scal" as scalar fields.

    The bytes are written here and not by a library. plyfile writes points equally fast and byte for byte the same, but
    faces one by one: 2.2 s of processor time for a mesh of 640 x 480 points. trimesh writes neither a comment of ours, which
    states the unit, nor colours without alpha.
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
    corners = triangles(rec) if faces else np.empty((0, 3), np.int32)
    kinds = {"f": "float", "u": "uchar"}
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment fringebench; lengths in mm",
        f"element vertex {len(vertices)}",
        *(f"property {kinds[c.dtype.kind]} {name}" for name, c in columns.items()),
    ]
    body = [vertices.tobytes()]
    if faces:
        header += [f"element face {len(corners)}", "property list uchar int vertex_indices"]
        listed = np.empty(len(corners), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        listed["count"], listed["corners"] = 3, corners
        body.append(listed.tobytes())
    with replacing(path) as temporary:
        temporary.write_bytes(
            ("\n".join([*header, "end_header", ""])).encode("ascii") + b"".join(body)
        )


def triangles(rec: Reconstruction) -> NDArray[np.int32]:
    """Triangles between neighbouring valid pixels, facing the camera.

    Parameters
    ----------
    rec
        The reconstruction, with a calibration.

    Returns
    -------
    ndarray of int32, (triangle, 3)
        Indices into the valid points in row order. Triangles seen at more than 85 degrees from their normal are left out:
        they would span the edge of a step, where the camera saw nothing.

    Raises
    ------
    DecodeError
        Without a calibration.
    """
    xyz = rec.xyz_mm
    valid = rec.valid & np.isfinite(xyz).all(axis=-1)
    index = np.where(valid, np.cumsum(valid).reshape(valid.shape) - 1, -1).astype(np.int32)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    corners = np.concatenate(
        [np.stack(three, axis=-1).reshape(-1, 3) for three in ((a, c, b), (b, c, d))]
    )
    corners = corners[(corners >= 0).all(axis=1)]
    points = xyz[valid].astype(np.float64)
    assert rec.calibration is not None  # Otherwise xyz_mm has raised.
    camera = rec.calibration.camera.projection()
    towards = -camera.rays(camera.pixel_centres())[1][valid]
    first, second, third = (points[corners[:, i]] for i in range(3))
    normal = np.cross(second - first, third - first)
    towards = towards[corners[:, 0]]
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1)
    seen = (normal * towards).sum(axis=1) > np.cos(np.deg2rad(GRAZING_DEG)) * length
    kept: NDArray[np.int32] = corners[seen]
    return kept


def normals(xyz_mm: NDArray[np.floating], valid: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Unit normals of the measured surface, facing up.

    Parameters
    ----------
    xyz_mm
        (row, col, 3) points.
    valid
        (row, col) which points are valid.

    Returns
    -------
    ndarray of float64, (row, col, 3)
        Normal of the plane ``z = a + b x + c y`` fitted to the valid points in 5 x 5 pixels; (0, 0, 1) where they do not
        determine a plane.
    """
    # Small coordinates keep the rounding of sums over a window small.
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
        # Three points in a row determine no plane; the rest of the determinant is rounding.
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
