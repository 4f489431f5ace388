"""What a report's pixel inspector shows: linked maps, and all samples and results of the pixel chosen."""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize, to_rgba
from numpy.typing import NDArray

from decode import Reason, Reconstruction
from evaluation.output.plots import (
    MISSING,
    MISSING_ON_GRAY,
    UM_PER_MM,
    png_of_pixels,
    spread,
    symmetric,
)
from evaluation.output.scene_pictures import reason_panel
from evaluation.output.sheet import CLIPPED, Panel, category_colours, gray_limits
from evaluation.scoring.regions import height_error_mm
from scenes.acquisition.patterns import Frame
from scenes.files.stack import Stack
from scenes.files.truth_maps import Truth

# Samples and results in one page; text makes a third more of them.
MAX_BYTES = 4_000_000
WORST = 12


@dataclass(frozen=True, eq=False)
class Inspector:
    """Maps of one size, and samples and results of a grid of their pixels and of some more."""

    maps: Sequence[Panel]
    stack: Stack
    values: Mapping[str, tuple[NDArray[Any], str]] = field(default_factory=dict)
    """Title: results (row, col) and their unit."""
    words: Mapping[str, tuple[NDArray[Any], Sequence[str]]] = field(default_factory=dict)
    """Title: codes (row, col) and what each means."""
    listed: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Pixels worth a look: name, (row, column); the first is shown at the start."""

    @property
    def stride(self) -> int:
        """Samples of every `stride`-th row and column are in the page."""
        results = 4 * (len(self.values) + len(self.words)) * self.stack.frames[0, 0].size
        return max(1, int(np.ceil(np.sqrt((self.stack.frames.nbytes + results) / MAX_BYTES))))

    def to_json(self) -> str:
        """All that the page's script needs, as JSON to be written into that script."""
        stack, first = self.stack, self.stride // 2
        columns, rows = stack.resolution
        grid = np.arange(rows * columns).reshape(rows, columns)
        picked = grid[first :: self.stride, first :: self.stride]
        more = [row * columns + column for row, column in self.listed.values()]
        flat = np.concatenate([picked.ravel(), np.array(more, dtype=np.intp)])
        samples = stack.frames.reshape(*stack.frames.shape[:2], -1)[..., flat]
        whole = samples.dtype != np.float32
        shown = {
            "size": [rows, columns],
            "grid": [first, self.stride, *picked.shape],
            "listed": {name: list(place) for name, place in self.listed.items()},
            "maps": [{"title": panel.title, "image": _image(panel)} for panel in self.maps],
            "frames": [_frame(frame) for frame in stack.patterns],
            "exposures": [f"{time:.3g} ms" for time in stack.exposure_ms],
            "saturation": stack.saturation_dn,
            "whole": whole,
            # (pixel, exposure, frame)
            "samples": _numbers(np.moveaxis(samples, -1, 0), "<u2" if whole else "<f4"),
            "values": [
                {"title": title, "unit": unit, "data": _numbers(image.ravel()[flat], "<f4")}
                for title, (image, unit) in self.values.items()
            ],
            "words": [
                {"title": title, "words": list(names), "data": _numbers(codes.ravel()[flat], "<f4")}
                for title, (codes, names) in self.words.items()
            ],
        }
        return json.dumps(shown).replace("</", "<\\/")


def inspector_of(stack: Stack, rec: Reconstruction, truth: Truth | None = None) -> Inspector:
    """The inspector of a decoded stack; with the truth it has errors, labels and the worst pixels."""
    valid = rec.valid
    height = np.where(valid, rec.height_mm, np.nan)
    sigma_um = np.where(valid, rec.sigma_mm, np.nan) * UM_PER_MM
    names = tuple(reason.label for reason in Reason)
    first = Panel("First frame", stack.frames[0, 0], cmap=CLIPPED, limits=gray_limits(stack))
    maps = [first, Panel("Height", height)]
    values: dict[str, tuple[NDArray[Any], str]] = {"height": (rec.height_mm, "mm")}
    words: dict[str, tuple[NDArray[Any], Sequence[str]]] = {"reason": (rec.reason, names)}
    listed: dict[str, tuple[int, int]] = {}
    if truth is not None:
        error_um = height_error_mm(rec, truth) * UM_PER_MM
        size = np.abs(np.nan_to_num(error_um, nan=0.0))
        maps.append(Panel("Error", error_um, cmap="RdBu_r", limits=symmetric(error_um)))
        values |= {"true height": (truth.height_mm, "mm"), "error": (error_um, "µm")}
        words["label"] = (truth.label, ("nothing", *truth.labels))
        for index in np.argsort(size, axis=None)[::-1][:WORST]:
            row, column = divmod(int(index), size.shape[1])
            if size[row, column] > 0.0:
                text = f"({column}, {row}): error {error_um[row, column]:+.1f} µm"
                listed[text] = (row, column)
    values["predicted sigma"] = (sigma_um, "µm")
    if rec.phases:
        values["wrapped phase"] = (rec.wrapped_rad, "rad")
        values["fringe order"] = (rec.fringe_order, "")
    values |= {"modulation B": (rec.modulation_dn, "DN"), "offset A": (rec.offset_dn, "DN")}
    maps.append(reason_panel(rec))
    used = np.where(rec.exposure == 255, 0, rec.exposure.astype(np.int32) + 1)
    words["exposure used"] = (
        used,
        ("several or none", *(f"{t:.3g} ms" for t in stack.exposure_ms)),
    )
    return Inspector(maps, stack, values, words, listed)


def _frame(frame: Frame) -> dict[str, Any]:
    """A frame for the chart; fringes of one `set` share a sinusoid."""
    name: str = frame.kind
    if frame.period_px:
        name = f"{frame.axis} {frame.period_px:g} px, {frame.kind} {frame.step}"
    one = f"{frame.projector} {frame.axis} {frame.period_px}" if frame.kind == "fringe" else None
    return {"name": name, "set": one, "shift": frame.phase_shift_rad}


def _image(panel: Panel) -> str:
    """The panel as a PNG of one pixel a pixel, as a data URL."""
    if panel.names:
        colours = np.array([to_rgba(colour) for colour in category_colours(len(panel.names))])
        rgba = colours[np.asarray(panel.values, int)]
    else:
        shown = np.asarray(panel.values, dtype=np.float64)
        cmap = colormaps[panel.cmap] if isinstance(panel.cmap, str) else panel.cmap
        cmap = cmap.with_extremes(bad=MISSING_ON_GRAY if panel.cmap is CLIPPED else MISSING)
        scale = Normalize(*(panel.limits or spread(shown)))
        rgba = cmap(scale(np.ma.masked_invalid(shown)))
    return data_url(png_of_pixels(np.round(255.0 * np.asarray(rgba)).astype(np.uint8)))


def data_url(png: bytes) -> str:
    """A PNG file's bytes as the address of an image."""
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")


def packed(data: bytes) -> str:
    """Bytes, gzipped and in base64."""
    return base64.b64encode(gzip.compress(data, 6, mtime=0)).decode("ascii")


def _numbers(values: NDArray[Any], dtype: str) -> str:
    """Numbers for the page's script."""
    return packed(values.astype(dtype).tobytes())
