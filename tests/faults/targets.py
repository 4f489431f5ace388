"""Readers of files, each with small undamaged files: shared by the tests and by `fuzz_readers.py`."""

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import trimesh

import decode
import evaluation
import render
import scenes
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.manifest import Manifest
from fringebench.datasets.sample import FileSum, Record
from fringebench.gate.baseline import Baseline
from scenes.board import gerber
from scenes.files import exr
from scenes.files.capture import Capture
from scenes.rig.opencv_calibration import Source

Read = Callable[[Path], object]

SMALL = {
    "camera.resolution": [12, 9],
    "patterns.periods_px": [16.0],
    "exposures.relative": [1.0, 3.0],
}
DRILL = """\
M48
; #@! TF.FileFunction,MixedPlating,1,2
METRIC,TZ,000.000
;TYPE=PLATED
T1C0.300
;TYPE=NON_PLATED
T2C1.100
%
G90
G05
T1
X1500Y-2250
R3X500
X9000Y1000G85X9500Y1500
T2
G00X1.0Y1.0
M15
G01X3.0
G02X4.0Y2.0A1.0
M16
G05
M30
"""
GERBER = """\
G04 #@! TF.FileFunction,Paste,Top*
%FSLAX46Y46*%
%MOMM*%
%AMRoundRect*
21,1,$1,$2,0,0,$3*
1,1,0.2,$1/2,0*%
%ADD10C,0.5*%
%ADD11R,1.2X0.8*%
%ADD12RoundRect,0.9X0.6X30*%
%ADD13O,0.4X1.1*%
%ADD14P,0.8X6X10*%
%LPD*%
G01*
D10*
X1000000Y1000000D03*
D11*
X3000000Y1000000D03*
D12*
X5000000Y1000000D03*
D13*
X7000000Y1000000D03*
D14*
X9000000Y1000000D03*
D10*
X0Y3000000D02*
X2000000Y3000000D01*
G75*
G03*
X4000000Y3000000I1000000J0D01*
G01*
G36*
X5000000Y3000000D02*
X6000000Y3000000D01*
X6000000Y4000000D01*
X5000000Y4000000D01*
X5000000Y3000000D01*
G37*
%LPC*%
D10*
X5500000Y3500000D03*
%LPD*%
X0Y0D02*
X10000000Y0D01*
X10000000Y5000000D01*
X0Y5000000D01*
X0Y0D01*
M02*
"""
MANIFEST = """\
files = ["f*.png"]
projector_resolution = [64, 48]
exposures_ms = [1.0]
bits = 8
frames = [
  {kind = "fringes", axis = "column", period_px = 16.0, steps = 3, first_phase_deg = -120.0, origin_px = 0.5},
  {kind = "gray", axis = "row", bits = 2, cell_px = 12.0, inverse = "after-all"},
  {kind = "white"},
  {kind = "black"},
]

[calibration]
files = ["rig.yml"]
distance_mm = 100.0
"""
RIG: dict[str, Any] = {
    "cam_K": [[80.0, 0, 6.0], [0, 80.0, 4.5], [0, 0, 1]],
    "cam_kc": [[0.01, -0.02, 1e-4, 2e-4, 0.003]],
    "proj_K": [[90.0, 0, 32.0], [0, 90.0, 24.0], [0, 0, 1]],
    "R": [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]],
    "T": [[30.0], [0.0], [2.0]],
    "image_width": 12,
    "image_height": 9,
    "projector_size": [64, 48],
}
FRAMES = 3 + 4 + 2


@dataclass(frozen=True)
class Target:
    """A reader and undamaged files of its format."""

    suffix: str
    read: Read
    seeds: Callable[[], tuple[bytes, ...]]


