"""What stands before the camera, and the files everyone shares. Pure data; knows no renderer."""

from scenes.basis import Basis, Channel, basis
from scenes.board_labels import BoardTruth, PadTruth, board_truth
from scenes.calibration import Calibration
from scenes.coco import coco
from scenes.load import dumps, load, parse, save, schema, shipped, source
from scenes.meshes import Part, meshes, parts
from scenes.patterns import Frame, GrayBits, GrayCode, PhaseShift
from scenes.realise import realise
from scenes.rig import Projection
from scenes.scene import Exposures, Object, Scene
from scenes.sensor import Emva, Sensor, SimpleSensor
from scenes.stack import Stack
from scenes.truth import Truth

__all__ = [
    "Basis",
    "BoardTruth",
    "Calibration",
    "Channel",
    "Emva",
    "Exposures",
    "Frame",
    "GrayBits",
    "GrayCode",
    "Object",
    "PadTruth",
    "Part",
    "PhaseShift",
    "Projection",
    "Scene",
    "Sensor",
    "SimpleSensor",
    "Stack",
    "Truth",
    "basis",
    "board_truth",
    "coco",
    "dumps",
    "load",
    "meshes",
    "parse",
    "parts",
    "realise",
    "save",
    "schema",
    "shipped",
    "source",
]
