"""Figures of a reconstruction and its errors: maps, histograms, profiles.

Every function returns a new `matplotlib.figure.Figure`, so that nothing is shared between callers or threads.
Colour maps are perceptually uniform and safe for colour-blind readers: viridis for amounts, ColorBrewer's red-blue for
signed errors (symmetric about 0, in um; its middle is white, so that gray gaps are visible), twilight for cyclic phases. Axes
count camera pixels.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from decode import Reconstruction
from evaluation.scoring.regions import height_error_mm, scored
from scenes.files.truth_maps import Truth
from scenes.support.atomic_file import replacing
from scenes.support.errors import ScoreError

UM_PER_MM = 1000.0
URAD = 1e6
# Okabe and Ito's colours, distinguishable with every common colour blindness.
MEASURED, TRUE, PREDICTED = "#0072B2", "#D55E00", "#000000"
MISSING = "#bbbbbb"
MISSING_ON_GRAY = "#6c8ebf"
DPI = 120
# A map's image is this wide at most; a smaller one is drawn a whole number of times its size, so that no pixel is dropped.
IMAGE_PX = 960
SMALL_PX = 640
# Room about a map, inches: ticks and names left and below, title above, colour bar right.
LEFT, RIGHT, TOP, BOTTOM = 0.75, 1.35, 0.4, 0.55


def png(figure: Figure) -> bytes:
    """The figure as a PNG file's bytes."""
    # savefig draws twice, once only to measure; drawing takes most of a report's time.
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return png_of_pixels(np.asarray(canvas.buffer_rgba()))


def png_of_pixels(rgba: NDArray[np.uint8]) -> bytes:
    """An image (row, col, 4) as a PNG file's bytes, without its transparency."""
    bgr = cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR)
    done, data = cv2.imencode(".png", bgr, [cv2.IMWRITE_PNG_COMPRESSION, 3])
    assert done  # Encoding in memory cannot fail for lack of a file.
    return data.tobytes()


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, atomically.

    Raises
    ------
    FileError
        When the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(png(figure))


def draw_map(
    axes: Any,
    values: NDArray[Any],
    title: str,
    unit: str,
    *,
    limits: tuple[float, float] | None = None,
    cmap: str | Colormap = "viridis",
    bar: Any = None,
) -> None:
    """Draw an image (row, col) with a colour bar; NaN is gray. By default `limits` are its 0.5 and 99.5 percentiles;
    `bar`: axes for the bar.
    """
    shown = np.asarray(values, dtype=np.float64)
    low, high = limits or spread(shown)
    large = shown.shape[1] > IMAGE_PX
    image = axes.imshow(
        shown,
        cmap=cmap,
        vmin=low,
        vmax=high,
        # Colours are averaged, not values: a mean of wrapped phases means nothing.
        interpolation="hanning" if large else "nearest",
        interpolation_stage="rgba" if large else "data",
    )
    axes.set_facecolor(MISSING_ON_GRAY if cmap == "gray" else MISSING)
    axes.set(title=title, xlabel="column (px)", ylabel="row (px)")
    place = {"ax": axes, "shrink": 0.9} if bar is None else {"cax": bar}
    axes.figure.colorbar(image, label=unit, extend=beyond(shown, low, high), **place)


