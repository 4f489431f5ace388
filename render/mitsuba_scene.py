"""A scene as an ordinary Mitsuba scene: geometry for the tracer, and with lights and a camera for Mitsuba's own `path`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from render.camera import camera_plugin
from render.normals import vertex_normals
from render.projector import projector_plugin
from render.variant import mi, use
from scenes.basis import basis
from scenes.errors import RenderError
from scenes.materials import Conductor, Dielectric, Diffuse, Glossy, Material
from scenes.meshes import Part, parts
from scenes.scene import Scene

# Mitsuba plays Russian roulette from this depth on; paths here end at the scene's depth alone.
NO_ROULETTE = 1_000_000


def mitsuba_scene(scene: Scene, frame: int = 0, projector: int = 0) -> Any:
    """The scene as an `mi.Scene` with one projector showing one frame, and the ambient light.

    `mi.render(it, spp=..., seed=...)` is Mitsuba's own answer, radiance in W/(m^2 sr), to what
    ``trace(scene).frames(projector)[frame]`` holds: its integrator is `path`, as deep as the scene says. `frame`
    counts the patterns of one projector. Raises `RenderError` for a frame or a projector the scene lacks.
    """
    if not 0 <= projector < len(scene.projectors):
        raise RenderError(
            f"projector {projector} does not exist: the scene has {len(scene.projectors)}, counted from 0"
        )
    count = len(scene.patterns.frames())
    if not 0 <= frame < count:
        raise RenderError(
            f"frame {frame} does not exist: the patterns have {count}, counted from 0"
        )
    use()
    light = scene.projectors[projector]
    entries = geometry(parts(scene)) | {
        "projector": projector_plugin(light, basis(scene.patterns, light, light.resolution), frame),
        "sensor": camera_plugin(scene.camera, scene.sampling.samples),
        "integrator": {
            "type": "path",
            "max_depth": scene.sampling.depth + 1,
            "rr_depth": NO_ROULETTE,
        },
    }
    radiance = scene.ambient.radiance_w_m2_sr
    if radiance > 0:
        entries["ambient"] = {"type": "constant", "radiance": radiance}
    return mi.load_dict(entries)


def geometry(surfaces: Sequence[Part]) -> dict[str, Any]:
    """Mitsuba's dictionary of a scene's surfaces alone; part i is the shape `part_i`."""
    # Without this, a ray that meets an edge exactly, as pixel centres on a symmetric mesh do, slips between the two
    # triangles. It costs 7 % of a trace at most.
    entries: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    bsdfs = {material: _bsdf(material) for material in {s.material: None for s in surfaces}}
    for index, surface in enumerate(surfaces):
        name = f"part_{index}"
        entries[name] = _mesh(name, surface.mesh, bsdfs[surface.material], surface.smooth)
    return entries


def _mesh(name: str, mesh: trimesh.Trimesh, bsdf: Any, smooth: bool) -> Any:
    props = mi.Properties()
    props["bsdf"] = bsdf
    props["face_normals"] = not smooth
    shape = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), props, has_vertex_normals=smooth)
    params = mi.traverse(shape)
    params["vertex_positions"] = mi.Float32(np.asarray(mesh.vertices, dtype=np.float32).ravel())
    params["faces"] = mi.UInt32(np.asarray(mesh.faces, dtype=np.uint32).ravel())
    if smooth:
        normals = vertex_normals(mesh.vertices, mesh.faces)
        params["vertex_normals"] = mi.Float32(normals.astype(np.float32).ravel())
    params.update()
    return shape


def _bsdf(material: Material) -> Any:
    if isinstance(material, Dielectric):
        # Its two sides differ: outside is air.
        return mi.load_dict(_one_sided(material))
    # Two-sided, because users' meshes are open or wound the other way.
    return mi.load_dict({"type": "twosided", "surface": _one_sided(material)})


def _one_sided(material: Material) -> dict[str, Any]:
    match material:
        case Diffuse(reflectance=reflectance):
            return {"type": "diffuse", "reflectance": reflectance}
        case Glossy(reflectance=reflectance, ior=ior, roughness=roughness):
            return {
                "type": "roughplastic",
                "distribution": "ggx",
                "diffuse_reflectance": reflectance,
                "int_ior": ior,
                "ext_ior": 1.0,
                "alpha": roughness,
            }
        case Conductor(eta=eta, k=k, roughness=0):
            return {"type": "conductor", "eta": eta, "k": k}
        case Conductor(eta=eta, k=k, roughness=roughness):
            return {
                "type": "roughconductor",
                "distribution": "ggx",
                "eta": eta,
                "k": k,
                "alpha": roughness,
            }
        case Dielectric(ior=ior, roughness=roughness):
            return {
                "type": "roughdielectric",
                "distribution": "ggx",
                "int_ior": ior,
                "ext_ior": 1.0,
                "alpha": roughness,
            }
