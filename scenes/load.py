"""Scenes from TOML and back: shipped names, files, overrides, JSON schema."""

import copy
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from scenes.errors import FileError, SceneError, nearest
from scenes.foreign_text import parse_toml
from scenes.paths import is_file, is_folder, missing
from scenes.replace_file import replacing
from scenes.scene import Scene
from scenes.toml_lines import line_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"
Overrides = Mapping[str, Any]

# Errors of a scene that are told at once.
MOST_TOLD = 10
# pydantic's names of errors in the key that says which kind a table is.
UNION_TAG = ("union_tag_invalid", "union_tag_not_found")
# Python's and pydantic's words for what TOML calls otherwise.
PLAIN_WORDS = {
    "valid tuple": "list",
    "Tuple should": "The list should",
    " after validation": "",
    "valid dictionary or object to extract fields from": "table",
    "valid dictionary": "table",
}
# pydantic's names of errors that no other value of that type would mend.
WRONG_TYPE = re.compile(r"_type$|_parsing$|^int_from_float$")


def shipped() -> tuple[str, ...]:
    """Names of the scenes that come with the project."""
    folder = resources.files("scenes") / "shipped"
    return tuple(sorted(p.name[:-5] for p in folder.iterdir() if p.name.endswith(".toml")))


def source(name: str | Path) -> str:
    """The TOML text of a shipped scene or of a file; `SceneError` or `FileError` if there is none."""
    path = Path(name)
    if str(name) in shipped():
        return (resources.files("scenes") / "shipped" / f"{name}.toml").read_text("utf-8")
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
    """A shipped scene by name, or a TOML file, with overrides by dotted key.

    >>> import scenes
    >>> scenes.load("bench", {"camera.resolution": [320, 240]}).camera.resolution
    (320, 240)
    """
    text = source(name)
    folder = None if str(name) in shipped() else Path(name).resolve().parent
    return parse(text, overrides, where=str(name), folder=folder)


def parse(
    text: str,
    overrides: Overrides | None = None,
    where: str = "scene",
    folder: Path | None = None,
) -> Scene:
    """A scene from TOML text; mesh paths are resolved against `folder`. Raises `SceneError`."""
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
    items = tree.get("objects") if folder else None
    for item in items if isinstance(items, list) else []:
        shape = item.get("shape", {}) if isinstance(item, dict) else {}
        if isinstance(shape, dict) and isinstance(shape.get("path"), str):
            shape["path"] = str(folder / shape["path"])
    board = tree.get("board") if folder else None
    if isinstance(board, dict):
        _resolve_board(board, folder or Path())
    given = [key.split(".") for key in overrides or {}]
    try:
        scene = Scene.model_validate(tree)
    except ValidationError as error:
        inner = _innermost(error)
        told = [
            f"{where}{_line(text, _in_tree(d, tree), given)}: {_message(d, tree)}"
            for d in inner[:MOST_TOLD]
        ]
        if len(inner) > MOST_TOLD:
            told.append(f"{where}: and {len(inner) - MOST_TOLD} more errors")
        raise SceneError("\n".join(told)) from None
    wrong = [
        f"{where}{_line(text, ('randomise', key), given)}: randomise: {message}"
        for key, message in _cannot_be_drawn(scene)
    ]
    if wrong:
        raise SceneError("\n".join(wrong))
    return scene


def dumps(scene: Scene) -> str:
    """The scene as TOML, complete enough to load the same scene again."""
    return tomli_w.dumps(scene.model_dump(mode="json", exclude_none=True))


def save(scene: Scene, path: str | Path) -> None:
    """Write the scene as TOML, beside and renamed."""
    with replacing(path) as beside:
        beside.write_text(dumps(scene), "utf-8")


def schema() -> dict[str, Any]:
    """The JSON schema of a scene file, for editors."""
    return {"$schema": DIALECT, **Scene.model_json_schema()}


def _resolve_board(board: dict[str, Any], folder: Path) -> None:
    """Make a board's folder, or its files where it has no folder, relative to the scene file."""
    if isinstance(board.get("folder"), str):
        board["folder"] = str(folder / board["folder"])
    elif isinstance(board.get("files"), dict):
        files = board["files"]
        board["files"] = {
            role: str(folder / path) if isinstance(path, str) else path
            for role, path in files.items()
        }


def _innermost(error: ValidationError) -> list[ErrorDetails]:
    """A list whose items failed is also reported as too short: only the innermost cause helps."""
    details = error.errors()
    outer = {d["loc"][:depth] for d in details for depth in range(len(d["loc"]))}
    return [d for d in details if d["loc"] not in outer]