def panels(
    count: int, columns: int, width: float, height: float, foot: float = 0.0
) -> tuple[Figure, list[Any]]:
    """A figure of `count` axes of that size in inches, `columns` side by side, with fixed margins; `foot` is left free."""
    lines = -(-count // columns)
    cell = (LEFT + width + 0.15, TOP + height + BOTTOM)
    full = (columns * cell[0], lines * cell[1] + foot)
    figure = Figure(full, dpi=DPI)
    axes = []
    for i in range(count):
        line, column = divmod(i, columns)
        left, bottom = column * cell[0] + LEFT, full[1] - (line + 1) * cell[1] + BOTTOM
        box = (left / full[0], bottom / full[1], width / full[0], height / full[1])
        axes.append(figure.add_axes(box))
    return figure, axes


def map_figure(
    values: NDArray[Any],
    title: str,
    unit: str,
    *,
    limits: tuple[float, float] | None = None,
    cmap: str | Colormap = "viridis",
) -> Figure:
    """One map, see `draw_map`, its pixels shown one to one; margins are fixed, as computing them takes longer than drawing."""
    rows, cols = values.shape
    zoom = max(1, SMALL_PX // cols) if cols <= IMAGE_PX else IMAGE_PX / cols
    width, height = cols * zoom / DPI, rows * zoom / DPI
    # Leave room for labels, even for an image of a few rows.
    full = (width + LEFT + RIGHT, max(height, 1.2) + TOP + BOTTOM)
    figure = Figure(full, dpi=DPI)
    bottom, tall = BOTTOM / full[1], 1.0 - (TOP + BOTTOM) / full[1]
    axes = figure.add_axes((LEFT / full[0], bottom, width / full[0], tall))
    bar = figure.add_axes(((LEFT + width + 0.12) / full[0], bottom, 0.18 / full[0], tall))
    draw_map(axes, values, title, unit, limits=limits, cmap=cmap, bar=bar)
    return figure


def error_map(rec: Reconstruction, truth: Truth, limit_um: float | None = None) -> Figure:
    """Map of the signed height error in um, rejected pixels gray; the scale ends by default at its 99th percentile."""
    error = height_error_mm(rec, truth) * UM_PER_MM
    limits = (-limit_um, limit_um) if limit_um else symmetric(error)
    return map_figure(error, "Height error (measured − true)", "µm", limits=limits, cmap="RdBu_r")


def error_histograms(rec: Reconstruction, truth: Truth) -> Figure:
    """Histogram of height errors of every region with a measured pixel (`ScoreError` if none has).

    The predicted density is the mean of the pixels' normal densities. Errors beyond both 6 predicted sigmas and the
    99th percentile are counted in the title, not drawn.
    """
    error, sigma = height_error_mm(rec, truth) * UM_PER_MM, rec.sigma_mm * UM_PER_MM
    regions: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]] = {}
    for label in truth.labels:
        use = scored(truth, label) & np.isfinite(error)
        if use.any():
            regions[label] = error[use], sigma[use & (sigma > 0)].astype(np.float64)
    if not regions:
        raise ScoreError("no region has a measured pixel, so there is no error to draw")
    figure, places = panels(len(regions), min(3, len(regions)), 2.7, 1.7, foot=0.35)
    for axes, (label, (errors, predicted)) in zip(places, regions.items(), strict=True):
        _histogram(axes, label, errors, predicted)
    legends = [axes.get_legend_handles_labels() for axes in places]
    shown = {text: handle for pair in legends for handle, text in zip(*pair, strict=True)}
    figure.legend(shown.values(), shown.keys(), loc="lower right", ncols=2, fontsize="small")
    return figure


