"""A scene's objects as triangle meshes in the world."""

import warnings
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import transform_points
from trimesh.triangles import area

from scenes.board.board_solids import Body, bodies
from scenes.rig.devices import MAX_COORDINATE_MM
from scenes.scene import Object, Scene
from scenes.shapes.materials import Material, material
from scenes.shapes.solids import MeshFile
from scenes.support.errors import FringebenchWarning, MeshError

# A mesh this much smaller than the field of view is probably in another unit.
MESH_TOO_SMALL = 100.0
# Triangles checked at a time.
BLOCK = 1 << 10


@dataclass(frozen=True)
class Part:
    """One placed object, as a renderer needs it."""

    label: str
    mesh: trimesh.Trimesh
    """World mm."""
    material: Material
    smooth: bool
    """Shade with vertex normals instead of the triangles' own."""
    material_name: str = ""
    """Name of the material in the scene."""
    face_pad: NDArray[np.int32] | None = None
    """(face,) id of the board's pad that each triangle belongs to, 0 for none; None: not part of a board."""


def parts(scene: Scene) -> tuple[Part, ...]:
    """All objects and the board as placed, checked meshes with their materials.

    Raises `MeshError` for a mesh that cannot be rendered.

    Examples
    --------
    >>> import scenes
    >>> [part.material_name for part in scenes.parts(scenes.load("step"))]
    ['grey-paint', 'grey-paint']
    """
    own = [
        Part(
            item.label,
            _placed(item),
            material(item.material, scene.materials),
            item.smooth,
            item.material,
        )
        for item in scene.objects
    ]
    for item, part in zip(scene.objects, own, strict=True):
        if isinstance(item.shape, MeshFile):
            _check_unit(part, item.shape.scale, scene)
    printed = bodies(scene.seen_board) if scene.seen_board else ()
    return (*own, *(_part(body, scene) for body in printed))


def meshes(scene: Scene) -> dict[str, trimesh.Trimesh]:
    """Meshes in world mm by label; objects that share a label are one mesh.

    Returns
    -------
    meshes
        Label -> `trimesh.Trimesh`, vertices (vertex, 3) in mm, faces (face, 3).

    Raises
    ------
    MeshError
        A mesh cannot be rendered.

    Examples
    --------
    >>> import scenes
    >>> sorted(scenes.meshes(scenes.load("step")))
    ['base', 'step']
    """
    grouped: dict[str, list[trimesh.Trimesh]] = {}
    for part in parts(scene):
        grouped.setdefault(part.label, []).append(part.mesh)
    return {label: trimesh.util.concatenate(group) for label, group in grouped.items()}


def _part(body: Body, scene: Scene) -> Part:
    mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
    _check(mesh, body.label)
    return Part(
        body.label,
        mesh,
        material(body.material, scene.materials),
        body.smooth,
        body.material,
        body.pad,
    )


def _placed(item: Object) -> trimesh.Trimesh:
    # Coordinates that overflow are refused by the checks.
    with np.errstate(all="ignore"):
        mesh = item.shape.mesh()
    _check(mesh, item.label)
    # Not apply_transform, which hashes the whole mesh to keep caches that are not needed here.
    placed = transform_points(np.asarray(mesh.vertices), item.placement())
    mesh = trimesh.Trimesh(placed, np.asarray(mesh.faces), process=False)
    _check_reach(mesh, item.label)
    return mesh


def _check(mesh: trimesh.Trimesh, label: str) -> None:
    if not len(mesh.faces):
        raise MeshError(f"the mesh of '{label}' has no triangles: give it at least one")
    # Plain arrays: trimesh hashes its own at every access.
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        raise MeshError(
            f"the mesh of '{label}' has vertices {vertices.shape} and faces {faces.shape}: expected three "
            "coordinates and three corners each; export it again"
        )
    count = len(vertices)
    if faces.min() < 0 or faces.max() >= count:
        lost = ((faces < 0) | (faces >= count)).any(axis=1)
        face = int(np.flatnonzero(lost)[0])
        raise MeshError(
            f"the mesh of '{label}' has {int(lost.sum())} triangles with corners that do not exist (first: triangle "
            f"{face}, {faces[face].tolist()} of {count} vertices): the file is damaged, export it again"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise MeshError(
            f"the mesh of '{label}' has {int(bad.sum())} vertices that are NaN or infinite "
            f"(first: vertex {int(np.flatnonzero(bad)[0])}): repair or remove them"
        )
    _check_reach(mesh, label)
    # The first triangle nearly always has an area.
    starts = range(0, len(faces), BLOCK)
    if not any((area(vertices[faces[at : at + BLOCK]]) > 0).any() for at in starts):
        raise MeshError(f"every triangle of '{label}' has zero area: check its scale and vertices")


def _check_unit(part: Part, scale: float, scene: Scene) -> None:
    """Warn of a mesh whose extent fits the working volume in metres, and not in mm."""
    camera = scene.camera.projection()
    field = camera.points_at(float(np.mean(scene.height_range_mm)))[..., :2].reshape(-1, 2)
    volume_mm = float(np.hypot(*(np.nanmax(field, axis=0) - np.nanmin(field, axis=0))))
    extent_mm = float(np.linalg.norm(np.ptp(np.asarray(part.mesh.vertices), axis=0)))
    if not 0.0 < extent_mm < volume_mm / MESH_TOO_SMALL:
        return
    if volume_mm / 10.0 < 1000.0 * extent_mm < 10.0 * volume_mm:
        warnings.warn(
            f"the mesh of '{part.label}' is {extent_mm:.3g} mm large in a field of {volume_mm:.3g} mm: if its file is in metres, "
            f"set shape.scale = {1000.0 * scale:g}",
            FringebenchWarning,
            stacklevel=3,
        )


def _check_reach(mesh: trimesh.Trimesh, label: str) -> None:
    farthest = float(np.abs(np.asarray(mesh.vertices)).max())
    if farthest > MAX_COORDINATE_MM:
        raise MeshError(
            f"the mesh of '{label}' reaches to {farthest:.3g} mm: keep it within {MAX_COORDINATE_MM:.0e} mm, beyond which "
            "the renderer's numbers are coarser than a millimetre; check its scale, unit and position"
        )
