"""Scenes as data, and the files that all rooms share; knows no renderer.

A scene comes from a shipped name or a TOML file (`load`), or is built in Python from the parts below.

Examples
--------
>>> import scenes
>>> small = scenes.Scene(
...     camera=scenes.Telecentric(
...         resolution=(64, 48), field_width_mm=16.0, pose=scenes.LookAt(origin_mm=(0, 0, 200))
...     ),
...     projectors=(
...         scenes.PinholeProjector(
...             resolution=(640, 480),
...             fx_px=1500.0,
...             fy_px=1500.0,
...             cx_px=320.0,
...             cy_px=240.0,
...             reference_mm=150.0,
...             pose=scenes.LookAt(origin_mm=(-70, 0, 130)),
...         ),
...     ),
...     objects=(
...         scenes.Object(label="base", shape=scenes.Plate(size_mm=(20, 15)), material="white-paint"),
...         scenes.Object(
...             label="step",
...             shape=scenes.Box(size_mm=(4, 4, 1)),
...             material="mine",
...         ),
...     ),
...     materials={"mine": scenes.Diffuse(reflectance=0.4)},
...     patterns=scenes.PhaseShift(steps=4, periods_px=(16.0, 128.0)),
...     sensor=scenes.Emva(bits=10),
...     exposures=scenes.Exposures(times_ms=(2.0, 8.0)),
...     height_range_mm=(-1.0, 2.0),
... )
>>> scenes.parse(scenes.dumps(small)) == small
True
"""

from scenes.support.memory import require_address_space

# Before the libraries are loaded, which end the process without a word.
require_address_space()

from scenes.acquisition.pattern_basis import Basis, Channel, basis
from scenes.acquisition.patterns import (
    EvenLight,
    Frame,
    GrayBits,
    GrayCode,
    ModulatedPhaseShift,
    PatternSeries,
    PhaseShift,
    RandomDots,
    UnevenSteps,
)
from scenes.acquisition.sensor import Emva, Sensor, SimpleSensor
from scenes.board import gerber
from scenes.board.board import ParametricBoard
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.files.capture import Capture
from scenes.files.stack import Stack
from scenes.files.truth_maps import Truth
from scenes.labels.coco_format import coco
from scenes.labels.pad_truth import BoardTruth, PadTruth, board_truth
from scenes.randomise import realise
from scenes.rig.calibration import Calibration
from scenes.rig.devices import (
    Extrinsics,
    LookAt,
    Pinhole,
    PinholeLens,
    Telecentric,
    TelecentricLens,
)
from scenes.rig.illumination_map import IlluminationMap
from scenes.rig.projection import Projection
from scenes.rig.projectors import PinholeProjector, Screen, TelecentricProjector
from scenes.scene import Ambient, AutoExposure, Exposures, Object, Sampling, Scene
from scenes.scene_files import dumps, load, parse, save, schema, shipped, source
from scenes.scene_meshes import Part, meshes, parts
from scenes.shapes.grains import Grains
from scenes.shapes.materials import Conductor, Dielectric, Diffuse, Glossy, Printed
from scenes.shapes.solids import Box, Cap, Disk, Hole, MeshFile, Plate, Tiles
from scenes.support.distribution import (
    Choice,
    Constant,
    LogNormal,
    Normal,
    TruncatedNormal,
    Uniform,
)
from scenes.support.errors import (
    BackendError,
    DatasetError,
    DecodeError,
    FileError,
    FringebenchError,
    FringebenchWarning,
    ImpossibleError,
    MeshError,
    OutsideDecoderError,
    RenderError,
    SceneError,
    ScoreError,
    TooLargeError,
)

__all__ = [
    "Ambient", "AutoExposure", "BackendError", "Basis", "BoardTruth", "Box", "Calibration", "Cap",
    "Capture", "Channel", "Choice", "Conductor", "Constant", "DatasetError", "DecodeError",
    "Dielectric", "Diffuse", "Disk", "Emva", "EvenLight", "Exposures", "Extrinsics", "FileError",
    "Frame", "FringebenchError", "FringebenchWarning", "GerberBoard", "Glossy", "Grains",
    "GrayBits", "GrayCode", "Hole", "IlluminationMap", "ImpossibleError", "LogNormal", "LookAt", "MeshError",
    "MeshFile", "ModulatedPhaseShift", "Normal", "Object", "OutsideDecoderError", "PadTruth", "ParametricBoard", "Part", "PatternSeries", "PhaseShift", "Pinhole",
    "PinholeLens", "PinholeProjector", "Plate", "Printed", "Projection", "RandomDots", "RenderError", "Sampling", "Scene",
    "SceneError", "ScoreError", "Screen", "Sensor", "SimpleSensor", "Stack", "Telecentric", "TelecentricLens",
    "TelecentricProjector", "Tiles", "TooLargeError", "TruncatedNormal", "Truth", "UnevenSteps", "Uniform",
    "basis", "board_truth", "coco", "dumps", "gerber", "load", "meshes", "parse", "parts",
    "realise", "save", "schema", "shipped", "source",
]  # fmt: skip