def profile_figure(
    rec: Reconstruction, truth: Truth, index: int, along: Literal["row", "column"] = "row"
) -> Figure:
    """Heights along an image row or column with the truth in mm, and below the error in um with +- 2 sigma."""
    error = height_error_mm(rec, truth)
    axis = 0 if along == "row" else 1
    if not 0 <= index < error.shape[axis]:
        raise ScoreError(f"{along} {index} does not exist: use 0 to {error.shape[axis] - 1}")

    def line(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(np.take(values, index, axis=axis), dtype=np.float64)

    position = line(truth.xyz_mm[..., 0 if along == "row" else 1])
    errors, sigma = line(error) * UM_PER_MM, line(rec.sigma_mm) * UM_PER_MM
    valid = np.isfinite(errors)
    figure, (above, below) = panels(2, 1, 6.3, 1.7)
    # Heights need more space than errors do, and no x axis of their own.
    above.set_position((LEFT / 7.2, 0.46, 6.3 / 7.2, 0.47))
    below.sharex(above)
    above.tick_params(labelbottom=False)
    measured = np.where(valid, line(rec.height_mm), np.nan)
    above.plot(position, measured, ".", color=MEASURED, markersize=2.5, label="measured")
    above.plot(position, line(truth.height_mm), color=TRUE, linewidth=1.0, label="truth")
    above.set(ylabel="height (mm)", title=f"Profile along {along} {index}")
    above.legend(fontsize="small")
    noise = np.where(valid, 2.0 * sigma, np.nan)
    below.fill_between(
        position, -noise, noise, color=PREDICTED, alpha=0.2, linewidth=0, label="± 2σ predicted"
    )
    below.plot(position, errors, ".", color=MEASURED, markersize=2.5)
    below.set(xlabel=f"{'x' if along == 'row' else 'y'} (mm)", ylabel="error (µm)")
    if valid.any():
        limit = float(np.percentile(np.abs(errors[valid]), 99.0)) * 1.3
        below.set_ylim(-limit or -1.0, limit or 1.0)
    if np.isfinite(noise).any():
        below.legend(fontsize="small", loc="upper right")
    return figure


def row_through(truth: Truth, label: str) -> int | None:
    """Image row for a profile of a label: through its highest pixel, the middle of equally high ones; None if not visible."""
    mask = truth.region(label) & np.isfinite(truth.height_mm)
    if not mask.any():
        return None
    height = np.where(mask, truth.height_mm, -np.inf)
    # Heights within a nanometre differ by float32 rounding only.
    rows, _ = np.nonzero(height >= height.max() - 1e-6)
    return int(np.median(rows))


def figures(rec: Reconstruction, truth: Truth) -> Mapping[str, Figure]:
    """The standard set of figures for a report, by name; quantities that the reconstruction lacks are left out."""
    found = {
        "height": map_figure(np.where(rec.valid, rec.height_mm, np.nan), "Height", "mm"),
        "error": error_map(rec, truth),
    }
    if np.isfinite(rec.modulation_dn).any():
        found["modulation"] = map_figure(rec.modulation_dn, "Modulation B", "DN")
    stated = (
        ("sigma", "Predicted standard deviation", rec.sigma_mm),
        ("render_noise", "Standard deviation from render noise", truth.render_noise_mm),
    )
    noises = {
        name: (title, np.where(rec.valid, mm, np.nan) * UM_PER_MM)
        for name, title, mm in stated
        if mm is not None and np.isfinite(mm[rec.valid]).any()
    }
    common = spread(np.array([um for _, um in noises.values()]))
    found |= {n: map_figure(um, t, "µm", limits=common) for n, (t, um) in noises.items()}
    if rec.slope is not None and rec.slope_sigma is not None:
        for name, title, values in (
            ("slope", "Slope ∂z/∂x", rec.slope[0]),
            ("slope_sigma", "Predicted standard deviation of ∂z/∂x", rec.slope_sigma[0]),
        ):
            shown = np.where(rec.valid, values, np.nan) * URAD
            found[name] = map_figure(shown, title, "µrad")
    if np.isfinite(height_error_mm(rec, truth)).any():
        found["histograms"] = error_histograms(rec, truth)
    through: dict[int, list[str]] = {}
    for label in truth.labels:
        row = row_through(truth, label) if label in ("cap", "step", "solder") else None
        if row is not None:
            through.setdefault(row, []).append(label)
    profiles = {"-".join(labels): row for row, labels in through.items()}
    return found | {f"profile-{n}": profile_figure(rec, truth, at) for n, at in profiles.items()}


def _histogram(
    axes: Any, label: str, errors: NDArray[np.float64], sigma: NDArray[np.float64]
) -> None:
    typical = float(np.median(sigma)) if sigma.size else 0.0
    reach = max(float(np.percentile(np.abs(errors), 99.0)), 6.0 * typical) or 1.0
    inside = np.abs(errors) <= reach
    # Enough bins to show the width, no more than the pixels can fill.
    bins = int(np.clip(np.sqrt(inside.sum()), 11, 101))
    counts, edges = np.histogram(errors, bins, (-reach, reach))
    density = counts / (errors.size * np.diff(edges))
    axes.stairs(density, edges, fill=True, color=MEASURED, alpha=0.6, label="measured")
    if typical > 0:
        x = np.linspace(-reach, reach, 401)
        # A hundred quantiles represent all pixels.
        some = np.quantile(sigma, np.linspace(0.005, 0.995, 100))[:, None]
        normal = np.exp(-0.5 * (x / some) ** 2) / (some * np.sqrt(2.0 * np.pi))
        axes.plot(x, normal.mean(axis=0), color=PREDICTED, linewidth=1.0, label="predicted noise")
    beyond = int((~inside).sum())
    rest = f", {beyond} beyond" if beyond else ""
    axes.set(xlabel="height error (µm)", ylabel="density (1/µm)")
    axes.locator_params(nbins=5)
    axes.set_title(f"{label}: {errors.size} px{rest}", fontsize="medium")


def spread(values: NDArray[np.float64]) -> tuple[float, float]:
    """Ends of a colour scale: the 0.5 and 99.5 percentiles of the data, never equal."""
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0, 1.0
    low, high = (float(p) for p in np.percentile(known, [0.5, 99.5]))
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def symmetric(values: NDArray[np.floating]) -> tuple[float, float]:
    """Ends of a colour scale of signed values: the 99th percentile of their size on both sides of 0; 1 if they are all 0."""
    known = np.abs(values[np.isfinite(values)])
    limit = (float(np.percentile(known, 99.0)) if known.size else 0.0) or 1.0
    return -limit, limit


def beyond(values: NDArray[np.float64], low: float, high: float) -> str:
    """Which ends of a colour scale the data exceeds, in matplotlib's words; rounding is ignored."""
    slack = 1e-6 * (high - low)
    under, over = bool(np.any(values < low - slack)), bool(np.any(values > high + slack))
    return {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[under, over]