@cache
def files(make: Callable[[Path], object], suffix: str) -> tuple[bytes, ...]:
    """The bytes that `make` writes to a path with that suffix."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"whole{suffix}"
        make(path)
        return (path.read_bytes(),)


@cache
def transport() -> render.Transport:
    """Transport of the smallest scene that has everything a file may hold."""
    return render.trace(scenes.load("bench", SMALL), samples=2, depth=2)


@cache
def stack() -> scenes.Stack:
    """Its frames."""
    return render.expose(transport(), exposures=[0.5, 2.0])


def _truth(path: Path) -> None:
    render.truth(transport().scene, transport()).write(path)


def _reconstruction(path: Path) -> None:
    decode.reconstruct(stack()).write(path)


def _opencv(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in RIG.items():
        storage.write(name, np.array(value, np.float64) if isinstance(value, list) else value)
    storage.release()


def _json(path: Path) -> None:
    path.write_text(json.dumps(RIG))


def _manifest_folder(path: Path) -> object:
    """Read a manifest next to the images and the calibration it names."""
    images = np.random.default_rng(0).integers(0, 200, (FRAMES, 9, 12), dtype=np.uint8)
    for i, image in enumerate(images):
        name = path.parent / f"f{i}.png"
        if not name.exists():
            cv2.imwrite(str(name), image)
    rig = path.parent / "rig.yml"
    if not rig.exists():
        _opencv(rig)
    capture = Capture.load(path)
    return capture.stack(), capture.patterns


def _scene(path: Path) -> object:
    scene = scenes.load(path)
    return scenes.parse(scenes.dumps(scene)), scene.frames, scene.labels


def _gerber(path: Path) -> object:
    return (
        gerber.read_pads(path),
        gerber.read_area(path, (0.0, 0.0, 10.0, 5.0)),
        gerber.read_outline(path),
    )


def _drill(path: Path) -> object:
    return gerber.read_drills(path), gerber.read_drills(path, mirrored=True)


def _calibration(path: Path) -> object:
    return Source(files=(path,), distance_mm=100.0).calibration((12, 9), (64, 48))


def _mesh(path: Path) -> object:
    """A mesh file as an object of a scene, placed and checked."""
    return scenes.meshes(
        scenes.load(
            "step",
            {"objects.0.shape": {"kind": "file", "path": str(path)}, "objects.0.label": "base"},
        )
    )


def _shape(path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=1).export(path)


def _plan() -> tuple[bytes, ...]:
    return (DatasetPlan.of(transport().scene, 20, 3).dumps().encode(),)


def _parquet() -> tuple[bytes, ...]:
    sums = FileSum(bytes=5, sha256="ab" * 32)
    files = dict.fromkeys(("stack.exr", "truth.exr", "scene.toml", "labels.json"), sums)
    records = (
        Record(index=0, split="train", status="made", files=files),
        Record(index=1, split="test", status="failed", reason="no"),
    )
    return (Manifest(records, {"dataset.toml": sums}).to_bytes(),)


def _baseline() -> tuple[bytes, ...]:
    estimate = {"mean": 0.1, "standard_error": 0.01, "repeats": 4}
    tree = {
        "format": "fringebench-baseline",
        "version": 2,
        "decoder": "a:b",
        "suite": "x",
        "figures": {"case": {"base": {"bias_mm": estimate}}},
    }
    return (json.dumps(tree).encode(),)


def _scene_texts() -> tuple[bytes, ...]:
    own = [scenes.source(name).encode() for name in ("bench", "solder-grains", "spi")]
    return (*own, scenes.dumps(transport().scene).encode())


def _header_of(whole: Callable[[], tuple[bytes, ...]], use: Read) -> Target:
    """A file in which only the header is damaged, and how it is used next."""

    @cache
    def parts() -> tuple[dict[str, Any], str]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "whole.exr"
            path.write_bytes(whole()[0])
            file = OpenEXR.File(str(path), separate_channels=True)
            channels = {name: channel.pixels for name, channel in file.channels().items()}
            return channels, file.header()[exr.ATTRIBUTE]

    def read(path: Path) -> object:
        text = path.read_text(errors="replace").replace("\0", "")
        header = {"type": OpenEXR.scanlineimage, exr.ATTRIBUTE: text}
        OpenEXR.File(header, parts()[0]).write(str(path.with_suffix(".exr")))
        return use(path.with_suffix(".exr"))

    return Target(".json", read, lambda: (parts()[1].encode(),))


def _use_transport(path: Path) -> object:
    light = render.Transport.read(path)
    return light.frames(), render.expose(light, exposures=[1.0])


def _use_truth(path: Path) -> object:
    return evaluation.score(decode.reconstruct(stack()), scenes.Truth.read(path))


def _use_reconstruction(path: Path) -> object:
    rec = decode.Reconstruction.read(path)
    return rec.phase_rad, rec.reason_fractions(), rec.xyz_mm


TARGETS: dict[str, Target] = {
    "transport": Target(".exr", render.Transport.read, lambda: files(transport().write, ".exr")),
    "stack": Target(".exr", scenes.Stack.read, lambda: files(stack().write, ".exr")),
    "truth": Target(".exr", scenes.Truth.read, lambda: files(_truth, ".exr")),
    "reconstruction": Target(
        ".exr", decode.Reconstruction.read, lambda: files(_reconstruction, ".exr")
    ),
    "transport-header": _header_of(lambda: files(transport().write, ".exr"), _use_transport),
    "stack-header": _header_of(
        lambda: files(stack().write, ".exr"), lambda p: decode.reconstruct(scenes.Stack.read(p))
    ),
    "truth-header": _header_of(lambda: files(_truth, ".exr"), _use_truth),
    "reconstruction-header": _header_of(
        lambda: files(_reconstruction, ".exr"), _use_reconstruction
    ),
    "scene": Target(".toml", _scene, _scene_texts),
    "manifest": Target(".toml", _manifest_folder, lambda: (MANIFEST.encode(),)),
    "gerber": Target(".gbr", _gerber, lambda: (GERBER.encode(),)),
    "drill": Target(".drl", _drill, lambda: (DRILL.encode(),)),
    "calibration-yaml": Target(".yml", _calibration, lambda: files(_opencv, ".yml")),
    "calibration-xml": Target(".xml", _calibration, lambda: files(_opencv, ".xml")),
    "calibration-json": Target(".json", _calibration, lambda: files(_json, ".json")),
    "mesh-ply": Target(".ply", _mesh, lambda: files(_shape, ".ply")),
    "mesh-stl": Target(".stl", _mesh, lambda: files(_shape, ".stl")),
    "mesh-obj": Target(".obj", _mesh, lambda: files(_shape, ".obj")),
    "plan": Target(
        ".toml", lambda path: DatasetPlan.loads(path.read_text(errors="replace"), str(path)), _plan
    ),
    "parquet": Target(
        ".parquet", lambda path: Manifest.of_bytes(path.read_bytes(), str(path)), _parquet
    ),
    "baseline": Target(".json", Baseline.read, _baseline),
}
