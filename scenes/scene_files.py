"""Scenes from TOML and back: shipped names, files, overrides, JSON schema."""

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import ValidationError

from scenes.scene import Scene
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, SceneError, nearest
from scenes.support.paths import is_file, is_folder, missing
from scenes.support.safe_parse import parse_toml
from scenes.support.toml_lines import line_of
from scenes.support.validation_words import first_lines, mistakes

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Overrides = Mapping[str, Any]

# Keys of `sampling` that say when to stop tracing.
LIMITS = ("samples", "phase_error_rad", "render_noise")


def shipped() -> tuple[str, ...]:
    """Names of the scenes that come with the project.

    Examples
    --------
    >>> import scenes
    >>> "bench" in scenes.shipped()
    True
    """
    folder = resources.files("scenes") / "shipped_scenes"
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


def source(name: str | Path) -> str:
    """The TOML text of a shipped scene or of a file.

    Raises `SceneError` for an unknown name and `FileError` for a file that is missing or unreadable.
    """
    path = Path(name)
    if str(name) in shipped():
        return (resources.files("scenes") / "shipped_scenes" / f"{name}.toml").read_text("utf-8")
    if not is_file(path):
        if path.suffix == ".toml" or path.parent != Path() or is_folder(path):
            raise FileError(f"scene file '{path}' {missing(path)}: give a TOML file")
        raise SceneError(
            f"unknown scene '{name}', and no TOML file either: {nearest(str(name), shipped())}"
        )
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"scene file '{path}' cannot be read: {error}") from error


def load(name: str | Path, overrides: Overrides | None = None) -> Scene:
    """Load a shipped scene or a TOML file.

    Parameters
    ----------
    name
        Name of a shipped scene, or path of a TOML file.
    overrides
        Dotted key -> value, with the TOML's own keys; numbers are indices into lists.

    Raises
    ------
    SceneError
        An unknown name, key or value; the message names the nearest valid one.
    FileError
        The file is missing or unreadable.

    Examples
    --------
    >>> import scenes
    >>> scenes.load("bench", {"camera.resolution": [320, 240]}).camera.resolution
    (320, 240)
    """
    text = source(name)
    folder = None if str(name) in shipped() else Path(name).resolve().parent
    return parse(text, overrides, where=str(name), folder=folder)


def parse(
    text: str, overrides: Overrides | None = None, where: str = "scene", folder: Path | None = None
) -> Scene:
    """A scene from TOML text, as `dumps` writes it, with overrides as for `load`; raises `SceneError`.

    `where` is what messages call the text; `folder` is what mesh and board paths are relative to, by default the
    current one.
    """
    try:
        tree = parse_toml(text)
    except ValueError as error:
        raise SceneError(f"{where}: not valid TOML: {error}") from error
    if not isinstance(overrides, Mapping | None):
        raise SceneError(
            f"overrides = {overrides!r}: give a dict of dotted keys, e.g. {{'camera.resolution': [320, 240]}}"
        )
    for key, value in (overrides or {}).items():
        _set(tree, key, value)
    _one_limit(tree, overrides or {})
    items = tree.get("objects") if folder else None
    for item in items if isinstance(items, list) else []:
        shape = item.get("shape", {}) if isinstance(item, dict) else {}
        if isinstance(shape, dict) and isinstance(shape.get("path"), str):
            shape["path"] = str(folder / shape["path"])
    projectors = tree.get("projectors")
    devices = [tree.get("camera"), *(projectors if isinstance(projectors, list) else [])]
    for device in devices if folder else []:
        measured = device.get("illumination_map") if isinstance(device, dict) else None
        if isinstance(measured, dict) and isinstance(measured.get("path"), str):
            measured["path"] = str(folder / measured["path"])
    board = tree.get("board") if folder else None
    if isinstance(board, dict):
        _resolve_board(board, folder or Path())
    given = [key.split(".") for key in overrides or {}]
    try:
        scene = Scene.model_validate(tree)
    except ValidationError as error:
        found = mistakes(error, Scene, tree)
        lines = [f"{where}{_line(text, m.location, given)}: {m.message}" for m in found]
        raise SceneError(first_lines(lines)) from None
    wrong = [
        f"{where}{_line(text, ('randomise', key), given)}: randomise: {message}"
        for key, message in _cannot_be_drawn(scene)
    ]
    if wrong:
        raise SceneError("\n".join(wrong))
    return scene


