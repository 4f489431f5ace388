"""Pictures of a capture: the scene as the camera sees it, sample frames, phases, and reasons for rejected pixels."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy import ndimage

from decode import Reason, Reconstruction
from evaluation.output.plots import map_figure
from evaluation.output.sheet import CLIPPED, Panel, contact_sheet, gray_limits, panel_figure
from scenes.files.stack import Stack
from scenes.files.truth_maps import Truth

# Maximum number of exposures shown.
FRAMES_SHOWN = 6


def scene_picture(stack: Stack, truth: Truth) -> Figure:
    """The scene under even light, from the brightest unsaturated exposure of each pixel, with outlined labels.

    Brightness is logarithmic: black ink and a solder highlight differ a thousandfold.
    """
    light = _radiance(stack)
    known = light[np.isfinite(light) & (light > 0)]
    floor = np.percentile(known, 1) if known.size else 1.0
    shown = np.log10(np.maximum(light, floor))
    figure = map_figure(shown, "The scene from the camera", "log₁₀ (DN / ms)", cmap="gray")
    axes = figure.axes[0]
    for index, label in enumerate(truth.labels):
        mask = truth.label == index + 1
        if not mask.any() or mask.all():
            continue
        if label != "base" and not _is_speckle(mask):
            axes.contour(mask, levels=[0.5], colors="#E69F00", linewidths=0.8)
        row, col = _inside(mask)
        axes.annotate(
            label,
            (col, row),
            color="white",
            ha="center",
            va="center",
            bbox={"boxstyle": "round,pad=0.2", "facecolor": "black", "alpha": 0.6, "linewidth": 0},
        )
    return figure


def _is_speckle(mask: NDArray[np.bool_]) -> bool:
    """Whether a region is mostly outline or full of gaps, as grains of a few pixels are: lines would hide what they outline."""

    def outline(region: NDArray[np.bool_]) -> int:
        return int((region & ~ndimage.binary_erosion(region)).sum())

    own, closed = outline(mask), mask | ndimage.binary_closing(mask, iterations=3)
    return own > 0.5 * mask.sum() or own > 2 * outline(closed)


def frames_picture(stack: Stack) -> Figure:
    """The first frame of every exposure and camera, in DN on one scale; saturated pixels are orange."""
    cameras = [frame.camera for frame in stack.patterns]
    firsts = {c: cameras.index(c) for c in sorted(set(cameras))}
    limits = gray_limits(stack)
    panels = [
        Panel(
            f"{f'camera {c + 1}, ' if len(firsts) > 1 else ''}{stack.exposure_ms[k]:.3g} ms, "
            f"{100 * float((stack.frames[k, f] >= stack.saturation_dn).mean()):.1f} % saturated",
            stack.frames[k, f],
            "DN",
            CLIPPED,
            limits,
        )
        for k in range(len(stack.exposure_ms))
        for c, f in firsts.items()
    ][:FRAMES_SHOWN]
    return contact_sheet(panels, columns=min(3, len(panels)), thumb_px=400)


def phase_figures(rec: Reconstruction) -> tuple[Figure, Figure]:
    """Wrapped and absolute phase of the measuring axis, rejected pixels left out."""
    limits = (-np.pi, np.pi)
    wrapped = map_figure(rec.wrapped_rad, "Wrapped phase", "rad", limits=limits, cmap="twilight")
    absolute = np.where(rec.valid, rec.phase_rad, np.nan)
    return wrapped, map_figure(absolute, "Absolute phase", "rad")


def reason_map(rec: Reconstruction) -> Figure:
    """Map of the reason why each pixel was rejected, with each reason's share."""
    return panel_figure(reason_panel(rec))


def reason_panel(rec: Reconstruction) -> Panel:
    """See `reason_map`; reasons that no pixel has are left out."""
    # Valid first, which is plain gray, also where no pixel is.
    present = [r for r in Reason if r is Reason.OK or (rec.reason == r).any()]
    shares = rec.reason_fractions()
    names = [f"{r.label}\n{100 * shares.get(r.label, 0.0):.2f} %" for r in present]
    index = np.searchsorted([int(r) for r in present], rec.reason)
    return Panel("Valid pixels, and why others were rejected", index, names=names)


def _radiance(stack: Stack) -> NDArray[np.float64]:
    """Mean over the frames of each pixel's brightest unsaturated exposure (else its shortest), in DN per ms."""
    order = np.argsort(stack.exposure_ms)
    light: NDArray[np.float64] | None = None
    for k in order:
        frames = stack.frames[k, : sum(frame.camera == 0 for frame in stack.patterns)]
        here = (
            frames.mean(axis=0, dtype=np.float64) - stack.sensor.black_level_dn
        ) / stack.exposure_ms[k]
        good = frames.max(axis=0) < stack.saturation_dn
        light = here if light is None else np.where(good, here, light)
    assert light is not None
    return light


def _inside(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """A (row, col) well inside the mask: the pixel farthest from its border."""
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, col = np.unravel_index(int(np.argmax(depth)), mask.shape)
    return float(row), float(col)
