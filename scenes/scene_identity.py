"""What a scene's truth depends on, as digests: files of one scene and rig have the same ones."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from scenes.board.gerber.gerber_board import GerberBoard
from scenes.rig.devices import RigDevice
from scenes.rig.projectors import Emission
from scenes.scene import Object, Scene

PARTS = ("camera", "second_camera", "projectors", "objects", "board", "materials")
# Of a device: what changes its light, and neither its rays nor its pixels.
LIGHT = {
    "vignetting", "evenness", "illumination_map", "lens", "irradiance_w_m2", "reference_mm", "radiance_w_m2_sr", "falloff",
    *Emission.model_fields,
}  # fmt: skip
# Hexadecimal digits of SHA-256 that are kept: two of a million scenes share them with a chance of 3 in 10^8.
DIGITS = 16


def identity(scene: Scene) -> dict[str, str]:
    """Digests of the parts of a scene that its truth depends on, with the contents of the files they name.

    Patterns, sensor, exposures, light paths, and the brightness and tone of devices do not count: one truth is valid for all of them.

    Parameters
    ----------
    scene
        The scene; its mesh and board files are read.

    Returns
    -------
    dict of str to str
        ``camera second_camera projectors objects board materials`` -> 16 hexadecimal digits.

    Examples
    --------
    >>> import scenes
    >>> one, bright, tilted = (
    ...     identity(scenes.load("step", overrides))
    ...     for overrides in ({}, {"projectors.0.gamma": 2.2}, {"objects.0.rotation_deg": [1, 0, 0]})
    ... )
    >>> one == bright, [part for part in one if one[part] != tilted[part]]
    (True, ['objects'])
    """
    found = {part: getattr(scene, part) for part in PARTS}
    found["materials"] = scene.materials, [item.material for item in scene.objects]
    return {part: _digest(json.dumps(_plain(value)).encode()) for part, value in found.items()}


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGITS]


def _plain(value: Any) -> Any:
    """Values in JSON's types."""
    if isinstance(value, BaseModel):
        return _model(value)
    if isinstance(value, Mapping):
        return sorted((str(key), _plain(item)) for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, Path):
        return _digest(value.read_bytes()) if value.is_file() else str(value)
    # Minus zero is zero.
    return value + 0.0 if isinstance(value, float) else value


def _model(model: BaseModel) -> list[Any]:
    """Kind and fields; files by their contents."""
    if isinstance(model, GerberBoard):
        layers = {role: _plain(path) for role, path in model.layer_paths().items()}
        drilled = [_plain(path) for path in model.drill_paths()]
        return [layers, *([drilled] if drilled else []), _fields(model, {"folder", "files"})]
    omitted = (
        LIGHT
        if isinstance(model, RigDevice)
        else {"material"}
        if isinstance(model, Object)
        else set()
    )
    return [type(model).__name__, _fields(model, omitted)]


def _fields(model: BaseModel, omitted: set[str]) -> list[Any]:
    """Names and values of a model's fields that are not at their default, since later versions may have more fields."""
    kept = type(model).model_fields.items()
    values = ((name, getattr(model, name), field) for name, field in kept if name not in omitted)
    return sorted(
        (name, _plain(value))
        for name, value, field in values
        if value != field.get_default(call_default_factory=True)
    )
