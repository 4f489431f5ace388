"""The experiments of the chapter as a page: the table, the figures, and how to repeat them."""

from collections.abc import Mapping

from matplotlib.figure import Figure
from rich.table import Table

from evaluation.output.report import Listing, Paragraph, Picture, Report, Section
from fringebench.experiments.textbook import ChapterResult
from fringebench.pages.figure_tables import figure_table, grid, number
from fringebench.pages.headlines import chapter_headline
from fringebench.pages.origin import provenance

CAPTIONS = {
    "1-fringes": "The finest fringes in four steps of a quarter period: the cap bends them, the step breaks them.",
    "2-wrapped-phase": "Phase of the finest fringes. It repeats every period, so it is ambiguous across the edge of the step.",
    "3-low-frequency-guide": "The coarse fringes: the step shifts them by 0.6 rad, less than half a period.",
    "4-absolute-phase": "Fine phase with the fringe order from the coarse one.",
    "5-height-map": "Height, linear in the phase difference to a flat board.",
    "6-modulation-and-mask": "The trap: ink is below the threshold of the mask, the saturated highlight is not.",
    "7-error-map": "Errors of the trap: noise where it is dark, a silent ripple where it is saturated.",
}


def chapter_report(
    result: ChapterResult,
    drawn: Mapping[str, Figure],
    toml: Mapping[str, str],
    seed: int,
    seconds: Mapping[str, float],
) -> Report:
    """The page: `drawn` are the figures by name, `toml` the scenes by name."""
    about = provenance("", seed, seconds)
    listings = [Listing(f"Scene {name} as TOML", text) for name, text in toml.items()]
    return Report(
        "fringebench: the chapter's experiments",
        "A cap of 6 mm and a step of 3 mm, captured bright, dim, and with a dark corner and a saturated highlight.",
        [
            Section(
                "Chapter, theory, measured",
                [
                    grid(chapter_table(result), words=True),
                    Paragraph(
                        "Chapter: the printed figure. Theory: prediction from noise, rounding and clipping of the rendered light. "
                        "Measured: result of the decoder."
                    ),
                ],
            ),
            Section(
                "Figures",
                [
                    Picture(figure, CAPTIONS[name], wide=name == "6-modulation-and-mask")
                    for name, figure in drawn.items()
                ],
            ),
            Section(about.title, [*about.blocks, *listings]),
        ],
        chapter_headline(result),
    )


def chapter_table(result: ChapterResult) -> Table:
    """Figures of the chapter next to theory and measurement."""
    names = ("chapter", "theory", "measured")
    table = figure_table("the chapter's experiments", "figure", names)
    table.add_column("note")
    for row in result.rows:
        figures = (number(x, 1, 4) for x in (row.chapter, row.theory, row.measured))
        table.add_row(row.name, *figures, row.note)
    return table
