"""Contact sheets: many images of one file side by side, each with its own colour scale."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import BoundaryNorm, Colormap, ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evaluation.output.plots import (
    DPI,
    MISSING,
    MISSING_ON_GRAY,
    SMALL_PX,
    beyond,
    map_figure,
    spread,
)
from scenes.files.stack import Stack

THUMB_PX = 320
# Inches: gaps around a thumbnail, room for its title, for its colour bar, and for the sheet's title.
GAP, TITLE, BAR, HEAD = 0.15, 0.25, 0.95, 0.3
# Gray with saturated samples orange, for limits that end just below saturation.
CLIPPED = colormaps["gray"].with_extremes(over="#D55E00")
# Plain gray for 0, then Okabe and Ito's colours.
NOTHING = "#e8e8e8"
CATEGORIES = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#000000")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Panel:
    """One image (row, col), or (row, col, 3) of colours in [0, 1]; NaN is plain gray."""

    title: str
    values: NDArray[Any]
    unit: str = ""
    cmap: str | Colormap = "viridis"
    limits: tuple[float, float] | None = None
    """Ends of the colour scale; None: the 0.5 and 99.5 percentiles."""
    names: Sequence[str] = ()
    """Of whole numbers 0, 1, ...: what each means."""
    caption: str = ""


def contact_sheet(
    panels: Sequence[Panel], title: str = "", columns: int | None = None, thumb_px: int = THUMB_PX
) -> Figure:
    """All panels on one figure, `columns` side by side (None: about as many as rows)."""
    rows, cols = panels[0].values.shape[:2]
    columns = min(columns or int(np.ceil(np.sqrt(len(panels)))), len(panels))
    lines = -(-len(panels) // columns)
    width = thumb_px / DPI
    height = float(np.clip(width * rows / cols, 0.2 * width, 3.0 * width))
    # Only panels with a scale need space next to them.
    bar = BAR if any(panel.unit or panel.names for panel in panels) else 0.0
    cell_width, cell_height = width + bar + GAP, height + TITLE + GAP
    head = HEAD if title else 0.0
    full = (columns * cell_width + GAP, lines * cell_height + GAP + head)
    figure = Figure(full, dpi=DPI)

    def place(x: float, y: float, w: float, h: float) -> Any:
        return figure.add_axes((x / full[0], y / full[1], w / full[0], h / full[1]))

    for i, panel in enumerate(panels):
        line, column = divmod(i, columns)
        x = GAP + column * cell_width
        y = full[1] - head - (line + 1) * cell_height
        axes = place(x, y, width, height)
        side = place(x + width + 0.06, y, 0.12, height) if panel.unit or panel.names else None
        _draw(axes, side, panel, thumb_px)
    if title:
        figure.text(GAP / full[0], 1.0 - 0.5 * GAP / full[1], title, va="top", weight="bold")
    return figure


def panel_figure(panel: Panel) -> Figure:
    """One panel alone, large; numbers get axes in pixels."""
    if panel.names or panel.values.ndim == 3:
        return contact_sheet([panel], thumb_px=SMALL_PX)
    return map_figure(panel.values, panel.title, panel.unit, limits=panel.limits, cmap=panel.cmap)


def normals_as_colours(normal: NDArray[np.floating]) -> NDArray[np.float32]:
    """Unit normals (row, col, 3) as the usual colours: red to the right, green up the image, blue towards z."""
    return np.asarray(0.5 + 0.5 * normal, dtype=np.float32)


def category_colours(count: int) -> list[str]:
    """Colours of the whole numbers from 0."""
    return [NOTHING, *(CATEGORIES[i % len(CATEGORIES)] for i in range(count - 1))]


def gray_limits(stack: Stack) -> tuple[float, float]:
    """Limits of the gray scale that all frames of a stack share; with `CLIPPED` saturated pixels are orange."""
    return 0.0, float(min(np.nextafter(stack.saturation_dn, 0.0), stack.frames.max()))


def _draw(axes: Any, side: Any, panel: Panel, thumb_px: int) -> None:
    axes.set_title(panel.title, fontsize="small", loc="left", pad=3)
    axes.set(xticks=[], yticks=[])
    axes.set_facecolor(MISSING_ON_GRAY if panel.cmap == "gray" else MISSING)
    # Shrunken images are averaged as colours: a mean of labels or wrapped phases means nothing.
    small = panel.values.shape[1] > thumb_px
    how = {
        "aspect": "auto",
        "interpolation": "hanning" if small else "nearest",
        "interpolation_stage": "rgba" if small else "data",
    }
    if panel.values.ndim == 3:
        known = np.isfinite(panel.values).all(axis=-1, keepdims=True)
        with_gaps = np.concatenate([np.where(known, panel.values, 0.0), known], axis=-1)
        axes.imshow(np.clip(with_gaps, 0.0, 1.0), **how)
    elif panel.names:
        count = len(panel.names)
        colours = category_colours(count)
        norm = BoundaryNorm(np.arange(count + 1) - 0.5, count)
        image = axes.imshow(panel.values, cmap=ListedColormap(colours), norm=norm, **how)
        bar = axes.figure.colorbar(image, cax=side, ticks=range(count))
        bar.ax.set_yticklabels(list(panel.names), fontsize=7)
    else:
        shown = np.asarray(panel.values, dtype=np.float64)
        low, high = panel.limits or spread(shown)
        image = axes.imshow(shown, cmap=panel.cmap, vmin=low, vmax=high, **how)
        if side is not None:
            bar = axes.figure.colorbar(image, cax=side, extend=beyond(shown, low, high))
            bar.ax.tick_params(labelsize=7)
            bar.set_label(panel.unit, fontsize=7)
