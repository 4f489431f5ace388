"""Pages and contact sheets that show what a fringebench EXR file holds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import decode
import scenes
from evaluation.output.inspector import Inspector
from evaluation.output.plots import save, symmetric
from evaluation.output.report import Block, Grid, Listing, Picture, Report, Section, Surface
from evaluation.output.scene_pictures import reason_panel
from evaluation.output.sheet import (
    CLIPPED,
    Panel,
    contact_sheet,
    gray_limits,
    normals_as_colours,
    panel_figure,
)
from evaluation.scoring.regions import height_error_mm
from scenes.files.exr import kind_of
from scenes.support.errors import FileError

SUFFIXES = (".html", ".png")
# Maximum number of frames drawn of one exposure.
FRAMES_SHOWN = 24
MILLI = 1e3
UM_PER_MM = 1e3


@dataclass(frozen=True, eq=False)
class FileView:
    """What a file holds."""

    kind: str
    facts: Sequence[Sequence[str]]
    panels: Sequence[Panel]
    scene: str = ""
    """TOML of the scene, if the file has it."""
    surface: Surface | None = None
    inspector: Inspector | None = None
    columns: int | None = None
    """Panels in a row; None: an image each."""


def read_view(path: str | Path, truth: str | Path | None = None) -> FileView:
    """What a fringebench EXR file holds; the `truth` file of a reconstruction adds its errors. Raises `FileError`."""
    kind = kind_of(path)
    if truth is not None and kind != "reconstruction":
        raise FileError(
            f"'{path}' is a {kind} file: only a reconstruction can be compared with a truth"
        )
    if kind == "reconstruction":
        return _reconstruction(
            decode.Reconstruction.read(path), None if truth is None else scenes.Truth.read(truth)
        )
    viewers: dict[str, Callable[[str | Path], FileView]] = {
        "transport": _transport,
        "stack": _stack,
        "truth": _truth,
    }
    if kind not in viewers:
        raise FileError(f"'{path}' is a {kind} file: this version cannot show it")
    return viewers[kind](path)


def write_view(shown: FileView, path: str | Path, output: str | Path) -> None:
    """Write the view of file `path` as .html or .png; raises `FileError`."""
    name = Path(path).name
    suffix = Path(output).suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(f"'{output}': a view is written as {' or '.join(SUFFIXES)}")
    if suffix == ".png":
        save(contact_sheet(shown.panels, f"{name} ({shown.kind})", shown.columns), output)
        return
    blocks: list[Block] = []
    if shown.columns:  # frames: many images of one kind
        for start in range(0, len(shown.panels), shown.columns):
            sheet = contact_sheet(
                shown.panels[start : start + shown.columns], columns=4, thumb_px=280
            )
            blocks.append(Picture(sheet, "Frames on the scale of digital numbers.", wide=True))
    else:
        blocks = [Picture(panel_figure(p), p.caption or f"{p.title}.") for p in shown.panels]
    if shown.surface is not None:
        blocks.append(shown.surface)
    if shown.inspector is not None:
        blocks.append(shown.inspector)
    sections = [
        Section("What it is", [Grid(["", "value"], shown.facts, words=True)]),
        Section("Images", blocks),
    ]
    if shown.scene:
        sections.append(Section("Scene", [Listing("The scene as TOML", shown.scene)]))
    Report(f"{name} ({shown.kind})", str(Path(path)), sections).write(output)


def _transport(path: str | Path) -> FileView:
    from render import Transport

    light = Transport.read(path)
    panels = [_labels(light.label, light.labels)]
    if light.ambient.any():
        panels.append(Panel("Ambient light", light.ambient * MILLI, "mW/(m² sr)", "gray"))
    for p, basis in enumerate(light.bases):
        tables = 0
        for c, channel in enumerate(basis.channels):
            total, direct = (images[p, c] for images in (light.total, light.direct))
            name = "white" if channel.kind == "one" else channel.name
            if channel.kind == "table":
                name, tables = f"table {tables}", tables + 1
            title = f"Projector {p}: {name}"
            if channel.kind == "one":
                with np.errstate(divide="ignore", invalid="ignore"):
                    bright = np.where(total > 0, np.log10(total), np.nan)
                    share = np.where(total > 0, direct / total, np.nan)
                panels += [
                    Panel(
                        title, bright, "log₁₀ W/(m² sr)", "gray",
                        caption="Light returned from a white pattern, on a logarithmic scale.",
                    ),
                    Panel(
                        f"Projector {p}: direct share", share, "share", limits=(0.0, 1.0),
                        caption="Share of light that was scattered once; the rest has met more surfaces.",
                    ),
                ]  # fmt: skip
            else:
                panels.append(
                    Panel(
                        title, total, "W/(m² sr)", "RdBu_r", symmetric(total),
                        caption="Response to one function of the pattern basis.",
                    )
                )  # fmt: skip
    facts = [
        *_about(light.scene.name, light.ambient.shape),
        ["basis channels", ", ".join(str(len(b.channels)) for b in light.bases)],
        ["frames", str(len(light.scene.frames))],
        ["light paths per pixel", str(light.samples)],
        ["depth", f"{light.depth} surfaces"],
        ["seed", str(light.seed)],
    ]
    return FileView("transport", facts, panels, scenes.dumps(light.scene))


def _stack(path: str | Path) -> FileView:
    stack = scenes.Stack.read(path)
    exposures, frames = stack.frames.shape[:2]
    shown = range(min(frames, FRAMES_SHOWN))
    limits = gray_limits(stack)
    panels = [
        Panel(
            f"{stack.exposure_ms[e]:.3g} ms, {_name(stack.patterns[f])}",
            stack.frames[e, f],
            cmap=CLIPPED,
            limits=limits,
        )
        for e in range(exposures)
        for f in shown
    ]
    clipped = [float((stack.frames[e] >= stack.saturation_dn).mean()) for e in range(exposures)]
    facts = [
        *_about("", stack.frames.shape[2:]),
        ["frames", f"{frames}" + (f", the first {len(shown)} drawn" if frames > len(shown) else "")],
        ["gray scale", f"black 0, white {limits[1]:.5g} DN; saturated pixels are orange"],
        *(
            [f"exposure {e}", f"{time_ms:.4g} ms, {100 * share:.2f} % saturated"]
            for e, (time_ms, share) in enumerate(zip(stack.exposure_ms, clipped, strict=True))
        ),
        ["sensor", f"{stack.sensor.kind}, {stack.frames.dtype}, saturated from {stack.saturation_dn:g} DN"],
        ["calibration", "none" if stack.calibration is None else "camera and "
         f"{len(stack.calibration.projectors)} projector(s)"],
        ["seed", "none" if stack.seed is None else str(stack.seed)],
    ]  # fmt: skip
    inspector = Inspector(panels[:: len(shown)][:4], stack)
    return FileView("stack", facts, panels, stack.scene, None, inspector, columns=len(shown))


def _truth(path: str | Path) -> FileView:
    truth = scenes.Truth.read(path)
    panels = [
        Panel("Height", truth.height_mm, "mm"),
        _labels(truth.label, truth.labels),
        Panel(
            "Normal", normals_as_colours(truth.normal),
            caption="Surface normals as colours: red to the right, green up, blue towards +z.",
        ),
    ]  # fmt: skip
    for p in range(len(truth.lit_by)):
        panels += [
            Panel(f"Lit by projector {p}", truth.lit_by[p].astype(np.uint8), names=("no", "yes")),
            Panel(f"Column of projector {p}", truth.columns_px[p], "px"),
            Panel(f"Row of projector {p}", truth.rows_px[p], "px"),
            Panel(
                f"Projector {p}: direct share",
                truth.direct_fractions[p],
                "share",
                limits=(0.0, 1.0),
            ),
        ]
    height = truth.height_mm
    seen = height[np.isfinite(height)]
    facts = [
        *_about("", height.shape),
        ["labels", ", ".join(truth.labels)],
        ["heights", f"{seen.min():.4f} to {seen.max():.4f} mm" if seen.size else "none in view"],
        ["projectors", str(len(truth.lit_by))],
    ]
    caption = "True heights; drag to turn, hover for pixel and height."
    surface = Surface(height, None, truth.xyz_mm, caption) if seen.size else None
    return FileView("truth", facts, panels, truth.scene, surface)


def _reconstruction(rec: decode.Reconstruction, truth: scenes.Truth | None) -> FileView:
    height = np.where(rec.valid, rec.height_mm, np.nan)
    note = rec.order_note and f" {rec.order_note}"
    caption = f"Measured height; gray pixels were rejected.{note}"
    # Pixels of which nothing but the order is unknown have a shape.
    known = rec.valid | (rec.reason == decode.Reason.ORDER_UNKNOWN)
    relative = bool(note) and not rec.valid.any()
    shape = np.where(known, rec.height_mm, np.nan) if relative else height
    title = "Height up to whole fringes" if relative else "Height"
    panels = [Panel(title, shape, "mm", caption=caption)]
    if truth is not None:
        error = height_error_mm(rec, truth) * UM_PER_MM
        title = "Height error (measured − true)"
        panels.append(Panel(title, error, "µm", "RdBu_r", symmetric(error)))
    panels.append(reason_panel(rec))
    if rec.phases:
        panels += [
            Panel("Wrapped phase", rec.wrapped_rad, "rad", "twilight", (-np.pi, np.pi)),
            Panel(
                "Phase up to whole turns" if note else "Absolute phase",
                np.where(known if note else rec.valid, rec.phase_rad, np.nan),
                "rad",
            ),
        ]
    panels += [
        Panel(title, values, unit)
        for title, values, unit in (
            ("Modulation B", rec.modulation_dn, "DN"),
            ("Offset A", rec.offset_dn, "DN"),
            (
                "Predicted standard deviation",
                np.where(rec.valid, rec.sigma_mm, np.nan) * UM_PER_MM,
                "µm",
            ),
        )
        if np.isfinite(values).any()
    ]
    if rec.slope is not None:
        panels += [
            Panel(f"Slope ∂z/∂{axis}", np.where(rec.valid, values, np.nan) * 1e6, "µrad")
            for axis, values in zip("xy", rec.slope, strict=True)
        ]
    if (rec.exposure < 255).any():
        used = np.where(rec.exposure == 255, 0, rec.exposure.astype(np.uint16) + 1)
        taken = range(int(rec.exposure[rec.exposure < 255].max()) + 1)
        panels.append(Panel("Exposure used", used, names=("several, none", *map(str, taken))))
    facts = [
        *_about("", height.shape),
        ["valid", f"{100 * float(rec.valid.mean()):.2f} %"],
        *([["caution", rec.order_note]] if note else []),
        *(
            [f"rejected: {n}", f"{100 * f:.2f} %"]
            for n, f in rec.reason_fractions().items()
            if n != "ok"
        ),
        *(
            [str(k), str(v)]
            for k, v in (rec.settings | rec.settings.get("resolved", {})).items()
            if v is not None and k != "resolved"
        ),
    ]
    surface = None
    if rec.calibration is not None and rec.valid.any():
        tail = "" if truth is None else ", truth and error"
        surface = Surface(
            height, None if truth is None else truth.height_mm, rec.xyz_mm,
            f"Measured heights; drag to turn, hover for pixel, height{tail}.{note}",
        )  # fmt: skip
    return FileView("reconstruction", facts, panels, surface=surface)


def _about(name: str, shape: tuple[int, ...]) -> list[list[str]]:
    rows = [["scene", name]] if name else []
    return [*rows, ["image", f"{shape[1]} × {shape[0]} px (columns × rows)"]]


def _labels(label: NDArray[np.uint16], labels: tuple[str, ...]) -> Panel:
    return Panel("Label", label, names=("nothing", *labels))


def _name(frame: scenes.Frame) -> str:
    if frame.kind in ("white", "black"):
        return frame.kind
    if frame.kind == "gray":
        return f"{frame.axis} bit {frame.step}{' inverse' if frame.inverted else ''}"
    return f"{frame.axis} {frame.period_px:g} px, {frame.step}/{frame.steps}"
