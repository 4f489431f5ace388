"""The terminal's tables as a report's: the same numbers, once worked out."""

from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from evaluation.report import Grid


def grid(table: Table, best: Sequence[int] = (), words: bool = False) -> Grid:
    """The table's cells, their markup left out; rows `best` are printed bold."""
    columns = [[_plain(cell) for cell in column.cells] for column in table.columns]
    names = [_plain(column.header) for column in table.columns]
    return Grid(names, list(zip(*columns, strict=True)), _plain(table.title or ""), words, best)


def _plain(cell: object) -> str:
    return Text.from_markup(cell).plain if isinstance(cell, str) else str(cell)
