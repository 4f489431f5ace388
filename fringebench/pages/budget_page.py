"""An error budget as a page."""

from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from evaluation.output.plots import MISSING
from evaluation.output.report import Paragraph, Picture, Report, Section
from evaluation.scoring.error_budget import ErrorBudget
from fringebench.pages.figure_tables import grid
from fringebench.pages.headlines import budget_headline
from fringebench.pages.origin import provenance
from fringebench.pages.score_tables import budget_table


def budget_report(
    found: ErrorBudget, toml: str, seed: int, seconds: Mapping[str, float], description: str = ""
) -> Report:
    """The page; `toml` is the scene's."""
    table = budget_table(found)
    totals = [i for i, cell in enumerate(table.columns[1].cells) if "total" in str(cell)]
    absent = f" Not in this scene: {', '.join(found.absent)}." if found.absent else ""
    return Report(
        f"fringebench: error budget of {found.scene}",
        description,
        [
            Section(
                "Causes of error",
                [
                    Picture(
                        budget_figure(found),
                        "Shares of the mean square error of each region. Left of zero: causes that compensate each other.",
                        wide=True,
                    ),
                    Paragraph(
                        "Mean square errors of independent causes add up; the remainder is the interaction. Alone: with this "
                        "cause only (squares of a projector: with a pixel's footprint). Removed: the decrease without this cause, negative if the error grows. Valid: change of "
                        "the share of measured pixels." + absent
                    ),
                    grid(table, totals),
                ],
            ),
            provenance(toml, seed, seconds),
        ],
        budget_headline(found),
    )


def budget_figure(found: ErrorBudget) -> Figure:
    """A bar for each region: shares of its mean square error by cause, of the method itself and of the interaction."""
    regions = [(name, r) for name, r in found.regions.items() if r.total_mm2]
    names = [*found.causes, "method itself", "interaction"]
    colours = [*(colormaps["tab10"](i) for i in range(len(found.causes))), "black", MISSING]
    figure = Figure(figsize=(9.0, 1.4 + 0.45 * len(regions)), layout="constrained")
    axes = figure.subplots()
    shares = np.zeros((len(regions), len(names)))
    for i, (_, region) in enumerate(regions):
        parts = [share.alone_mm2 for share in region.causes.values()]
        parts += [region.ideal_mm2, region.interaction_mm2]
        shares[i] = [100.0 * (part or 0.0) / (region.total_mm2 or 1.0) for part in parts]
    for j, (name, colour) in enumerate(zip(names, colours, strict=True)):
        before = shares[:, :j]
        # Negative shares are stacked to the left of zero, the others to the right.
        start = np.where(
            shares[:, j] < 0,
            np.minimum(before, 0.0).sum(axis=1),
            np.maximum(before, 0.0).sum(axis=1),
        )
        axes.barh(range(len(regions)), shares[:, j], left=start, color=colour, label=name)
    labels = [f"{name}\n{1000 * (r.total_mm2 or 0.0) ** 0.5:.1f} µm" for name, r in regions]
    axes.set_yticks(range(len(regions)), labels)
    axes.invert_yaxis()
    axes.axvline(0.0, color="black", linewidth=0.8)
    # Bars end at the limits otherwise: stacked ones stick to where they start.
    axes.use_sticky_edges = False
    axes.margins(x=0.03)
    axes.set_xlabel("share of the mean square error (%)")
    figure.legend(loc="outside upper center", ncols=5, fontsize="small")
    return figure
