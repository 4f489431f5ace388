"""A scene as an ordinary Mitsuba scene: geometry for the tracer; with lights and camera, for Mitsuba's own `path`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from render.plugins.camera_sensor import camera_plugin
from render.plugins.projector_emitter import projector_plugin
from render.plugins.screen_light import screen_shape
from render.plugins.shading_normals import vertex_normals
from render.plugins.variant import mi, use
from scenes.acquisition.pattern_basis import basis
from scenes.rig.projectors import Screen
from scenes.scene import Scene
from scenes.scene_meshes import Part, parts
from scenes.shapes.materials import Conductor, Dielectric, Diffuse, Glossy, Material, Printed
from scenes.support.errors import RenderError

# Mitsuba starts Russian roulette at this depth; paths here end only at the scene's depth.
NO_ROULETTE = 1_000_000
# Grains of a print before it repeats itself, along each side.
PRINT_GRAINS = 512


def mitsuba_scene(scene: Scene, frame: int = 0, projector: int = 0) -> Any:
    """The scene as an `mi.Scene` in which one projector shows one frame, with the ambient light.

    Parameters
    ----------
    scene
        The scene.
    frame
        Number of the pattern, from 0, among those of one projector.
    projector
        Number of the projector, from 0.

    Returns
    -------
    mi.Scene
        With Mitsuba's `path` integrator at the scene's depth: ``mi.render(it, spp=..., seed=...)`` estimates the
        radiance (row, col, 1) in W/(m^2 sr) that ``trace(scene).frames(projector)[frame]`` has.

    Raises
    ------
    RenderError
        For a frame or a projector that the scene does not have.
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
    emitted = basis(scene.patterns, light, light.resolution)
    if isinstance(light, Screen):
        shown = screen_shape(light, emitted, frame)
    else:
        shown = projector_plugin(light, emitted, frame)
    entries = geometry(parts(scene)) | {
        "projector": shown,
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
    # Without this, a ray that meets an edge exactly, as at pixel centres on a symmetric mesh, passes between the two
    # triangles. It costs up to 7 % of a trace.
    entries: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    bsdfs = {material: _bsdf(material) for material in {s.material: None for s in surfaces}}
    for index, surface in enumerate(surfaces):
        name = f"part_{index}"
        entries[name] = _mesh(name, surface, bsdfs[surface.material])
    return entries


def _mesh(name: str, surface: Part, bsdf: Any) -> Any:
    mesh, smooth = surface.mesh, surface.smooth
    material = surface.material
    props = mi.Properties()
    props["bsdf"] = bsdf
    props["face_normals"] = not smooth
    counts = len(mesh.vertices), len(mesh.faces)
    printed = isinstance(material, Printed)
    shape = mi.Mesh(name, *counts, props, has_vertex_normals=smooth, has_vertex_texcoords=printed)
    params = mi.traverse(shape)
    params["vertex_positions"] = mi.Float32(np.asarray(mesh.vertices, dtype=np.float32).ravel())
    params["faces"] = mi.UInt32(np.asarray(mesh.faces, dtype=np.uint32).ravel())
    if smooth:
        normals = vertex_normals(mesh.vertices, mesh.faces)
        params["vertex_normals"] = mi.Float32(normals.astype(np.float32).ravel())
    if isinstance(material, Printed):
        at = np.asarray(mesh.vertices)[:, :2] / (material.grain_mm * PRINT_GRAINS)
        params["vertex_texcoords"] = mi.Float32(at.astype(np.float32).ravel())
    params.update()
    return shape


def _bsdf(material: Material) -> Any:
    if isinstance(material, Dielectric):
        # Its two sides differ: the outside is air.
        return mi.load_dict(_one_sided(material))
    # Two-sided, because users' meshes may be open or have inverted winding.
    return mi.load_dict({"type": "twosided", "surface": _one_sided(material)})


def _one_sided(material: Material) -> dict[str, Any]:
    match material:
        case Diffuse(reflectance=reflectance):
            return {"type": "diffuse", "reflectance": reflectance}
        case Printed(dark=dark, bright=bright, seed=seed):
            drawn = np.random.Generator(np.random.PCG64(seed)).random((PRINT_GRAINS, PRINT_GRAINS))
            grains = np.where(drawn < 0.5, dark, bright).astype(np.float32)[..., None]
            texture = {"type": "bitmap", "data": mi.TensorXf(grains), "raw": True}
            texture |= {"filter_type": "nearest", "wrap_mode": "repeat"}
            return {"type": "diffuse", "reflectance": texture}
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
