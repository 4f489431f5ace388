"""The chapter's experiments as a page: the table, the figures, and how to make them again."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from evaluation.report import Grid, Listing, Paragraph, Picture, Report, Section
from fringebench.provenance import provenance

if TYPE_CHECKING:
    from fringebench.chapter import ChapterResult

CAPTIONS = {
    "1-fringes": "The finest fringes, four steps a quarter of a period apart: the cap bends them, the step breaks them.",
    "2-wrapped-phase": "Phase of the finest fringes. It repeats every period, so the step's edge cannot be followed.",
    "3-low-frequency-guide": "The coarse fringes: the step shifts them by 0.6 rad, less than half a period.",
    "4-absolute-phase": "Fine phase with the order that the coarse one gives.",
    "5-height-map": "Height, linear in what is left of the phase once a flat board's is taken away.",
    "6-modulation-and-mask": "The trap: ink falls below the mask's threshold, the saturated highlight does not.",
    "7-error-map": "Errors of the trap: noise where it is dark, a silent ripple where it is saturated.",
}


def chapter_report(
    result: "ChapterResult",
    drawn: Mapping[str, Figure],
    toml: Mapping[str, str],
    seed: int,
    seconds: Mapping[str, float],
) -> Report:
    """The page: `drawn` are the figures by name, `toml` the scenes by name."""
    rows = [
        [row.name, f"{row.chapter:.4f}", f"{row.theory:.4f}", f"{row.measured:.4f}", row.note]
        for row in result.rows
    ]
    about = provenance("", seed, seconds)
    listings = [Listing(f"Scene {name} as TOML", text) for name, text in toml.items()]
    return Report(
        "fringebench: the chapter's experiments",
        "A cap of 6 mm and a step of 3 mm, captured bright, dim, and with a dark corner and a saturated highlight.",
        [
            Section(
                "Chapter, theory, measured",
                [
                    Grid(("figure", "chapter", "theory", "measured", "note"), rows, words=True),
                    Paragraph(
                        "Chapter: the figure as printed there. Theory: what the noise, rounding and clipping of the light as "
                        "rendered must give. Measured: what the decoder made of it."
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
    )
