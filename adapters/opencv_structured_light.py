"""OpenCV's structured_light module as an outside decoder: Gray code and three-step sinusoids.

    python opencv_structured_light.py MANIFEST OUTPUT.npz [EXPOSURE]

Needs opencv-contrib-python-headless, which cannot share an environment with opencv-python-headless: give it one of its own.
Reads a folder that `fringebench export` wrote (8-bit frames) and knows nothing else of the project. The output holds, for
what the manifest shows,

- ``column_px``, ``row_px``: the Gray code's projector pixel plus half, NaN where OpenCV reports an error;
- ``phase_<axis>_<period>_rad``: wrapped phase of each three-step set, NaN in OpenCV's shadow mask.

OpenCV's own sinusoids are ``sin(2 pi x / P + 2 pi k / 3)`` and it returns the sine's argument less a quarter turn, which is
the cosine's: frames ``cos(phi + 2 pi k / 3)`` give phi back. Its phase map is not local: it filters, so that one changed pixel
changes thousands, and even noise-free 8-bit fringes come back 0.002 rad (RMS) off the three-step formula.
"""

import sys
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

# Smallest difference of a frame and its inverse, DN: OpenCV's default.
WHITE_THRESHOLD = 5


def main(manifest: Path, output: Path, exposure: int) -> None:
    """Decode one exposure of an exported stack."""
    tree = tomllib.loads(manifest.read_text("utf-8"))
    times = len(tree["exposures_ms"])
    count = len(tree["files"]) // times
    names = tree["files"][exposure * count : (exposure + 1) * count]
    images = [cv2.imread(str(manifest.parent / name), cv2.IMREAD_UNCHANGED) for name in names]
    if images[0].dtype != np.uint8:
        raise SystemExit("structured_light reads 8-bit frames: expose with a sensor of 8 bits")
    size = tree["projector_resolution"]
    found: dict[str, Any] = {}
    gray: dict[str, list[Any]] = {}
    at = 0
    for shown in tree["frames"]:
        if shown["kind"] == "gray":
            length = 2 * shown["bits"]
            usual = shown.get("inverse", "after-each") == "after-each"
            if not usual or shown.get("order", "coarse-first") != "coarse-first":
                raise SystemExit(
                    "structured_light reads Gray code coarse first, each with its inverse"
                )
            if shown.get("cell_px", 1.0) != 1.0:
                raise SystemExit("structured_light reads Gray code of one pixel a cell")
            gray[shown["axis"]] = images[at : at + length]
        elif shown["kind"] == "fringes":
            length = shown["steps"]
            plain = "shifts_deg" not in shown and not shown.get("first_phase_deg")
            if length == 3 and plain and shown.get("direction", 1) == 1:
                name = f"phase_{shown['axis']}_{shown['period_px']:g}_rad"
                found[name] = phase(images[at : at + 3], shown, size)
        else:
            length = shown.get("count", 1)
        at += length
    if set(gray) == {"column", "row"}:
        found |= code(gray["column"] + gray["row"], size)
    if not found:
        raise SystemExit(
            "nothing here for structured_light: Gray code of both axes, or three steps"
        )
    np.savez(output, **found)


def code(images: list[Any], size: list[int]) -> dict[str, Any]:
    """Projector pixels (row, col) by `GrayCodePattern.getProjPixel`."""
    pattern = cv2.structured_light.GrayCodePattern.create(size[0], size[1])
    if pattern.getNumberOfPatternImages() != len(images):
        raise SystemExit(
            f"structured_light expects {pattern.getNumberOfPatternImages()} frames for {size}, here are {len(images)}"
        )
    pattern.setWhiteThreshold(WHITE_THRESHOLD)
    rows, columns = images[0].shape
    pixels = np.full((rows, columns, 2), np.nan)
    for y in range(rows):
        for x in range(columns):
            wrong, at = pattern.getProjPixel(images, x, y)
            if not wrong:
                pixels[y, x] = at
    return {"column_px": pixels[..., 0] + 0.5, "row_px": pixels[..., 1] + 0.5}


def phase(images: list[Any], shown: dict[str, Any], size: list[int]) -> Any:
    """Wrapped phase (row, col) by `SinusoidalPattern`, phase-shifting profilometry."""
    make = cv2.structured_light_SinusoidalPattern_Params
    params = make()
    params.width, params.height = size
    across = size[0] if shown["axis"] == "column" else size[1]
    params.nbrOfPeriods = max(1, round(across / shown["period_px"]))
    params.shiftValue = 2.0 * np.pi / 3.0
    params.methodId = 1
    params.horizontal = shown["axis"] == "row"
    params.setMarkers = False
    pattern = cv2.structured_light_SinusoidalPattern.create(params)
    wrapped, mask = pattern.computePhaseMap(images)
    return np.where(mask > 0, wrapped, np.nan)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) == 4 else 0)
