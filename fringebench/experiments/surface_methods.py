"""The map of methods: which way of measuring fails on which surface, by how much, and why.

All methods look at the same object with the same camera, at three exposures. Every pixel of the object that the camera sees counts, in
shadow or not.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import render
import scenes
from fringebench.progress import Steps
from scenes.support.errors import DecodeError, ScoreError, nearest

# Light and rig of each method, as overrides of the scene `mirror-deflectometry`, which is the last one.
_LAMP: Mapping[str, Any] = {
    "model": "pinhole", "resolution": [1024, 768], "fx_px": 6600.0, "fy_px": 6600.0, "cx_px": 512.0, "cy_px": 384.0,
    "reference_mm": 300.0, "pose": {"origin_mm": [-150.0, 0.0, 260.0]},
}  # fmt: skip
_SECOND: Mapping[str, Any] = {
    "model": "pinhole", "calibrated_at": [640, 480], "fx_px": 4800.0, "fy_px": 4800.0, "cx_px": 320.0, "cy_px": 240.0,
    "pose": {"origin_mm": [-25.0, 0.0, 300.0]},
}  # fmt: skip
_FRINGES = {"kind": "phase-shift", "periods_px": [32.0, 256.0, 1024.0]}
_ON_SCREEN = {"kind": "phase-shift", "periods_px": [32.0, 256.0, 1280.0], "axes": ["column", "row"]}
_DOTS, _EVEN = {"kind": "random-dots"}, {"kind": "even"}
METHODS: Mapping[str, Mapping[str, Any]] = {
    "fringe-projection": {"projectors": [_LAMP], "patterns": _FRINGES},
    "phase-stereo": {"projectors": [_LAMP], "patterns": _FRINGES, "second_camera": _SECOND},
    "active-stereo": {"projectors": [_LAMP], "patterns": _DOTS, "second_camera": _SECOND},
    "passive-stereo": {"projectors": [_LAMP], "patterns": _EVEN, "second_camera": _SECOND},
    "deflectometry": {"patterns": _ON_SCREEN},
}
_CAP = {"kind": "cap", "radius_mm": 6.0, "height_mm": 2.5}
_DOME = {"kind": "cap", "profile": "spherical", "radius_mm": 6.0, "height_mm": 1.6, "rings": 64, "segments": 128}  # fmt: skip
_GRAINS = {"kind": "grains", "powder": 3, "size_mm": [1.2, 1.2], "height_mm": 0.12, "bed_mm": 0.09}
# Material and shape of each surface's object.
SURFACES: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "matt": ("grey-paint", _CAP),
    "glossy": ("gloss", _CAP),
    "black": ("black-ink", _CAP),
    "translucent": ("resin", {"kind": "box", "size_mm": [14.0, 12.0, 1.0]}),
    "solder": ("solder", _DOME),
    "grains": ("solder", _GRAINS),
    "mirror": ("mirror", {"kind": "box", "size_mm": [14.0, 12.0, 1.0]}),
    "step": ("grey-paint", {"kind": "box", "size_mm": [8.0, 8.0, 1.5]}),
}
# Grains are seen through lenses of so many times the focal length.
ZOOM = 8.0
# Side of a random dot in camera pixels.
DOT_CAMERA_PX = 2.5
# Columns of the camera from which fringes are as listed, 4 to 7 camera pixels wide; of half that, pixels and lens leave a mirrored
# screen's fringes a fifth of their contrast.
FRINGE_COLUMNS = 200
# A height off by more than this share of the height range is wrong: 0.3 mm, half a pixel of disparity; 0.04 mm on grains.
WRONG = 0.06
# Share of the pixels above which a cause is named.
NAMED = 0.05


@dataclass(frozen=True)
class Cell:
    """How one method does on one surface; None where nothing is measured."""

    method: str
    surface: str
    pixels: int
    coverage: float
    """Share of the object's pixels with a valid height."""
    wrong: float
    """Share of the object's pixels that are valid but off by more than `WRONG` of the height range."""
    rms_mm: float | None
    median_abs_mm: float | None
    why: str
    """What most pixels fail by, ``wrong`` or the decoder's reason; empty if no cause takes 5 %."""
    why_share: float


@dataclass(frozen=True)
class MethodMap:
    """Every method on every surface."""

    cells: tuple[Cell, ...]
    resolution: tuple[int, int]

    def to_dict(self) -> dict[str, Any]:
        """Plain data, always valid JSON."""
        return {"resolution": self.resolution, "cells": [asdict(cell) for cell in self.cells]}


def method_map(
    methods: Sequence[str] | None,
    surfaces: Sequence[str] | None,
    resolution: tuple[int, int],
    samples: int,
    seed: int,
    steps: Steps,
) -> MethodMap:
    """See `fringebench.methods`."""
    chosen = [_known(methods, METHODS, "method"), _known(surfaces, SURFACES, "surface")]
    pairs = [(method, surface) for method in chosen[0] for surface in chosen[1]]
    cells = []
    with steps.step("methods") as done:
        for number, (method, surface) in enumerate(pairs, 1):
            scene = map_scene(method, surface, resolution, samples)
            cells.append(_measured(scene, method, surface, seed))
            done(number / len(pairs))
    return MethodMap(tuple(cells), resolution)


