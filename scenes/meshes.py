"""A scene's objects as triangle meshes in the world."""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.transformations import transform_points
from trimesh.triangles import area

from scenes.board_meshes import Body, bodies
from scenes.errors import MeshError
from scenes.materials import Material, material
from scenes.rig import FARTHEST_MM
from scenes.scene import Object, Scene

# Triangles looked at together.
BLOCK = 1 << 10


@dataclass(frozen=True)
class Part:
    """One object, placed: what a renderer needs to know of it."""

    label: str
    mesh: trimesh.Trimesh
    """World mm."""
    material: Material
    smooth: bool
    """Shade with vertex normals instead of the triangles' own."""
    material_name: str = ""
    """As the scene names it."""
    face_pad: NDArray[np.int32] | None = None
    """(face,) id of the board's pad that each triangle belongs to, 0 for none; None: no board's part."""


def parts(scene: Scene) -> tuple[Part, ...]:
    """Every object and the board as placed, checked meshes with their materials; `MeshError` if one is unusable."""
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
    printed = bodies(scene.board) if scene.board else ()
    return (*own, *(_part(body, scene) for body in printed))


def meshes(scene: Scene) -> dict[str, trimesh.Trimesh]:
    """Label -> mesh in world mm; objects that share a label come as one mesh.

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
    # what overflows is refused by the checks
    with np.errstate(all="ignore"):
        mesh = item.shape.mesh()
    _check(mesh, item.label)
    # Not apply_transform, which hashes all there is to keep what nobody has asked for.
    placed = transform_points(np.asarray(mesh.vertices), item.placement())
    mesh = trimesh.Trimesh(placed, np.asarray(mesh.faces), process=False)
    _check_reach(mesh, item.label)
    return mesh


def _check(mesh: trimesh.Trimesh, label: str) -> None:
    if not len(mesh.faces):
        raise MeshError(f"the mesh of '{label}' has no triangles: give it at least one")
    # Plain arrays: trimesh hashes its own anew at every look.
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
    # The first triangle nearly always tells.
    starts = range(0, len(faces), BLOCK)
    if not any((area(vertices[faces[at : at + BLOCK]]) > 0).any() for at in starts):
        raise MeshError(f"every triangle of '{label}' has zero area: check its scale and vertices")


def _check_reach(mesh: trimesh.Trimesh, label: str) -> None:
    farthest = float(np.abs(np.asarray(mesh.vertices)).max())
    if farthest > FARTHEST_MM:
        raise MeshError(
            f"the mesh of '{label}' reaches to {farthest:.3g} mm: keep it within {FARTHEST_MM:.0e} mm, beyond which "
            "the renderer's numbers are coarser than a millimetre; check its scale, unit and position"
        )
