"""The reference of scene files: its placeholder becomes tables, and the JSON schema is written next to the page."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

import scenes

PLACEHOLDER = "<!-- scene reference -->"
ROOT = "Scene"


def setup(app: Sphinx) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("source-read", _fill)
    app.connect("build-finished", _write_schema)
    return {"parallel_read_safe": True}


def _fill(app: Sphinx, docname: str, source: list[str]) -> None:
    if PLACEHOLDER in source[0]:
        source[0] = source[0].replace(PLACEHOLDER, reference(scenes.schema()))


def _write_schema(app: Sphinx, failure: Exception | None) -> None:
    if failure is None:
        text = json.dumps(scenes.schema(), indent=1)
        Path(app.outdir, "scene.schema.json").write_text(text, "utf-8")


def reference(schema: dict[str, Any]) -> str:
    """Markdown of every table of a scene file, breadth first from the scene itself."""
    tables = {ROOT: schema, **schema["$defs"]}
    return "\n".join(_table(name, tables[name]) for name in _breadth_first(tables))


def _breadth_first(tables: dict[str, Any]) -> Iterator[str]:
    waiting, seen = [ROOT], {ROOT}
    while waiting:
        name = waiting.pop(0)
        if "properties" in tables[name]:
            yield name
        for other in _referred(tables[name].get("properties", tables[name])):
            if other not in seen:
                seen.add(other)
                waiting.append(other)


def _referred(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        if "$ref" in node:
            yield node["$ref"].rsplit("/", 1)[-1]
        for key, value in node.items():
            if key != "$ref":
                yield from _referred(value)
    elif isinstance(node, list):
        for value in node:
            yield from _referred(value)


def _table(name: str, node: dict[str, Any]) -> str:
    lines = [f"## {name}", "", node.get("description", ""), ""]
    lines += ["| key | is | default | |", "|---|---|---|---|"]
    required = node.get("required", [])
    for key, value in node["properties"].items():
        default = "**required**" if key in required else _default(value)
        about = " ".join(str(value.get("description", "")).split())
        lines.append(f"| `{key}` | {_kind(value)} | {default} | {_cell(about)} |")
    return "\n".join([*lines, ""])


def _default(value: dict[str, Any]) -> str:
    if value.get("default") is None:
        return ""
    text = json.dumps(value["default"], ensure_ascii=False)
    return _cell(f"`{text}`") if len(text) <= 60 else "see its table"


def _kind(value: dict[str, Any]) -> str:  # noqa: PLR0911  one line for each kind of value
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})" if name != "JsonValue" else "any value"
    if "const" in value:
        return f"`{json.dumps(value['const'])}`"
    if "enum" in value:
        return " or ".join(f"`{json.dumps(option)}`" for option in value["enum"])
    branches = value.get("oneOf") or value.get("anyOf")
    if branches:
        kinds = [_kind(branch) for branch in branches if branch.get("type") != "null"]
        return " or ".join(dict.fromkeys(kinds))
    if value.get("type") == "array":
        return _array(value)
    if value.get("type") == "object":
        inner = value.get("additionalProperties")
        return f"table of {_kind(inner)}" if isinstance(inner, dict) else "table"
    kind = {"number": "number", "integer": "whole number", "boolean": "true or false"}
    return kind.get(value.get("type", ""), "text") + _range(value)


def _array(value: dict[str, Any]) -> str:
    if "prefixItems" in value:
        return f"[{', '.join(_kind(item) for item in value['prefixItems'])}]"
    inner = _kind(value["items"]) if "items" in value else "any value"
    return f"list of {inner}"


def _range(value: dict[str, Any]) -> str:
    signs = (
        ("exclusiveMinimum", ">"),
        ("minimum", "≥"),
        ("exclusiveMaximum", "<"),
        ("maximum", "≤"),
    )
    limits = [f"{sign} {value[name]:g}" for name, sign in signs if name in value]
    return f" {', '.join(limits)}" if limits else ""


def _cell(text: str) -> str:
    return text.replace("|", "\\|")