def _one_limit(tree: dict[str, Any], overrides: Overrides) -> None:
    """What overrides say about when to stop tracing replaces what the scene says."""
    sampling = tree.get("sampling")
    given = {key for key in LIMITS if f"sampling.{key}" in overrides}
    if isinstance(sampling, dict) and given:
        for key in LIMITS:
            # Samples are also those of each pass to a phase error.
            if key not in given and {key, *given} != {"samples", "phase_error_rad"}:
                sampling.pop(key, None)


def dumps(scene: Scene) -> str:
    """The complete scene as TOML text, from which `parse` makes the same scene."""
    return tomli_w.dumps(scene.model_dump(mode="json", exclude_none=True))


def save(scene: Scene, path: str | Path) -> None:
    """Write the scene as a TOML file, as a whole; raises `FileError` if it cannot be written."""
    with replacing(path) as temporary:
        temporary.write_text(dumps(scene), "utf-8")


def schema() -> dict[str, Any]:
    """The JSON schema of a scene file, for editors.

    Examples
    --------
    >>> import scenes
    >>> "camera" in scenes.schema()["properties"]
    True
    """
    return {"$schema": DIALECT, **Scene.model_json_schema()}


def _resolve_board(board: dict[str, Any], folder: Path) -> None:
    """Make a board's folder, or its files where it has no folder, relative to the scene file."""
    if isinstance(board.get("folder"), str):
        board["folder"] = str(folder / board["folder"])
    elif isinstance(board.get("files"), dict):
        files = board["files"]
        board["files"] = {
            role: [str(folder / p) if isinstance(p, str) else p for p in path]
            if isinstance(path, list)
            else str(folder / path)
            if isinstance(path, str)
            else path
            for role, path in files.items()
        }


def _cannot_be_drawn(scene: Scene) -> Iterator[tuple[str, str]]:
    """Keys of `randomise` that are invalid in every sample, and why: unknown ones, and values of a wrong type.

    Whether a drawn value is in range is checked with each sample.
    """
    plain = scene.model_copy(update={"randomise": {}}).model_dump(mode="json", exclude_none=True)
    for key, distribution in scene.randomise.items():
        tree = copy.deepcopy(plain)
        try:
            _set(tree, key, distribution.draw(np.random.default_rng(0)), "key")
            Scene.model_validate(tree)
        except SceneError as error:
            yield key, str(error)
        except ValidationError as error:
            for mistake in mistakes(error, Scene, tree):
                if mistake.wrong_type:
                    yield key, mistake.message


def _set(tree: dict[str, Any], dotted: str, value: Any, what: str = "override") -> None:
    """Set one dotted key; numbers are indices into lists. Unknown keys are left to validation."""
    node: Any = tree
    *path, last = dotted.split(".")
    for i, key in enumerate(path):
        if isinstance(node, list):
            node = node[_index(node, key, f"{what} '{dotted}'")]
        elif isinstance(node, dict):
            node = node.setdefault(key, {})
        else:
            raise SceneError(
                f"{what} '{dotted}': '{'.'.join(path[:i])}' is a value, not a table, so it has no '{key}'"
            )
    if isinstance(node, list):
        node[_index(node, last, f"{what} '{dotted}'")] = value
    elif isinstance(node, dict):
        node[last] = value
    else:
        raise SceneError(f"{what} '{dotted}': '{'.'.join(path)}' is a value, not a table")


def _index(node: list[Any], key: str, what: str) -> int:
    if not key.isdecimal() or int(key) >= len(node):
        known = f"use 0 to {len(node) - 1}" if node else "it has none"
        raise SceneError(f"{what}: '{key}' is not an index into a list of {len(node)}: {known}")
    return int(key)


def _line(text: str, location: tuple[int | str, ...], given: Iterable[Sequence[str]]) -> str:
    """``:12``, the form that editors and terminals link; empty where an override set the value, or a part of it."""
    parts = [str(part) for part in location]
    if any(all(a == b for a, b in zip(parts, key, strict=False)) for key in given):
        return ""
    line = line_of(text, location)
    return "" if line is None else f":{line}"
