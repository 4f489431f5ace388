"""A report: one self-contained HTML page of text, tables, pictures and a 3-D surface. Needs no network to open."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import jinja2
import numpy as np
import plotly.graph_objects as go
from matplotlib.figure import Figure
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs

from evaluation.output.inspector import Inspector, data_url, packed
from evaluation.output.plots import UM_PER_MM, png, symmetric
from scenes.support.atomic_file import replacing

# Vertices of the 3-D surface: enough to see a fringe's error, few enough to rotate smoothly without a GPU.
SURFACE_POINTS = 60_000


@dataclass(frozen=True)
class Picture:
    """A figure with a caption that says what to look at."""

    figure: Figure
    caption: str
    wide: bool = False
    """Use the whole width of the page."""


@dataclass(frozen=True)
class Grid:
    """A table; the first column names the row."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    words: bool = False
    """Cells are text, not numbers: left aligned, and they may wrap."""
    best: Sequence[int] = ()
    """Rows to be printed bold, counted from 0."""

    def is_text(self, column: int) -> bool:
        """Whether no cell of a column has a digit; then it is aligned like text."""
        return not any(letter.isdigit() for row in self.rows for letter in row[column])


@dataclass(frozen=True)
class Paragraph:
    """Plain text."""

    text: str


@dataclass(frozen=True)
class Listing:
    """Text of a file, collapsed until opened."""

    title: str
    text: str


@dataclass(frozen=True, eq=False)
class Surface:
    """Heights as a surface that can be rotated, coloured by error; hovering shows pixel, height, truth and error."""

    height_mm: NDArray[np.floating]
    """Measured (row, col), NaN where nothing is measured."""
    truth_mm: NDArray[np.floating] | None
    """True heights (row, col); None where they are not known: colour then shows height."""
    xyz_mm: NDArray[np.floating]
    """(row, col, 3) measured points in world coordinates."""
    caption: str = ""

    def to_json(self) -> str:
        """The surface as a plotly figure."""
        rows, cols = self.height_mm.shape
        stride = max(1, int(np.ceil(np.sqrt(rows * cols / SURFACE_POINTS))))
        # The middle pixel of each block with its own numbers: nothing is averaged.
        pick = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))
        height = self.height_mm[pick]
        row, col = np.meshgrid(
            *(np.arange(n)[s] for n, s in zip((rows, cols), pick, strict=True)), indexing="ij"
        )
        hover = [col, row, height]
        text = "pixel (%{customdata[0]}, %{customdata[1]})<br>height %{customdata[2]:.4f} mm"
        if self.truth_mm is None:
            shown, scale, title = height, "Viridis", "height (mm)"
            low, high = (float(v) for v in np.nanpercentile(height, [0.5, 99.5]))
        else:
            true = self.truth_mm[pick]
            error = (height - true) * UM_PER_MM
            low, high = symmetric(error)
            scale, title = "RdBu_r", "error (µm)"
            shown = np.clip(error, -10 * high, 10 * high)
            hover += [true, error]
            text += "<br>truth %{customdata[3]:.4f} mm<br>error %{customdata[4]:.1f} µm"
        figure = go.Figure(
            go.Surface(
                x=self.xyz_mm[pick][..., 0].astype(np.float32),
                y=self.xyz_mm[pick][..., 1].astype(np.float32),
                z=height.astype(np.float32),
                surfacecolor=shown.astype(np.float32),
                customdata=np.stack(hover, axis=-1).astype(np.float32),
                cmin=low,
                cmax=high,
                colorscale=scale,
                colorbar={"title": {"text": title}},
                hovertemplate=text + "<extra></extra>",
            )
        )
        span = np.nanmax(self.xyz_mm[..., :2], axis=(0, 1)) - np.nanmin(
            self.xyz_mm[..., :2], axis=(0, 1)
        )
        solid = height if self.truth_mm is None else self.truth_mm
        tall = float(np.nanmax(solid) - np.nanmin(solid)) if np.isfinite(solid).any() else 1.0
        # Heights are stretched so that they are visible in a field many times as wide.
        stretch = max(tall / float(span.max()), 0.2)
        figure.update_layout(
            margin={"l": 0, "r": 0, "t": 0, "b": 0},
            scene={
                "xaxis": {"title": {"text": "x (mm)"}},
                "yaxis": {"title": {"text": "y (mm)"}},
                "zaxis": {"title": {"text": "height (mm)"}},
                "aspectmode": "manual",
                "aspectratio": {"x": 1.4, "y": 1.4 * float(span[1] / span[0]), "z": 1.4 * stretch},
                "camera": {"eye": {"x": 0.0, "y": -1.5, "z": 1.2}},
            },
        )
        json: str = figure.to_json()
        # A closing script tag inside a string would end the page's script.
        return json.replace("</", "<\\/")


Block = Picture | Grid | Paragraph | Listing | Surface | Inspector


@dataclass(frozen=True)
class Section:
    """A heading and its content."""

    title: str
    blocks: Sequence[Block]


Tone = Literal["good", "attention", "bad"]


@dataclass(frozen=True)
class Headline:
    """The result of a page in one or two sentences, shown first."""

    text: str
    tone: Tone
    """Colour of the box; the text must not depend on it."""


@dataclass(frozen=True)
class Report:
    """A page: title, its result, one line of what it is, sections."""

    title: str
    summary: str
    sections: Sequence[Section] = field(default_factory=tuple)
    headline: Headline | None = None

    def html(self) -> str:
        """The page as one self-contained document."""
        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("evaluation.output"),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
            trim_blocks=True,
            lstrip_blocks=True,
        )
        environment.filters["data_url"] = lambda figure: data_url(png(figure))
        environment.tests["instance_of"] = lambda block, name: type(block).__name__ == name
        blocks = [block for section in self.sections for block in section.blocks]
        script = (
            packed(get_plotlyjs().encode())
            if any(isinstance(b, Surface | Inspector) for b in blocks)
            else ""
        )
        return environment.get_template("report.html.j2").render(report=self, plotly=script)

    def write(self, path: str | Path) -> None:
        """Write the page, atomically.

        Raises
        ------
        FileError
            When the file cannot be written.
        """
        text = self.html()
        with replacing(path) as temporary:
            temporary.write_text(text, "utf-8")