def _cannot_be_drawn(scene: Scene) -> Iterator[tuple[str, str]]:
    """Keys of `randomise` that no sample can have, and why: unknown ones, and numbers where words stand.

    Whether a drawn value is in range is for the sample to say: it may be in one and not in another.
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
            for detail in _innermost(error):
                if detail["type"] == "extra_forbidden" or WRONG_TYPE.search(detail["type"]):
                    yield key, _message(detail, tree)


def _set(tree: dict[str, Any], dotted: str, value: Any, what: str = "override") -> None:
    """Set one dotted key; numbers step into lists. A key that leads nowhere is left to validation to name."""
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
        raise SceneError(f"{what}: '{key}' is no index into a list of {len(node)}: {known}")
    return int(key)


def _message(detail: ErrorDetails, tree: dict[str, Any]) -> str:
    """One validation error in the project's words: key, value, what is allowed."""
    location = ".".join(map(str, _in_tree(detail, tree))) or "scene"
    if detail["type"] == "extra_forbidden":
        unknown, known = str(detail["loc"][-1]), set(_known_keys(detail["loc"]))
        if unknown in known:
            return f"key '{location}' belongs to another kind or model than the one chosen here"
        return f"unknown key '{location}': {nearest(unknown, known)}"
    if detail["type"] == "missing":
        return f"key '{location}' is missing: it is required"
    value = detail["input"]
    if detail["type"] in UNION_TAG:
        kinds = sorted(set(_kinds(detail["loc"])))
        if detail["type"] == "union_tag_not_found":
            return f"key '{location}' is missing: it is required, one of {', '.join(kinds)}"
        tag = str(detail["ctx"]["tag"])
        return f"{location}: there is no '{tag}': {nearest(tag, kinds)}"
    message = detail["msg"].removeprefix("Value error, ")
    for theirs, ours in PLAIN_WORDS.items():
        message = message.replace(theirs, ours)
    shown = "" if isinstance(value, (dict, BaseModel)) else f" (got {value!r})"
    return f"{location}: {message}{shown}"


def _line(text: str, location: tuple[int | str, ...], given: Iterable[Sequence[str]]) -> str:
    """``:12``, as editors and terminals follow it; nothing where an override gave the value, or a part of it."""
    parts = [str(part) for part in location]
    if any(all(a == b for a, b in zip(parts, key, strict=False)) for key in given):
        return ""
    line = line_of(text, location)
    return "" if line is None else f":{line}"


def _in_tree(detail: ErrorDetails, tree: Any) -> tuple[int | str, ...]:
    """Where an error lies as the user wrote it: pydantic adds the names of chosen union branches, which the TOML lacks."""
    location = detail["loc"]
    parts = []
    for position, part in enumerate(location):
        if isinstance(tree, list):
            inside = isinstance(part, int) and part < len(tree)
        else:
            inside = isinstance(tree, dict) and part in tree
        named = position == len(location) - 1 and detail["type"] in ("extra_forbidden", "missing")
        if inside or named:
            parts.append(part)
        if inside:
            tree = tree[part]
    if detail["type"] in UNION_TAG and isinstance(tree, dict):
        # pydantic names the table; what is wrong is its kind.
        parts.append(str(detail["ctx"]["discriminator"]).strip("'"))
    return tuple(parts)


def _known_keys(location: tuple[int | str, ...]) -> Iterator[str]:
    """Keys allowed beside the last part of a location."""
    for node, root in _nodes(location[:-1]):
        for option in _options(_resolve(node, root), root):
            yield from option.get("properties", {})


def _kinds(location: tuple[int | str, ...]) -> Iterator[str]:
    """Kinds (or models) that the table at a location may be of."""
    for node, root in _nodes(location):
        for option in [node, *node.get("anyOf", [])]:
            yield from _resolve(option, root).get("discriminator", {}).get("mapping", {})


def _nodes(location: tuple[int | str, ...]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """What the JSON schema says at a location, each beside the schema itself."""
    root = Scene.model_json_schema()
    nodes = [root]
    for part in location:
        nodes = [
            child for node in nodes for child in _children(_resolve(node, root), part, root)
        ] or nodes
    return [(node, root) for node in nodes]


def _resolve(node: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    while "$ref" in node:
        node = root["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    return node


def _options(node: dict[str, Any], root: dict[str, Any]) -> list[dict[str, Any]]:
    branches = node.get("oneOf") or node.get("anyOf")
    return [_resolve(branch, root) for branch in branches] if branches else [node]


def _children(
    node: dict[str, Any], part: int | str, root: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    for option in _options(node, root):
        if isinstance(part, int):
            yield from [option["items"]] if "items" in option else []
        elif part in option.get("properties", {}):
            yield option["properties"][part]
        elif isinstance(option.get("additionalProperties"), dict):
            yield option["additionalProperties"]
        else:
            # pydantic names the chosen branch of a tagged union in the location
            yield from [*option.get("oneOf", []), *option.get("anyOf", [])]
            mapping = option.get("discriminator", {}).get("mapping", {})
            if part in mapping:
                yield {"$ref": mapping[part]}
