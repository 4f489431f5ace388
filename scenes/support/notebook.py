"""How results show themselves in terminals (`repr`), notebooks (`_repr_html_`) and figures (`plot`)."""

import base64
import html
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Images of a notebook have at most so many pixels a side.
THUMB_PX = 300
# Colour of pixels without a value.
NOTHING = "#bbbbbb"


class PreviewPlane(NamedTuple):
    """One image to show."""

    title: str
    unit: str
    values: NDArray[Any]
    """(row, col)."""
    names: Sequence[str] = ()
    """What the whole numbers from 1 mean, where `values` are labels; 0 is nothing."""


class Displayed:
    """Short `repr`, an HTML view for notebooks, and `plot`, from facts and images that a subclass gives."""

    def _facts(self) -> Mapping[str, str]:
        """What is worth knowing, in words; quick to compute."""
        raise NotImplementedError

    def _planes(self) -> Sequence[PreviewPlane]:
        """Images to show."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """One line: class and facts."""
        facts = ", ".join(f"{name} {value}" for name, value in self._facts().items())
        return f"<{type(self).__name__}: {facts}>"

    def _repr_html_(self) -> str:
        """Facts as a table next to small images."""
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            f"<td style='text-align:left'>{html.escape(value)}</td></tr>"
            for name, value in self._facts().items()
        )
        buffer = io.BytesIO()
        self.plot(small=True).savefig(buffer, format="png", dpi=80)
        data = base64.b64encode(buffer.getvalue()).decode()
        name = type(self).__name__
        return (
            f"<b>{name}</b><table>{rows}</table>"
            f"<img alt='Images of this {name}' src='data:image/png;base64,{data}'>"
        )

    def plot(self, small: bool = False) -> "Figure":
        """Draw the images side by side.

        Parameters
        ----------
        small
            Draw at most 300 x 300 pixels of each image.

        Returns
        -------
        Figure
            A Matplotlib figure; save it with `savefig`.
        """
        from matplotlib import colormaps
        from matplotlib.figure import Figure

        planes = self._planes()
        figure = Figure(figsize=(3.6 * len(planes), 3.0), layout="constrained")
        for axes, plane in zip(
            figure.subplots(1, len(planes), squeeze=False)[0], planes, strict=True
        ):
            step = max(1, -(-max(plane.values.shape) // THUMB_PX)) if small else 1
            shown = np.asarray(plane.values[::step, ::step], dtype=np.float32)
            finite = shown[np.isfinite(shown)]
            low, high = np.percentile(finite, [0.5, 99.5]) if finite.size else (0.0, 1.0)
            cmap = colormaps["gray" if plane.unit == "DN" else "viridis"]
            if plane.names:
                shown = np.where(shown > 0, shown, np.nan)
                low, high = 0.5, len(plane.names) + 0.5
                cmap = cmap.resampled(len(plane.names))
            rows, columns = plane.values.shape
            image = axes.imshow(
                shown,
                vmin=low,
                vmax=high if high > low else low + 1.0,
                cmap=cmap,
                extent=(0, columns, rows, 0),
            )
            axes.set_facecolor(NOTHING)
            bar = figure.colorbar(image, ax=axes, label=plane.unit, shrink=0.8)
            if plane.names:
                bar.set_ticks(range(1, len(plane.names) + 1), labels=plane.names)
            axes.set_title(plane.title, fontsize=9)
            axes.tick_params(labelsize=7)
        return figure
