"""On which line of a TOML text a key is: `tomllib` does not say."""

import tomllib
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

Location = tuple[str | int, ...]
# A statement is parsed again with each of its lines: longer ones would take too much time.
MAX_STATEMENT_LINES = 200


def line_of(text: str, location: Location) -> int | None:
    """Line, counted from 1, of a key in valid TOML, else of the innermost table around it; None if there is none.

    >>> line_of("[camera]\\nfx_px = 1.0\\n[[objects]]\\nlabel = 'a'", ("objects", 0, "label"))
    4
    """
    lines = _lines(text)
    found = (lines.get(location[:length]) for length in range(len(location), 0, -1))
    return next((line for line in found if line is not None), None)


@lru_cache(maxsize=1)
def _lines(text: str) -> dict[Location, int]:
    """First line of every key and table; cached, because a text with one mistake often has ten."""
    lines: dict[Location, int] = {}
    counts: dict[Location, int] = {}
    table: Location = ()
    for number, is_header, tree in _statements(text):
        if not is_header:
            for location in _locations(tree, table):
                lines.setdefault(location, number)
            continue
        table = ()
        node: Any = tree
        while isinstance(node, dict) and node:
            ((name, node),) = node.items()
            table = (*table, name)
            lines.setdefault(table, number)
            if isinstance(node, list):  # [[name]] adds an item.
                counts[table] = counts.get(table, -1) + 1
            if table in counts:
                table = (*table, counts[table])
                lines.setdefault(table, number)
    return lines


def _statements(text: str) -> Iterator[tuple[int, bool, dict[str, Any]]]:
    """Line, whether it is a table's header, and value of each statement: the lines up to where it parses.

    A list over several lines is repeated with each line that ends an item.
    """
    start, collected, inside = 1, "", False
    for number, line in enumerate(text.splitlines(keepends=True), 1):
        collected += line
        tree = _parsed(collected)
        if tree is not None:
            yield number if inside else start, collected.lstrip().startswith("["), tree
            start, collected, inside = number + 1, "", False
        elif number - start >= MAX_STATEMENT_LINES:
            return
        else:
            tree = _parsed(collected + "]")
            if tree is not None:
                inside = True
                yield number, False, tree


def _parsed(text: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError):
        return None


def _locations(tree: Any, at: Location) -> Iterator[Location]:
    if at:
        yield at
    items = (
        tree.items()
        if isinstance(tree, dict)
        else enumerate(tree)
        if isinstance(tree, list)
        else ()
    )
    for key, value in items:
        yield from _locations(value, (*at, key))
