"""TOML, JSON, YAML and XML from files that anybody may have written: whatever is wrong with a text is a `ValueError`.

The parsers themselves also run out of stack on deep nesting, which is no `ValueError`; numbers of thousands of digits
are one, but not the parsers' own.
"""

import json
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import yaml

NESTED = "nested too deeply: tables and lists within each other"
# libyaml makes objects by recursion, on a stack that Python does not watch.
DEEPEST_YAML = 50


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
    """The value of a YAML text: every scalar as it is written, a text; tags are passed over, aliases refused.

    >>> parse_yaml("%YAML:1.0\\n---\\nK: !!opencv-matrix\\n  data: [ 1., 0. ]")
    {'K': {'data': ['1.', '0.']}}
    """
    # OpenCV's first line, %YAML:1.0, is no directive that YAML knows.
    lines = text.splitlines(keepends=True)
    body = "".join("\n" if line.startswith("%") else line for line in lines)
    return _parsed(_yaml, body)


def _yaml(text: str) -> Any:
    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        depth = 0
        for event in yaml.parse(text, loader):
            if isinstance(event, yaml.AliasEvent):
                raise yaml.YAMLError(f"alias '*{event.anchor}': write out what it stands for")
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST_YAML:
                raise ValueError(NESTED)
        return yaml.load(text, loader)
    except yaml.YAMLError as error:
        raise ValueError(" ".join(str(error).split())) from None


def parse_xml(text: str) -> Any:
    """The value of an XML text as OpenCV writes it: an element's children by name, a list where all are called ``_``.

    Every scalar is a text; several, with space between, are a list.

    >>> parse_xml("<opencv_storage><size><_>4</_><_>3</_></size><data>1. 0.</data></opencv_storage>")
    {'size': ['4', '3'], 'data': ['1.', '0.']}
    """
    return _parsed(lambda given: _element(_xml(given)), text)


def _xml(text: str) -> ET.Element:
    if "<!" in text.replace("<!--", ""):
        raise ValueError("a document type or CDATA: calibrations have neither")
    try:
        return ET.fromstring(text)
    except ET.ParseError as error:
        raise ValueError(str(error)) from None


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
