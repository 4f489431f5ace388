"""Make the gallery: every shipped scene rendered, decoded and scored, with its picture and its table.

``python docs/make_gallery.py [SCENE ...]`` writes ``docs/gallery/*.webp`` and ``docs/gallery.md`` for all scenes or the named
ones; the page is made from all scores in ``docs/gallery/scores.json``. With `bench` it also makes the README's picture and
table; with `methods`, the map of methods that the page opens with.
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import scenes
from evaluation.output.sheet import Panel, contact_sheet
from fringebench import methods
from fringebench.experiments.surface_methods import Cell, MethodMap
from fringebench.experiments.whole_run import Run, run
from fringebench.pages.method_map_page import GUIDE, map_figure, map_rows
from fringebench.progress import Steps

DOCS = Path(__file__).parent
FOLDER = DOCS / "gallery"
SCORES = FOLDER / "scores.json"
# The scene in the README, and the surfaces in its table.
FRONT = "bench"
SURFACES = {"base": "matt paint", "ink": "black ink", "solder": "solder"}
README = DOCS.parent / "README.md"
START, END = "<!-- scores -->", "<!-- end of scores -->"
UM_PER_MM = 1000.0
MAP = "methods"
MAP_LEAD = """\
No method measures every surface. This is `fringebench methods`: fringe projection, [stereo](stereo.md) by phase, with dots and by the
surface's own texture, and [deflectometry](deflectometry.md), all with one camera of 200 × 150 pixels at 300 mm, three exposures, seed 0. No
object has a printed texture, so passive stereo finds little to match, except on grains. A clear body is measured by none: its light comes from
the bottom, and few of the heights are rejected. What is wrong in a tenth of the pixels of `step` are its edges."""
WEBP_QUALITY = 80

HEAD = """\
# Gallery

For every shipped scene: the camera's image (mean of the frames of the middle exposure), the measured height, and the error. The
scores are those of `fringebench run SCENE`, seed 0, with the default fusion (max-modulation). This page is made by
`python docs/make_gallery.py`.

RMS: root mean square error. Predicted: the standard deviation that the decoder expects from noise alone. Outliers: errors above
five predicted standard deviations. One exposure: RMS of the middle exposure with saturation ignored.

