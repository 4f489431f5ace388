"""Tables of the terminal as tables of a report: the same numbers, computed once."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from evaluation.output.report import Grid


def figure_table(
    title: str, name: str, figures: Iterable[str], rows: Iterable[Sequence[str]] = (), **style: Any
) -> Table:
    """A table of figures, aligned right, after a first column of names; `style` as for rich's tables."""
    table = Table(title=title, title_justify="left", **style)
    table.add_column(name, no_wrap=True)
    for heading in figures:
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def number(value: float | None, scale: float, digits: int, signed: bool = False) -> str:
    """A figure times `scale`, with so many digits; a dash for None; a sign, if requested, for what is not 0.

    >>> number(-1e-4, 100, 1), number(2e-3, 1000, 2, signed=True)
    ('0.0', '+2.00')
    """
    if value is None:
        return "-"
    # Adding 0.0 turns a rounded -0.0 into 0.0.
    rounded = round(value * scale, digits) + 0.0
    return f"{rounded:{'+' if signed and rounded else ''}.{digits}f}"


def grid(table: Table, best: Sequence[int] = (), words: bool = False) -> "Grid":
    """Cells of a table without markup; rows `best` are printed bold."""
    from evaluation.output.report import Grid

    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    names = [_plain(column.header) for column in table.columns]
    return Grid(names, list(zip(*columns, strict=True)), _plain(table.title or ""), words, best)


def _plain(cell: object) -> str:
    return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell)
