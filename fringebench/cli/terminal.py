"""How commands answer: tables, lines, JSON, and progress."""

import json
import os
import sys
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Table

from fringebench.progress import Mode, Steps

# Below this width rich would cut figures short; a narrower terminal wraps the lines instead, which loses none.
TABLE_COLUMNS = 80
# What rich puts in place of the rest of a cell.
CUT = "…"


def print_json(value: Any) -> None:
    """Print a value as JSON; NaN and infinity are not JSON and are a `ValueError`."""
    sys.stdout.write(json.dumps(value, indent=2, allow_nan=False) + "\n")


def answer(as_json: bool, data: Any, text: str) -> None:
    """Print `data` as JSON, or `text`."""
    if as_json:
        print_json(data)
    else:
        say(text)


def say(line: str) -> None:
    """Print a line as it is: neither wrapped nor coloured."""
    sys.stdout.write(line + "\n")


def answer_console() -> Console:
    """Standard output for tables."""
    console = Console(highlight=False, color_system=_colours())
    return (
        console
        if console.width >= TABLE_COLUMNS
        else Console(highlight=False, color_system=_colours(), width=TABLE_COLUMNS)
    )


def print_figures(tables: Iterable[Table]) -> None:
    """Print tables; one of which rich would cut a cell is printed at its full width: a figure cut short is wrong."""
    for table in tables:
        console = answer_console()
        with console.capture() as fitted:
            console.print(table)
        if CUT in fitted.get():
            console.width = console.measure(
                table, options=console.options.update(width=10_000)
            ).maximum
        console.print(table)


def progress_steps(mode: Mode) -> Steps:
    """Progress on standard error."""
    return Steps(Console(stderr=True, color_system=_colours()), mode)


def _colours() -> Any:
    """No escape codes at all where NO_COLOR is set (no-color.org); rich would leave bold and italics."""
    return None if os.environ.get("NO_COLOR") else "auto"