The cameras of `emva1288` sensors blur by diffraction, 3.3 pixels across at f/8. A perfectly sharp lens (`--set sensor.psf=none`) would
have RMS errors of 3.1 instead of 4.3 µm on the base of `bench`, 4.6 instead of 9.2 on its ink and 9.1 instead of 17.1 on its
solder, 2.4 instead of 9.3 µm on `ink`; errors of pad volumes would be −0.9 instead of −2.3 % on `spi-four` and +0.9 instead of −6.2 %
on `spi`. Blur acts next to edges and on solder, where brightness changes within a fringe.
"""

LESSONS = {
    "bench": "Start here. With one exposure the heights on solder are silently wrong; three exposures remove most of the error. "
    "The rest comes from the lens's blur and from light reflected by two domes, which the decoder does not detect.",
    "cap": "The reference: noise, whose size the prediction gives, and blur where brightness changes.",
    "step": "The projector's light does not arrive next to the step: a correct decoder gives no height there.",
    "ink": "At the exposure that suits the ink the paint is saturated: a decoder that does not test for saturation is wrong "
    "there. With both exposures each surface has its own.",
    "solder": "Highlights clip. If this is not detected, the error is four times that with three exposures.",
    "ink-solder": "Why several exposures are needed: undetected saturation increases the error on solder from 9 to 97 µm, and "
    "the ink needs the light.",
    "interreflection": "Error without noise: light reflected by the other side of the groove biases the heights, and the "
    "predicted deviation does not contain it.",
    "mirror": "There is nothing to decode, and nothing is decoded but for some pixels at the rim, to which blur brings the base's light.",
    "mirror-deflectometry": "The same plate by [deflectometry](deflectometry.md): all of it is measured, with slopes to 13 µrad. The "
    "board around it shows no image of the screen, and gets no height.",
    "lens-deflectometry": "A lens surface by [deflectometry](deflectometry.md): single heights scatter by 18 µm, slopes by 18 µrad. With "
    "`--height integration` the heights of neighbours fit to some nanometres.",
    "dome-deflectometry": "The steeper a mirror, the larger and closer the screen has to be, and the less precise slopes are: the distance "
    "between the positions sets both.",
    "matt-deflectometry": "Where deflectometry fails: the cap mixes light of the whole screen, so it shows no image of it, and the decoder says "
    "so (`no-image`). The mirror next to it is measured.",
    "defocus": "Blur lowers contrast and therefore precision (see predicted). A few pixels in a thousand, at the edges of the "
    "steps, get a wrong order, and these alone determine the RMS.",
    "translucent": "Heights below the surface with a small predicted deviation: a large error that nothing indicates.",
    "solder-grains": "At this scale paste is not a surface: the scatter of heights is much larger than the sensor's noise.",
    "spi": "The errors are at steep walls and gaps between deposits; bare pads are mirrors, and few of their pixels receive "
    "light that reaches the camera.",
    "spi-four": "Each projector illuminates shadows of the others: all of the paste gets a height, with any single projector "
    "94 %; and so does all of the mask in between.",
    "stereo": "Two cameras find heights without any calibrated projector, and within one picture. Dots give the gray half a texture; "
    "with even light 99 to 100 % of it is missing or wrong ([stereo](stereo.md)). No deviation is predicted.",
    "measured-rig": "A real scanner's optics ([measured](measured-rig.md)): its projector is in focus within a few centimetres only. "
    "Elsewhere fringes lose contrast and orders contradict each other. Its pixels are so quiet that most of the error is the "
    "renderer's own noise, up to 8 times the sensor's ([render noise](light.md)).",
    "chapter": "34 µm of noise, as the chapter's formula predicts.",
    "chapter-dim": "Modulation 15 instead of 80 DN: 5.4 times the noise. The default threshold, eight standard deviations of "
    "phase, accepts a sixth of the pixels; `fringebench chapter` scores all of them.",
    "chapter-trap": "If clipped samples are rejected, the highlight has no heights. The chapter's mask, which tests only the "
    "modulation, accepts it with an error of 104 µm.",
}


def main(names: list[str]) -> None:
    """Render the named scenes (all if none is named) and write the page."""
    kept: dict[str, Any] = json.loads(SCORES.read_text()) if SCORES.exists() else {}
    if not names or MAP in names:
        found = methods(steps=Steps())
        (FOLDER / f"{MAP}.json").write_text(json.dumps(found.to_dict(), indent=1) + "\n")
        (FOLDER / f"{MAP}.webp").write_bytes(_encoded(map_figure(found)))
    for name in [name for name in names if name != MAP] if names else scenes.shipped():
        with tempfile.TemporaryDirectory() as folder:
            done = run(scenes.load(name), folder)
            kept[name] = {
                label: {
                    "coverage": region.coverage,
                    "rms_mm": region.rms_mm,
                    "predicted_sd_mm": region.predicted_sd_mm,
                    "outlier_fraction": region.outlier_fraction,
                    "naive_rms_mm": done.naive.regions[label].rms_mm,
                }
                for label, region in done.score.regions.items()
            }
            (FOLDER / f"{name}.webp").write_bytes(picture(done))
            if name == FRONT:
                (FOLDER / "front.webp").write_bytes(front_picture(done))
        sys.stdout.write(f"{name}\n")
    SCORES.write_text(json.dumps({n: kept[n] for n in scenes.shipped()}, indent=1) + "\n")
    (DOCS / "gallery.md").write_text(page(kept), "utf-8")
    before, _, rest = README.read_text("utf-8").partition(START)
    README.write_text(before + front_table(kept[FRONT]) + rest.partition(END)[2], "utf-8")


def picture(done: Run) -> bytes:
    """Camera, height and error side by side, as WebP."""
    middle = len(done.stack.exposure_ms) // 2
    own = sum(frame.camera == 0 for frame in done.stack.patterns)
    light = done.stack.frames[middle, :own].mean(axis=0, dtype=np.float64)
    title = f"camera, {done.stack.exposure_ms[middle]:.3g} ms"
    return _webp([Panel(title, light, "DN", "gray"), *_results(done)])


def front_picture(done: Run) -> bytes:
    """One fringe frame, height and error side by side, as WebP."""
    middle = len(done.stack.exposure_ms) // 2
    frame = done.stack.frames[middle][0].astype(np.float64)
    count = len(done.stack.exposure_ms) * len(done.stack.patterns)
    return _webp([Panel(f"one of {count} raw frames", frame, "DN", "gray"), *_results(done)])


def _results(done: Run) -> list[Panel]:
    rec = done.reconstruction
    height = np.where(rec.valid, rec.height_mm, np.nan)
    error = (height - done.truth.height_mm) * UM_PER_MM
    known = np.abs(error[np.isfinite(error)])
    limit = float(np.percentile(known, 98.0)) if known.size else 1.0
    return [
        Panel("height (gray: rejected)", height, "mm"),
        Panel("error (measured − true)", error, "µm", "RdBu_r", (-limit, limit)),
    ]


def _webp(panels: list[Panel]) -> bytes:
    return _encoded(contact_sheet(panels, columns=3))


def _encoded(figure: Figure) -> bytes:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
    _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    return bytes(data)


def front_table(score: dict[str, Any]) -> str:
    """The README's table: RMS errors with one exposure and with all, next to the prediction."""
    lines = [
        START,
        "| surface | predicted from noise | one exposure, saturation ignored | three exposures, fused |",
    ]
    lines += ["|---|--:|--:|--:|"]
    for label, surface in SURFACES.items():
        names = ("predicted_sd_mm", "naive_rms_mm", "rms_mm")
        cells = [_number(score[label][name], UM_PER_MM, 1) for name in names]
        lines.append(f"| {surface} | {' | '.join(cells)} |")
    return "\n".join([*lines, END])


