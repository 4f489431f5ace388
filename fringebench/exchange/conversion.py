"""Conversion to the formats of other programs: point clouds, meshes, height images, and scenes as glTF."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from trimesh.visual.material import PBRMaterial

import decode
import scenes
from evaluation import write_cloud
from evaluation.output.cloud import normals, triangles
from evaluation.output.height_image import write_height_image
from scenes.files.exr import kind_of
from scenes.shapes.materials import Conductor, Dielectric, Diffuse, Glossy, Material, Printed
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, ScoreError

IMAGES = (".png", ".tif", ".tiff")
MESHES = (".ply", ".obj", ".glb")
SCENES = (".glb", ".obj", ".ply", ".stl")
M_PER_MM = 1e-3
# glTF is in metres with y up and cameras looking along -z; scenes are in mm with z up.
TO_GLTF = np.array(
    [
        [M_PER_MM, 0.0, 0.0, 0.0],
        [0.0, 0.0, M_PER_MM, 0.0],
        [0.0, -M_PER_MM, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


def convert(
    source: str | Path,
    output: str | Path,
    truth: str | Path | None = None,
    points: bool = False,
    overrides: Mapping[str, Any] | None = None,
) -> str:
    """Write a reconstruction, truth or scene in the format of the suffix of `output`; returns a description.

    Reconstruction or truth (EXR): ``.png .tif .tiff`` heights in 16 bits (`write_height_image`), ``.ply`` mesh, or with
    `points` the cloud, ``.obj .glb`` mesh. `truth` adds the error to a PLY. Scene (name or TOML): ``.glb .obj .ply .stl``.
    Raises `FringebenchError`.
    """
    suffix = Path(output).suffix.lower()
    if Path(source).suffix.lower() != ".exr":
        if truth is not None or points:
            raise FileError(f"'{source}' is a scene: --truth and --points are for a reconstruction")
        _known(output, SCENES, "a scene")
        return _scene(scenes.load(str(source), overrides), output)
    kind = kind_of(source)
    if kind == "stack":
        raise FileError(f"'{source}' is a stack: write its frames with 'fringebench export'")
    if kind not in ("reconstruction", "truth"):
        raise FileError(
            f"'{source}' is a {kind} file: convert takes a reconstruction, a truth or a scene"
        )
    _known(output, IMAGES + MESHES, f"a {kind}")
    if suffix != ".ply" and (points or truth is not None):
        raise FileError(f"'{output}': --truth and --points are for a .ply")
    rec = decode.Reconstruction.read(source) if kind == "reconstruction" else _true(source)
    if suffix in IMAGES:
        code = write_height_image(output, np.where(rec.valid, rec.height_mm, np.nan))
        return f"16 bits, {code}"
    true = None if truth is None else scenes.Truth.read(truth)
    if suffix == ".ply":
        write_cloud(output, rec, true, faces=not points)
        return f"{int(rec.valid.sum())} points" + ("" if points else " with triangles")
    return _mesh(rec, output)


def _known(output: str | Path, suffixes: tuple[str, ...], what: str) -> None:
    if Path(output).suffix.lower() not in suffixes:
        raise FileError(f"'{output}': {what} is written as {' '.join(suffixes)}")


def _true(path: str | Path) -> decode.Reconstruction:
    truth = scenes.Truth.read(path)
    calibration = scenes.parse(truth.scene, where=str(path)).calibration()
    return decode.Reconstruction.of_heights(truth.height_mm, calibration=calibration)


def _mesh(rec: decode.Reconstruction, output: str | Path) -> str:
    valid = rec.valid & np.isfinite(rec.xyz_mm).all(axis=-1)
    if not valid.any():
        raise ScoreError("no pixel is valid, so there is no mesh to write: see the reasons")
    # Points without a triangle are left out.
    used, corners = np.unique(triangles(rec), return_inverse=True)
    mesh = trimesh.Trimesh(
        rec.xyz_mm[valid][used],
        corners.reshape(-1, 3),
        vertex_normals=normals(rec.xyz_mm, valid)[valid][used],
        process=False,
    )
    _write(trimesh.Scene({"surface": mesh}), output)
    return f"{len(mesh.vertices)} points, {len(mesh.faces)} triangles"


def _scene(scene: scenes.Scene, output: str | Path) -> str:
    drawn = trimesh.Scene()
    for i, part in enumerate(scenes.parts(scene)):
        mesh = part.mesh.copy()
        mesh.visual = trimesh.visual.TextureVisuals(material=_look(part.material))
        drawn.add_geometry(mesh, node_name=f"{i}-{part.label}", geom_name=f"{i}-{part.label}")
    _write(drawn, output)
    return f"{len(drawn.geometry)} objects, {sum(len(m.faces) for m in drawn.geometry.values())} triangles"


def _write(drawn: trimesh.Scene, output: str | Path) -> None:
    suffix = Path(output).suffix.lower().removeprefix(".")
    with replacing(output) as temporary:
        if suffix == "glb":
            drawn.apply_transform(TO_GLTF)
            temporary.write_bytes(drawn.export(file_type="glb"))
        else:
            whole: Any = drawn.to_mesh().export(file_type=suffix)
            temporary.write_bytes(whole.encode() if isinstance(whole, str) else whole)


def _look(material: Material) -> PBRMaterial:
    """A glTF material: gray, since materials are known at one wavelength only."""
    looks: dict[type[Any], Callable[[Any], tuple[float, float, float, float]]] = {
        Diffuse: lambda m: (m.reflectance, 1.0, 0.0, 1.0),
        Printed: lambda m: ((m.dark + m.bright) / 2.0, 1.0, 0.0, 1.0),
        Glossy: lambda m: (m.reflectance, m.roughness, 0.0, 1.0),
        Conductor: lambda m: (_mirror(m.eta, m.k), m.roughness, 1.0, 1.0),
        Dielectric: lambda m: (1.0, m.roughness, 0.0, 0.3),
    }
    gray, roughness, metallic, alpha = looks[type(material)](material)
    return PBRMaterial(
        baseColorFactor=[gray, gray, gray, alpha],
        # glTF's roughness is the square root of GGX's.
        roughnessFactor=roughness**0.5,
        metallicFactor=metallic,
        alphaMode="BLEND" if alpha < 1.0 else "OPAQUE",
        doubleSided=True,
    )


def _mirror(eta: float, k: float) -> float:
    """Fresnel reflectance of a metal at normal incidence."""
    return ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)
