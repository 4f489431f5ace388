"""Make the gallery again: every shipped scene rendered, decoded and scored, its picture and its table.

``python docs/make_gallery.py [SCENE ...]`` writes ``docs/gallery/*.webp`` and ``docs/gallery.md`` (all scenes unless some
are named; the page is put together from all scores kept in ``docs/gallery/scores.json``).
"""

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

import scenes
from evaluation.sheet import Panel, contact_sheet
from fringebench.run import Run, run

DOCS = Path(__file__).parent
FOLDER = DOCS / "gallery"
SCORES = FOLDER / "scores.json"
UM_PER_MM = 1000.0
WEBP_QUALITY = 80

HEAD = """\
# Gallery

Every shipped scene: what the camera sees (mean of the middle exposure's frames), the height measured, and the error. Scores
are of `fringebench run SCENE`, seed 0, with the default fusion (max-modulation). Made by `python docs/make_gallery.py`.

RMS and predicted: root mean square error, and what the decoder expects of noise alone. Outliers: errors beyond five
predicted standard deviations. One exposure: RMS of the middle exposure with saturation ignored.
"""

TEACHES = {
    "bench": "Start here. One exposure is silently wrong on solder; three mend most of it. What is left there is light that "
    "met two domes, and the decoder does not know of it.",
    "cap": "The reference: little but noise, and the prediction says how much.",
    "step": "Beside a step the projector does not reach: an honest decoder gives no height there.",
    "ink": "The exposure that suits the ink ruins the paint for a decoder that does not look for saturation. With both "
    "exposures each surface has its own.",
    "solder": "Highlights clip. Unnoticed, that costs five times the error of three exposures.",
    "ink-solder": "Why several exposures: unnoticed saturation makes 4 µm on solder into 111, and the ink needs the light.",
    "interreflection": "Error without noise: light by way of the other side of the groove biases heights, and the predicted "
    "deviation does not know it.",
    "mirror": "Nothing to decode, and nothing decoded.",
    "defocus": "Blur lowers contrast, and with it precision: see predicted. A few pixels in a thousand, at the steps' edges, "
    "take a wrong order, and they alone make the RMS.",
    "translucent": "Heights below the surface with a small predicted deviation: the surest way to be wrong.",
    "solder-grains": "Paste is no surface at this scale: heights scatter far beyond the sensor's noise.",
    "spi": "Steep walls and gaps between deposits hold the errors; bare pads are mirrors that few pixels see lit.",
    "spi-four": "What one projector leaves in shadow another lights: heights on 99.7 % of the paste, where any one of the four "
    "alone gives 94 %, and on all of the mask between.",
    "chapter": "34 µm of noise, as the chapter's formula says.",
    "chapter-dim": "Modulation 15 instead of 80 DN: 5.4 times the noise. The default threshold, eight standard deviations of "
    "phase, lets a sixth of the pixels pass; `fringebench chapter` scores all of them.",
    "chapter-trap": "Rejecting clipped samples leaves the highlight empty. The chapter's mask, which asks for modulation "
    "alone, lets it pass with 104 µm of error.",
}


def main(names: list[str]) -> None:
    """Render what is asked for, and write the page."""
    kept: dict[str, Any] = json.loads(SCORES.read_text()) if SCORES.exists() else {}
    for name in names or scenes.shipped():
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
        sys.stdout.write(f"{name}\n")
    SCORES.write_text(json.dumps({n: kept[n] for n in scenes.shipped()}, indent=1) + "\n")
    (DOCS / "gallery.md").write_text(page(kept), "utf-8")


def picture(done: Run) -> bytes:
    """Camera, height and error side by side, as WebP."""
    rec, truth, stack = done.reconstruction, done.truth, done.stack
    light = stack.frames[len(stack.exposure_ms) // 2].mean(axis=0, dtype=np.float64)
    height = np.where(rec.valid, rec.height_mm, np.nan)
    error = (height - truth.height_mm) * UM_PER_MM
    known = np.abs(error[np.isfinite(error)])
    limit = float(np.percentile(known, 98.0)) if known.size else 1.0
    sheet = contact_sheet(
        [
            Panel(
                f"camera, {stack.exposure_ms[len(stack.exposure_ms) // 2]:.3g} ms",
                light,
                "DN",
                "gray",
            ),
            Panel("height (gray: rejected)", height, "mm"),
            Panel("error (measured − true)", error, "µm", "RdBu_r", (-limit, limit)),
        ],
        columns=3,
    )
    canvas = FigureCanvasAgg(sheet)
    canvas.draw()
    image = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
    _, data = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])
    return bytes(data)


def page(kept: dict[str, Any]) -> str:
    """The gallery's Markdown."""
    order = [name for name in TEACHES if name in kept]
    order += [name for name in kept if name not in TEACHES]
    return "\n".join([HEAD, *(_section(name, kept[name]) for name in order)])


def _section(name: str, score: dict[str, Any]) -> str:
    lines = [f"## {name}", "", scenes.load(name).description, ""]
    if name in TEACHES:
        lines += [f"**What it teaches.** {TEACHES[name]}", ""]
    image = f"gallery/{name}.webp"
    lines += [f"[![{name}: camera, height, error]({image}){{ loading=lazy }}]({image})", ""]
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
