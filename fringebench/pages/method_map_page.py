"""The map of methods as a table, a picture and a page."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from evaluation.output.report import Grid, Headline, Paragraph, Picture, Report, Section
from fringebench.experiments.surface_methods import Cell, MethodMap
from fringebench.pages.figure_tables import number

# Below this coverage an error says nothing.
FEW = 0.01
GUIDE = (
    "Coverage: pixels of the object with a valid height, of all that the camera sees. RMS: root mean square error of those. Below: what "
    "most of the other pixels fail by, the decoder's reason or 'wrong', a valid height that is off by more than 6 % of the height range."
)


def map_rows(found: MethodMap) -> tuple[list[str], list[list[str]]]:
    """Names of the methods, and a row per surface: its name, then one cell per method."""
    methods = list(dict.fromkeys(cell.method for cell in found.cells))
    cells = {(cell.surface, cell.method): cell for cell in found.cells}
    surfaces = dict.fromkeys(cell.surface for cell in found.cells)
    return methods, [[s, *(_words(cells[s, m]) for m in methods)] for s in surfaces]


def map_table(found: MethodMap) -> Table:
    """One row per surface, one column per method."""
    methods, rows = map_rows(found)
    heads = [name.replace("-", "-\n") for name in methods]
    title = "share measured, RMS error, and why the rest fails"
    table = Table("surface", *heads, title=title, title_justify="left")
    for row in rows:
        table.add_row(*row, end_section=True)
    return table


def map_figure(found: MethodMap) -> Figure:
    """Share of each surface that each method measures rightly, from white to blue."""
    methods, rows = map_rows(found)
    cells = {(cell.surface, cell.method): cell for cell in found.cells}
    right = np.array(
        [[cells[row[0], m].coverage - cells[row[0], m].wrong for m in methods] for row in rows]
    )
    figure = Figure(
        figsize=(1.2 + 1.55 * len(methods), 0.6 + 0.62 * len(rows)), layout="constrained"
    )
    axes = figure.subplots()
    axes.imshow(right, cmap="Blues", vmin=0.0, vmax=1.8, aspect="auto")
    axes.set_xticks(range(len(methods)), [name.replace("-", "-\n") for name in methods])
    axes.set_yticks(range(len(rows)), [row[0] for row in rows])
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    for y, row in enumerate(rows):
        for x, text in enumerate(row[1:]):
            axes.text(x, y, text, ha="center", va="center", fontsize="x-small")
    return figure


def map_report(found: MethodMap, spent: Mapping[str, float]) -> Report:
    """The page."""
    weak = [cell for cell in found.cells if cell.coverage - cell.wrong < 0.5]
    columns, rows = found.resolution
    methods, lines = map_rows(found)
    cells = [[cell.replace("\n", ", ") for cell in line] for line in lines]
    return Report(
        "fringebench: methods by surface",
        f"{columns} × {rows} pixels, {sum(spent.values()):.0f} s.",
        [
            Section(
                "The map",
                [
                    Picture(
                        map_figure(found),
                        "The darker, the more of the surface is measured rightly.",
                        wide=True,
                    ),
                    Paragraph(GUIDE),
                    Grid(["surface", *methods], cells, words=True),
                ],
            )
        ],
        Headline(
            f"{len(weak)} of {len(found.cells)} pairs of method and surface measure less than half of it rightly.",
            "attention" if weak else "good",
        ),
    )


def _words(cell: Cell) -> str:
    # No-break spaces: a narrow cell must not part a number from its unit.
    measured = number(cell.coverage, 100, 0) + "\u00a0%"
    if cell.rms_mm is not None and cell.coverage >= FEW:
        measured += f"\n{number(cell.rms_mm, 1e3, 0)}\u00a0µm"
    return measured + (f"\n{cell.why} {number(cell.why_share, 100, 0)}\u00a0%" if cell.why else "")
