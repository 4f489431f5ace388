"""Polygons of mesh files: their triangles have the polygon's own area and outline."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from scenes.shapes.mesh_files import concave_triangles, read_mesh
from scenes.support.errors import MeshError

Floats = NDArray[np.float64]


def star(points: int, inner: float) -> Floats:
    """A star's outline in the plane, counter-clockwise."""
    angle = np.pi * np.arange(2 * points) / points
    reach = np.where(np.arange(2 * points) % 2, inner, 1.0)
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


OUTLINES: dict[str, Floats] = {
    "notch": np.array([(-2, -2), (2, -2), (2, 2), (0, -1), (-2, 2)], float),
    "dart": np.array([(0, 0), (2, -1), (1, 0), (2, 1)], float),
    "L": np.array([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)], float),
    "star": star(7, 0.3),
    "square": np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float),
    "hexagon": star(3, 1.0),
}
FORMATS = ("obj", "obj with normals and negative numbers", "ply", "binary ply", "off")


def shoelace(outline: Floats) -> float:
    x, y = outline.T
    return float(0.5 * np.abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def tilted(outline: Floats) -> Floats:
    """The outline in a plane across all three axes."""
    turn, _ = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))
    flat = np.column_stack([outline, np.zeros(len(outline))])
    placed: Floats = np.asarray(flat @ turn.T, np.float64)
    placed += np.array([0.5, -3.0, 2.0])
    return placed


def write(folder: Path, kind: str, corners: Floats, faces: list[list[int]]) -> Path:
    path = (
        folder
        / f"mesh.{kind.rsplit(maxsplit=1)[-1] if 'ply' in kind else kind.split(maxsplit=1)[0]}"
    )
    rows = [" ".join(map(repr, row)) for row in corners.tolist()]
    if kind == "obj":
        lines = [f"v {row}" for row in rows]
        lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces]
    elif kind.startswith("obj"):
        lines = [f"v {row}" for row in rows] + ["vn 0 0 1"]
        for face in faces:
            lines.append("f " + " ".join(f"{i - len(rows)}//1" for i in face))
    elif kind == "off":
        lines = ["OFF", f"{len(rows)} {len(faces)} 0", *rows]
        lines += [" ".join(map(str, [len(face), *face])) for face in faces]
    else:
        form = "ascii" if kind == "ply" else "binary_little_endian"
        lines = ["ply", f"format {form} 1.0", f"element vertex {len(rows)}"]
        lines += [f"property double {axis}" for axis in "xyz"]
        lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        lines += ["end_header"]
        if form == "ascii":
            lines += rows + [" ".join(map(str, [len(face), *face])) for face in faces]
        else:
            body = corners.astype("<f8").tobytes()
            for face in faces:
                body += bytes([len(face)]) + np.array(face, "<i4").tobytes()
            path.write_bytes("\n".join([*lines, ""]).encode() + body)
            return path
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("start", [0, 1, 3])
@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("kind", FORMATS)
def test_triangles_fill_the_polygon(tmp_path: Path, kind: str, name: str, start: int) -> None:
    outline = np.roll(OUTLINES[name], start, axis=0)
    corners = tilted(outline)
    mesh = read_mesh(write(tmp_path, kind, corners, [list(range(len(corners)))]))
    assert len(mesh.faces) == len(corners) - 2
    assert mesh.area == pytest.approx(shoelace(outline), rel=1e-6)
    # One side up, as the outline runs, and no edge beyond it: areas of triangles alone could overlap and add up.
    normal = np.cross(corners - corners.mean(axis=0), np.roll(corners, -1, axis=0)).sum(axis=0)
    assert (mesh.face_normals @ (normal / np.linalg.norm(normal)) > 0.99).all()
    assert abs(trimesh.triangles.area(mesh.triangles).sum() - shoelace(outline)) < 1e-5
    rims = np.sort(mesh.edges, axis=1)
    _, count = np.unique(rims, axis=0, return_counts=True)
    assert (count == 1).sum() == len(corners)


@pytest.mark.parametrize("size", [1e-5, 1.0, 1e5])
@pytest.mark.parametrize("name", OUTLINES)
def test_only_convex_polygons_of_any_size_are_filled_by_fans(name: str, size: float) -> None:
    found = concave_triangles(size * tilted(OUTLINES[name]), Path("a.obj"))
    assert (found is None) == (name in ("square", "hexagon"))
    # No corner of a pentagram turns back, yet it runs round twice.
    angle = 0.8 * np.pi * np.arange(5)
    with pytest.raises(MeshError, match="crosses itself"):
        concave_triangles(
            size * tilted(np.column_stack([np.cos(angle), np.sin(angle)])), Path("a.obj")
        )


@pytest.mark.parametrize("kind", FORMATS)
def test_mixed_faces_are_all_kept(tmp_path: Path, kind: str) -> None:
    notch = np.column_stack([OUTLINES["notch"], np.zeros(5)])
    corners = np.concatenate([notch, [[9.0, 0, 0], [10.0, 0, 0], [10.0, 1, 0], [9.0, 1, 0]]])
    path = write(tmp_path, kind, corners, [[0, 1, 2, 3, 4], [5, 6, 7], [5, 7, 8]])
    if kind in ("binary ply", "off"):
        # trimesh 5.2 does not read faces of several lengths from these.
        with pytest.raises(MeshError, match="of triangles"):
            read_mesh(path)
        return
    mesh = read_mesh(path)
    assert mesh.area == pytest.approx(10.0 + 1.0, rel=1e-6)


@pytest.mark.parametrize("kind", FORMATS)
def test_crossed_polygon_is_refused(tmp_path: Path, kind: str) -> None:
    corners = np.array([(0.0, 0, 0), (4, 0, 0), (1, 2, 0), (3, 3, 0), (0, 3, 0), (4, 1, 0)])
    with pytest.raises(MeshError, match="crosses itself"):
        read_mesh(write(tmp_path, kind, corners, [[0, 1, 2, 3, 4, 5]]))
