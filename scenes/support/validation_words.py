"""What a validation error of pydantic says, in the project's words: where, what is wrong, what is allowed."""

import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from scenes.support.errors import nearest

Location = tuple[int | str, ...]
Schema = dict[str, Any]

MAX_LINES = 10
# pydantic's names of errors in the key that selects one of several kinds of table.
UNION_TAG = ("union_tag_invalid", "union_tag_not_found")
# pydantic's names of errors that no other value of the same type would avoid.
WRONG_TYPE = re.compile(r"_type$|_parsing$|^int_from_float$|^extra_forbidden$")
# Python's and pydantic's words for what a TOML file calls otherwise.
PLAIN_WORDS = {
    "valid tuple": "list",
    "Tuple should": "The list should",
    " after validation": "",
    "valid dictionary or object to extract fields from": "table",
    "valid dictionary": "table",
}


class Mistake(NamedTuple):
    """One error of a validation."""

    location: Location
    """Keys and list indices, as the user wrote them."""
    message: str
    wrong_type: bool
    """The key is unknown or its value has the wrong type: no other value of that type would be valid."""


def mistakes(
    error: ValidationError, model: type[BaseModel], tree: Any = None, prefix: str = ""
) -> list[Mistake]:
    """The mistakes in `tree`, the input that `model` refused; `prefix` is written before each location."""
    # Once for all mistakes: it takes a fifth of a second.
    schema = model.model_json_schema()
    return [_mistake(detail, schema, tree, prefix) for detail in _innermost(error)]


def in_words(error: Exception) -> str:
    """What an error says: of a validation one line a mistake, of a `KeyError` which key is missing.

    >>> in_words(KeyError("seed"))
    "'seed' is missing"
    """
    if isinstance(error, ValidationError):
        return first_lines(_mistake(detail, None, None, "").message for detail in error.errors())
    return f"{error} is missing" if isinstance(error, KeyError) else str(error)


def first_lines(lines: Iterator[str] | Sequence[str]) -> str:
    """The first `MAX_LINES` lines, and how many more there are."""
    lines = list(lines)
    more = len(lines) - MAX_LINES
    return "\n".join([*lines[:MAX_LINES], *([f"and {more} more errors"] if more > 0 else [])])


def _innermost(error: ValidationError) -> list[ErrorDetails]:
    """A list whose items failed is also reported as too short: only the innermost cause helps."""
    details = error.errors()
    outer = {d["loc"][:depth] for d in details for depth in range(len(d["loc"]))}
    return [d for d in details if d["loc"] not in outer]


def _mistake(detail: ErrorDetails, schema: Schema | None, tree: Any, prefix: str) -> Mistake:
    location = detail["loc"] if schema is None else _in_tree(detail, tree)
    place = ".".join([*([prefix] if prefix else []), *map(str, location)])
    message = _message(detail, place, schema or {})
    return Mistake(location, message, bool(WRONG_TYPE.search(detail["type"])))


def _message(detail: ErrorDetails, place: str, schema: Schema) -> str:
    """Key, what is wrong, the value, what is allowed."""
    kind, location = detail["type"], detail["loc"]
    if kind == "extra_forbidden":
        unknown, known = str(location[-1]), set(_known_keys(location, schema))
        if unknown in known:
            return f"key '{place}' belongs to another kind or model than the one chosen here"
        return f"unknown key '{place}'" + (f": {nearest(unknown, known)}" if known else "")
    if kind == "missing":
        return f"key '{place}' is missing: it is required"
    if kind in UNION_TAG:
        kinds = sorted(set(_kinds(location, schema)))
        if kind == "union_tag_not_found":
            return f"key '{place}' is missing: it is required, one of {', '.join(kinds)}"
        tag = str(detail["ctx"]["tag"])
        return f"{place}: there is no '{tag}': {nearest(tag, kinds)}"
    message = detail["msg"].removeprefix("Value error, ")
    for theirs, ours in PLAIN_WORDS.items():
        message = message.replace(theirs, ours)
    value = detail["input"]
    shown = "" if isinstance(value, (dict, BaseModel)) else f" (got {value!r})"
    return f"{place}: {message}{shown}" if place else f"{message}{shown}"


def _in_tree(detail: ErrorDetails, tree: Any) -> Location:
    """Where a mistake is as the user wrote it: pydantic adds the names of chosen union branches."""
    location = detail["loc"]
    parts: list[int | str] = []
    for position, part in enumerate(location):
        if isinstance(tree, (list, tuple)):
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


def _known_keys(location: Location, schema: Schema) -> Iterator[str]:
    """Keys that are allowed where the last part of a location is."""
    for node in _nodes(location[:-1], schema):
        for option in _options(_resolve(node, schema), schema):
            yield from option.get("properties", {})


def _kinds(location: Location, schema: Schema) -> Iterator[str]:
    """Kinds (or models) that the table at a location may be of."""
    for node in _nodes(location, schema):
        for option in [node, *node.get("anyOf", [])]:
            yield from _resolve(option, schema).get("discriminator", {}).get("mapping", {})


def _nodes(location: Location, schema: Schema) -> list[Schema]:
    """What a JSON schema says at a location."""
    nodes = [schema]
    for part in location:
        nodes = [
            child for node in nodes for child in _children(_resolve(node, schema), part, schema)
        ] or nodes
    return nodes


def _resolve(node: Schema, schema: Schema) -> Schema:
    while "$ref" in node:
        node = schema["$defs"][node["$ref"].rsplit("/", 1)[-1]]
    return node


def _options(node: Schema, schema: Schema) -> list[Schema]:
    branches = node.get("oneOf") or node.get("anyOf")
    return [_resolve(branch, schema) for branch in branches] if branches else [node]


def _children(node: Schema, part: int | str, schema: Schema) -> Iterator[Schema]:
    for option in _options(node, schema):
        if isinstance(part, int):
            yield from [option["items"]] if "items" in option else []
        elif part in option.get("properties", {}):
            yield option["properties"][part]
        elif isinstance(option.get("additionalProperties"), dict):
            yield option["additionalProperties"]
        else:
            # pydantic names the chosen branch of a tagged union in the location.
            yield from [*option.get("oneOf", []), *option.get("anyOf", [])]
            mapping = option.get("discriminator", {}).get("mapping", {})
            if part in mapping:
                yield {"$ref": mapping[part]}
