"""Meshes from files, their polygons cut into triangles that fill them.

trimesh cuts each polygon into a fan from its first corner, which is right for convex ones alone.
"""

import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import mapbox_earcut
import numpy as np
import trimesh
from numpy.typing import NDArray

from scenes.support.errors import MeshError
from scenes.support.paths import is_file, missing

Floats = NDArray[np.float64]

_OBJ_POLYGON = re.compile(rb"^[ \t]*f(?:[ \t]+\S+){4,}", re.MULTILINE)
# Share of a polygon's area by which its triangles may differ: a crossed outline differs by far more.
AREA_SHARE = 1e-6


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Triangles in the file's unit, of any format that trimesh reads; concave polygons of OBJ, PLY and OFF are cut into
    triangles inside.
    """
    if not is_file(path):
        raise MeshError(f"mesh '{path}' {missing(path)}: give a PLY, STL, OBJ or GLB file")
    try:
        mesh = _loaded(path)
    except MeshError:
        raise
    except Exception as error:
        raise MeshError(
            f"mesh '{path}' cannot be read ({error}): give a PLY, STL, OBJ or GLB file of triangles"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh):
        raise MeshError(f"mesh '{path}' contains no triangles: export it as a triangle mesh")
    return mesh


def _loaded(path: Path) -> Any:
    kind = path.suffix.lower()
    if kind == ".obj":
        content = path.read_bytes()
        if _OBJ_POLYGON.search(content):
            text = "\n".join(_obj_lines(content.decode("utf-8", "replace"), path))
            source = io.BytesIO(text.encode())
            resolver = trimesh.resolvers.FilePathResolver(str(path))
            return trimesh.load_mesh(source, file_type="obj", process=False, resolver=resolver)
    mesh = trimesh.load_mesh(path, process=False)
    if kind == ".ply" and isinstance(mesh, trimesh.Trimesh):
        return _refilled(mesh, _ply_polygons(mesh), path)
    if kind == ".off" and isinstance(mesh, trimesh.Trimesh):
        return _refilled(mesh, _off_polygons(path), path)
    return mesh


def _obj_lines(text: str, path: Path) -> Iterator[str]:
    """The file's lines, each concave face replaced by triangles of the same corners."""
    points: list[list[float]] = []
    for line in re.sub(r"\\\r?\n", " ", text).splitlines():
        words = line.split("#")[0].split()
        if words[:1] == ["v"]:
            points.append([float(word) for word in words[1:4]])
        elif words[:1] == ["f"] and len(words) > 4:
            corners = words[1:]
            index = [int(corner.split("/")[0]) for corner in corners]
            place = np.array([points[i - 1 if i > 0 else len(points) + i] for i in index])
            triangles = concave_triangles(place, path)
            if triangles is not None:
                yield from ("f " + " ".join(corners[i] for i in t) for t in triangles)
                continue
        yield line


def _ply_polygons(mesh: trimesh.Trimesh) -> Sequence[NDArray[np.int64]]:
    """Corners of each face as the file lists them; none if it has no lists."""
    data = mesh.metadata.get("_ply_raw", {}).get("face", {}).get("data")
    names = ("vertex_indices", "vertex_index")
    known = data.dtype.names if isinstance(data, np.ndarray) else data
    name = next((name for name in names if known is not None and name in known), None)
    if data is None or name is None:
        return []
    listed = data[name]
    # A structured array of lists of one length has the lengths in it, too.
    if isinstance(listed, np.ndarray) and listed.dtype.names:
        listed = listed[listed.dtype.names[-1]]
    return [np.asarray(face, dtype=np.int64) for face in listed]


def _off_polygons(path: Path) -> Sequence[NDArray[np.int64]]:
    text = re.sub(r"#.*", "", path.read_text("utf-8", "replace"))
    words = text.split()
    if not words[0].upper().endswith("OFF"):
        return []
    vertices, faces = int(words[1]), int(words[2])
    lines = [line.split() for line in text.splitlines() if line.strip()]
    # Faces are the last lines; colours may follow a face's corners.
    tail = lines[len(lines) - faces :] if len(lines) >= vertices + faces else []
    return [np.array(line[1 : 1 + int(line[0])], dtype=np.int64) for line in tail]


def _refilled(
    mesh: trimesh.Trimesh, polygons: Sequence[NDArray[np.int64]], path: Path
) -> trimesh.Trimesh:
    """The mesh with triangles that fill the polygons; as it is where none is concave."""
    if all(len(polygon) < 4 for polygon in polygons):
        return mesh
    if max(int(polygon.max(initial=0)) for polygon in polygons) >= len(mesh.vertices):
        raise MeshError(f"mesh '{path}' has polygons of vertices it lacks: export it as triangles")
    faces: list[NDArray[np.int64]] = []
    concave = False
    for polygon in polygons:
        fan = np.array([[0, i, i + 1] for i in range(1, len(polygon) - 1)], dtype=np.int64)
        filled = None
        if len(polygon) > 3:
            filled = concave_triangles(mesh.vertices[polygon], path)
        concave = concave or filled is not None
        if len(polygon) > 2:
            faces.append(polygon[fan if filled is None else filled])
    if not concave:
        return mesh
    return trimesh.Trimesh(mesh.vertices, np.concatenate(faces), process=False)


def concave_triangles(corners: Floats, path: Path) -> NDArray[np.int64] | None:
    """Triangles (triangle, 3) that fill a concave polygon (corner, 3), wound as it is; None for a convex one, which a
    fan fills.
    """
    after = np.roll(corners, -1, axis=0)
    # Newell's normal, twice the area long.
    normal = np.cross(corners - corners[0], after - corners[0]).sum(axis=0)
    area = float(np.linalg.norm(normal))
    if not np.isfinite(area) or area == 0.0:
        return None
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    flat = np.column_stack([corners @ across, corners @ np.cross(normal / area, across)])
    along = np.roll(flat, -1, axis=0) - flat
    turn = _cross(np.roll(along, 1, axis=0), along)
    fan = _cross(flat[1:-1] - flat[0], flat[2:] - flat[0])
    # In a convex polygon no corner turns back, and the fan has no triangle upside down.
    if (turn >= -1e-9 * area).all() and (fan >= -1e-9 * area).all():
        return None
    count = np.array([len(flat)], dtype=np.uint32)
    triangles = mapbox_earcut.triangulate_float64(flat, count).reshape(-1, 3).astype(np.int64)
    a, b, c = (flat[triangles[:, i]] for i in range(3))
    signed = _cross(b - a, c - a)
    triangles[signed < 0] = triangles[signed < 0][:, ::-1]
    if abs(float(np.abs(signed).sum()) - area) > AREA_SHARE * area:
        raise MeshError(
            f"mesh '{path}' has a polygon at {np.round(corners.mean(axis=0), 4).tolist()} whose outline crosses itself: "
            "repair it, or export triangles"
        )
    return triangles


def _cross(a: Floats, b: Floats) -> Floats:
    product: Floats = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return product