def map_scene(method: str, surface: str, resolution: tuple[int, int], samples: int) -> scenes.Scene:
    """The scene of one cell; its object is labelled ``object``."""
    material, shape = SURFACES[surface]
    zoom = ZOOM if surface == "grains" else 1.0
    changes = {key: _zoomed(value, zoom) for key, value in METHODS[method].items()}
    base = "white-paint" if surface == "translucent" else "grey-paint"
    bed = {"kind": "box", "size_mm": [1.2, 1.2, 0.09]}
    flux = [{"label": "flux", "material": "flux", "shape": bed}] if surface == "grains" else []
    changes["patterns"] = _seen_by(resolution[0], METHODS[method]["patterns"])
    label = "object" if method == "deflectometry" else "base"
    return scenes.load(
        "mirror-deflectometry",
        changes
        | {
            "name": f"{method} on {surface}",
            "camera.resolution": list(resolution),
            "camera.fx_px": 4800.0 * zoom,
            "camera.fy_px": 4800.0 * zoom,
            "height_range_mm": [-1.0 / zoom, 4.0 / zoom],
            "exposures": {
                "relative": [0.1, 1.0, 8.0],
                "auto": {"label": label, "level_dn": 1400.0},
            },
            "sampling": {"samples": samples, "depth": 6},
            "materials": {"gloss": {"kind": "glossy", "reflectance": 0.4}},
            "objects": [
                {"label": "base", "material": base, "shape": {"kind": "plate", "size_mm": [60.0, 50.0]}},
                *flux,
                {"label": "object", "material": material, "shape": dict(shape), "smooth": material == "solder"},
            ],
        },
    )  # fmt: skip


def _seen_by(columns: int, patterns: Mapping[str, Any]) -> Mapping[str, Any]:
    """Patterns coarse enough for a camera of so many columns."""
    if patterns["kind"] == "random-dots":
        # The projector's pixels are smaller by the ratio of focal lengths; both are 300 mm away.
        dot = DOT_CAMERA_PX * _LAMP["fx_px"] / _SECOND["fx_px"] * 640.0 / columns
        return {**patterns, "dot_px": max(1.0, dot)}
    if "periods_px" not in patterns or columns >= FRINGE_COLUMNS:
        return patterns
    widest = patterns["periods_px"][-1]
    wider = {min(p * FRINGE_COLUMNS / columns, widest) for p in patterns["periods_px"]}
    return {**patterns, "periods_px": sorted(wider)}


def _zoomed(value: Any, zoom: float) -> Any:
    """Projectors or a camera with so many times the focal length."""
    if isinstance(value, list):
        return [_zoomed(item, zoom) for item in value]
    focal = {key: value[key] * zoom for key in ("fx_px", "fy_px") if key in value}
    return {**value, **focal}


def _measured(scene: scenes.Scene, method: str, surface: str, seed: int) -> Cell:
    surfaces = render.surfaces(scene)
    light = render.trace(scene, seed=seed, surfaces=surfaces)
    truth = render.truth(scene, light, surfaces)
    region = truth.region("object")
    try:
        rec = decode.reconstruct(render.expose(light, seed=seed))
    except DecodeError as error:
        # It names the reasons and their shares.
        shares = {name: float(s) for name, s in re.findall(r"([a-z-]+) ([\d.]+)%", str(error))}
        why = max(shares, key=shares.__getitem__) if shares else "nothing decoded"
        return Cell(method, surface, int(region.sum()), 0.0, 0.0, None, None, why, 1.0)
    low, high = scene.height_range_mm
    return judged(method, surface, rec, truth.height_mm, region, WRONG * (high - low))


def judged(
    method: str,
    surface: str,
    rec: decode.Reconstruction,
    true_mm: NDArray[np.floating],
    region: NDArray[np.bool_],
    limit_mm: float,
) -> Cell:
    """How heights compare with the true ones in a region (row, col); wrong is what is off by more than the limit."""
    pixels = int(region.sum())
    error_mm = np.abs(rec.height_mm - true_mm)[region & rec.valid].astype(np.float64)
    wrong = float((error_mm > limit_mm).sum() / pixels)
    causes = {"wrong": wrong} | {
        reason.label: float((rec.reason[region] == reason).mean())
        for reason in decode.Reason
        if reason is not decode.Reason.OK
    }
    why = max(causes, key=causes.__getitem__)
    named = causes[why] >= NAMED
    return Cell(
        method,
        surface,
        pixels,
        float(error_mm.size / pixels),
        wrong,
        float(np.sqrt(np.mean(error_mm**2))) if error_mm.size else None,
        float(np.median(error_mm)) if error_mm.size else None,
        why if named else "",
        causes[why] if named else 0.0,
    )


def _known(names: Sequence[str] | None, known: Mapping[str, Any], what: str) -> list[str]:
    """The names given, each of them known; all of them for None."""
    for name in names or ():
        if name not in known:
            raise ScoreError(f"unknown {what} '{name}': {nearest(name, known)}")
    return list(known if names is None else dict.fromkeys(names))
