"""TOML and JSON from files that anybody may have written: whatever is wrong with a text is a `ValueError`.

The parsers themselves also run out of stack on deep nesting, which is no `ValueError`; numbers of thousands of digits
are one, but not the parsers' own.
"""

import json
import tomllib
from collections.abc import Callable
from typing import Any


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


def _parsed(parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError("nested too deeply: tables and lists within each other") from None
