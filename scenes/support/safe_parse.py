"""TOML, JSON, YAML and XML from untrusted files: anything wrong with a text is a `ValueError`.

The parsers themselves raise other errors too, such as `RecursionError` for deep nesting.
"""

import json
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable
from itertools import accumulate
from typing import Any

import yaml

NESTED = "nested too deeply: tables and lists within each other"
# libyaml builds objects by recursion, on a stack that Python does not guard.
MAX_YAML_DEPTH = 50


def parse_toml(text: str) -> dict[str, Any]:
    """The tables of a TOML text.

    >>> parse_toml("a = 1")
    {'a': 1}
    """
    tree: dict[str, Any] = _parsed(tomllib.loads, text)
    return tree


def parse_json(text: str) -> Any:
    """The value of a JSON text."""
    return _parsed(json.loads, text)


def parse_yaml(text: str) -> Any:
    """The value of a YAML text: every scalar as the text that is written; tags are ignored, aliases refused.

    >>> parse_yaml("%YAML:1.0\\n---\\nK: !!opencv-matrix\\n  data: [ 1., 0. ]")
    {'K': {'data': ['1.', '0.']}}
    """
    # OpenCV's first line, %YAML:1.0, is not a valid directive.
    lines = text.splitlines(keepends=True)
    body = "".join("\n" if line.startswith("%") else line for line in lines)
    return _parsed(_yaml, body)


def _yaml(text: str) -> Any:
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        depth = 0
        for event in yaml.parse(text, loader):
            if isinstance(event, yaml.AliasEvent):
                raise ValueError(  # noqa: TRY004  A wrong text, not a wrong type.
                    f"alias '*{event.anchor}': replace it by the value it refers to"
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_YAML_DEPTH:
                raise ValueError(NESTED)
        return yaml.load(text, loader)
    except yaml.YAMLError as error:
        # libyaml's own limit on brackets, where it has one, is lower than ours.
        if _bracket_depth(text) > MAX_YAML_DEPTH:
            raise ValueError(NESTED) from None
        raise ValueError(f"not valid YAML: {' '.join(str(error).split())}") from None


def _bracket_depth(text: str) -> int:
    """Maximum number of brackets open at once, quotes and comments not considered."""
    steps = ((c in "[{") - (c in "]}") for c in text)
    return max(accumulate(steps), default=0)


def parse_xml(text: str) -> Any:
    """The value of an XML text as OpenCV writes it: an element's children by name, a list where all are called ``_``.

    Every scalar is a text; several, separated by space, are a list.

    >>> parse_xml("<opencv_storage><size><_>4</_><_>3</_></size><data>1. 0.</data></opencv_storage>")
    {'size': ['4', '3'], 'data': ['1.', '0.']}
    """
    return _parsed(lambda given: _element(_xml(given)), text)


def _xml(text: str) -> ET.Element:
    # defusedxml refuses the same document types and entities, but reads CDATA, and would be one more dependency.
    if "<!" in text.replace("<!--", ""):
        raise ValueError("a document type or CDATA: calibrations have neither")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(f"not valid XML: {error}") from None


def _element(element: ET.Element) -> Any:
    if not len(element):
        words = (element.text or "").split()
        return words[0] if len(words) == 1 else words
    if all(child.tag == "_" for child in element):
        return [_element(child) for child in element]
    return {child.tag: _element(child) for child in element}


def _parsed(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError(NESTED) from None
