"""Whether a reconstruction and a truth belong together: the same scene and rig, the same unit."""

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode import Reconstruction
from scenes.files.truth_maps import Truth
from scenes.support.errors import ScoreError
from scenes.support.safe_parse import parse_toml

# Parts of a scene that the truth depends on; patterns, sensor, exposures and light paths may differ.
PARTS = ("camera", "second_camera", "projectors", "objects", "board", "materials")
# Unit that heights may be in by mistake -> its size in mm.
UNITS_MM = {"metres": 1000.0, "inches": 25.4, "micrometres": 0.001}
# Heights above this share of the highest show the unit; those near zero look the same in every unit.
HIGH = 0.25
MINIMUM_PIXELS = 30
UNIT_TOLERANCE = 0.1


def differing_parts(rec: Reconstruction, truth: Truth) -> tuple[str, ...]:
    """Some of ``camera projectors objects board materials`` in which the scenes of both differ; empty also if one does
    not know its scene.
    """
    if not rec.scene or not truth.scene or rec.scene == truth.scene:
        return ()
    measured, true = _tree(rec.scene, "reconstruction"), _tree(truth.scene, "truth")
    return tuple(part for part in PARTS if _text(measured, part) != _text(true, part))


def other_unit(measured_mm: NDArray[np.floating], true_mm: NDArray[np.floating]) -> str:
    """``metres``, ``inches`` or ``micrometres`` if the extent says that heights (row, col) are in it by mistake, else
    empty.

    >>> true = np.linspace(0.0, 5.0, 100).reshape(10, 10)
    >>> other_unit(true / 1000.0, true)
    'metres'
    """
    known = np.isfinite(measured_mm) & np.isfinite(true_mm)
    if not known.any():
        return ""
    high = known & (np.abs(true_mm) > HIGH * np.abs(true_mm[known]).max())
    if int(high.sum()) < MINIMUM_PIXELS:
        return ""
    ratio = float(np.median(measured_mm[high].astype(np.float64) / true_mm[high]))
    for unit, size_mm in UNITS_MM.items():
        if abs(ratio * size_mm - 1.0) < UNIT_TOLERANCE:
            return unit
    return ""


def _tree(text: str, whose: str) -> dict[str, Any]:
    """The tables of a scene."""
    try:
        return parse_toml(text)
    except ValueError as error:
        raise ScoreError(
            f"the {whose}'s scene is not valid TOML ({error}): make the file again from its scene"
        ) from error


def _text(tree: dict[str, Any], part: str) -> str:
    """A part of a scene as text; 1 and 1.0 are one number."""
    return json.dumps(_numbers(tree.get(part)), sort_keys=True, default=str)


def _numbers(value: Any) -> Any:
    """Whole numbers as floats, everywhere in a tree."""
    if isinstance(value, dict):
        return {key: _numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_numbers(item) for item in value]
    return float(value) if type(value) is int else value
