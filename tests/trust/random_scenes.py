"""Random scenes: meshes, materials, rigs, lenses, projectors and patterns."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from scenes import Scene
from tests.render import rigs

Entries = dict[str, Any]
Rng = np.random.Generator

RESOLUTION = (32, 24)


def random_scene(rng: Rng, folder: Path) -> Scene:
    """One scene within 60 mm; its meshes are written to `folder`."""
    materials = {f"m{i}": _material(rng) for i in range(4)}
    objects: list[Entries] = [
        {
            "label": "base",
            "material": "m0",
            "rotation_deg": tuple(rng.uniform(-8.0, 8.0, 3)),
            "shape": {"kind": "plate", "size_mm": (200.0, 160.0)},
        }
    ]
    # The plate returns light, so that bodies on it have something to mirror.
    materials["m0"] = {"kind": "diffuse", "reflectance": float(rng.uniform(0.2, 0.95))}
    for i in range(int(rng.integers(3, 7))):
        path = folder / f"mesh-{i}.ply"
        _mesh(rng).export(path)
        objects.append(
            {
                "label": f"o{i}",
                "material": f"m{rng.integers(1, 4)}",
                "smooth": bool(rng.random() < 0.3),
                "position_mm": (*rng.uniform((-22.0, -16.0), (22.0, 16.0)), rng.uniform(0.0, 8.0)),
                "rotation_deg": tuple(rng.uniform(-180.0, 180.0, 3)),
                "shape": {"kind": "file", "path": str(path)},
            }
        )
    projectors = [_projector(rng) for _ in range(1 + int(rng.random() < 0.3))]
    return Scene.model_validate(
        {
            "camera": _device(rng, RESOLUTION, rng.uniform(-30.0, 30.0, 2)),
            "projectors": projectors,
            "objects": objects,
            "materials": materials,
            "ambient": {"radiance_w_m2_sr": float(rng.choice([0.0, rng.uniform(0.5, 20.0)]))},
            "patterns": _patterns(rng),
            "exposures": {"times_ms": (1.0,)},
            "sampling": {"samples": 64, "depth": int(rng.integers(1, 7))},
            "height_range_mm": (-10.0, 40.0),
        }
    )


def _material(rng: Rng) -> Entries:
    roughness = float(rng.uniform(0.15, 0.6))
    return [
        {"kind": "diffuse", "reflectance": float(rng.uniform(0.02, 1.0))},
        {
            "kind": "glossy",
            "reflectance": float(rng.uniform(0.0, 0.9)),
            "ior": float(rng.uniform(1.3, 1.8)),
            "roughness": roughness,
        },
        {
            "kind": "conductor",
            "eta": float(rng.uniform(0.2, 2.0)),
            "k": float(rng.uniform(1.0, 6.0)),
            "roughness": float(rng.choice([0.0, roughness], p=[0.2, 0.8])),
        },
        {"kind": "dielectric", "ior": float(rng.uniform(1.2, 1.8)), "roughness": roughness},
    ][rng.integers(4)]


def _mesh(rng: Rng) -> trimesh.Trimesh:
    """A closed body of 3 to 9 mm: a lump, a torus, the hull of some points, or a prism."""
    size = rng.uniform(3.0, 9.0)
    kind = rng.integers(4)
    if kind == 0:
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=size)
        bumps = rng.normal(size=(3, 3)) / size
        mesh.vertices *= 1.0 + 0.2 * np.sin(mesh.vertices @ bumps * 2.0).mean(axis=1)[:, None]
    elif kind == 1:
        mesh = trimesh.creation.torus(
            size, size * rng.uniform(0.2, 0.6), major_sections=48, minor_sections=24
        )
    elif kind == 2:
        mesh = trimesh.convex.convex_hull(rng.uniform(-size, size, (20, 3)))
    else:
        mesh = trimesh.creation.cylinder(size / 2.0, rng.uniform(4.0, 12.0), sections=7)
    return mesh


def _device(
    rng: Rng, resolution: tuple[int, int], place_mm: np.ndarray, field_mm: float = 60.0
) -> Entries:
    pose = {
        "origin_mm": (*(float(x) for x in place_mm), 200.0),
        "target_mm": (*rng.uniform(-4.0, 4.0, 2), 0.0),
    }
    far = float(np.hypot(200.0, np.linalg.norm(place_mm)))
    if rng.random() < 0.4:
        device = rigs.telecentric(resolution, field_mm)
        if rng.random() < 0.5:
            device["lens"] = {
                "numerical_aperture": float(rng.uniform(0.01, 0.1)),
                "focus_mm": float(far + rng.uniform(-15.0, 15.0)),
            }
    else:
        device = rigs.pinhole(resolution, field_mm, height_mm=far)
        device["cx_px"] += float(rng.uniform(-1.0, 1.0))
        if rng.random() < 0.5:
            strength = rng.uniform(-1.0, 1.0)
            device["distortion"] = tuple(float(strength * d) for d in rigs.DISTORTION)
        if rng.random() < 0.5:
            device["lens"] = {
                "aperture_mm": float(rng.uniform(1.0, 20.0)),
                "focus_mm": float(far + rng.uniform(-15.0, 15.0)),
            }
    return device | {"pose": pose}


def _projector(rng: Rng) -> Entries:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    place = rng.uniform(60.0, 120.0) * np.array([np.cos(angle), np.sin(angle)])
    device = _device(rng, (128, 96), place, field_mm=float(rng.uniform(50.0, 90.0)))
    if device["model"] == "pinhole":
        device["reference_mm"] = float(rng.uniform(150.0, 300.0))
    device["irradiance_w_m2"] = float(rng.uniform(20.0, 200.0))
    device["contrast"] = float(rng.uniform(0.5, 1.0))
    if rng.random() < 0.3:
        device |= {"gamma": float(rng.uniform(0.6, 2.4)), "bits": 8}
    return device


def _patterns(rng: Rng) -> Entries:
    if rng.random() < 0.2:
        return {"kind": "gray-code", "bits": (5,), "cell_px": 4.0}
    periods = np.sort(rng.choice([7.0, 16.0, 40.0, 128.0], int(rng.integers(1, 4)), replace=False))
    axes = [("column",), ("row",), ("column", "row")][rng.integers(3)]
    return {
        "kind": "phase-shift",
        "periods_px": tuple(float(p) for p in periods),
        "steps": int(rng.integers(3, 7)),
        "axes": axes,
        "amplitude": float(rng.uniform(0.5, 1.0)),
    }