def page(kept: dict[str, Any]) -> str:
    """The gallery's Markdown."""
    order = [name for name in LESSONS if name in kept]
    order += [name for name in kept if name not in LESSONS]
    return "\n".join([HEAD, *_map_section(), *(_section(name, kept[name]) for name in order)])


def _map_section() -> list[str]:
    """The map of methods, as `fringebench methods` makes it."""
    data = json.loads((FOLDER / f"{MAP}.json").read_text("utf-8"))
    found = MethodMap(tuple(Cell(**cell) for cell in data["cells"]), tuple(data["resolution"]))
    names, rows = map_rows(found)
    image = f"gallery/{MAP}.webp"
    lines = ["## Which method for which surface", "", MAP_LEAD, "", GUIDE, ""]
    lines += [f"[![share of each surface that each method measures]({image})]({image})", ""]
    lines += [f"| surface | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    lines += [f"| {' | '.join(cell.replace(chr(10), ', ') for cell in row)} |" for row in rows]
    return [*lines, ""]


def _section(name: str, score: dict[str, Any]) -> str:
    lines = [f"## {name}", "", scenes.load(name).description, ""]
    if name in LESSONS:
        lines += [f"**Lesson.** {LESSONS[name]}", ""]
    image = f"gallery/{name}.webp"
    lines += [f"[![{name}: camera, height, error]({image}){{loading=lazy}}]({image})", ""]
    lines += ["| region | valid % | RMS µm | predicted µm | outliers % | one exposure: RMS µm |"]
    lines += ["|---|--:|--:|--:|--:|--:|"]
    for label, region in score.items():
        cells = (
            _number(region["coverage"], 100, 1),
            _number(region["rms_mm"], UM_PER_MM, 1),
            _number(region["predicted_sd_mm"], UM_PER_MM, 1),
            _number(region["outlier_fraction"], 100, 2),
            _number(region["naive_rms_mm"], UM_PER_MM, 1),
        )
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _number(value: float | None, scale: float, digits: int) -> str:
    return "–" if value is None else f"{round(value * scale, digits) + 0.0:.{digits}f}"


if __name__ == "__main__":
    main(sys.argv[1:])
