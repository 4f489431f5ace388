"""What `uncertainty="by-cause"` covers and what it costs, by scene and region: the table of docs/decoding.md.

    python docs/make_validity_table.py [ROW ...]

Each row is a scene, or a variant of one, rendered and exposed with seed 0 and decoded with and without causes. Counted are lit
pixels, without the two outermost rows and columns. The constants were chosen on the rows of `TUNED`; those of `HELD_OUT` were
rendered afterwards and measured once.
"""

import sys
import warnings
from typing import Any

import numpy as np

import decode
import render
import scenes

EDGE_PX, SIGMAS, FEWEST = 2, 5.0, 300
# Shares that are too large: beyond 5 total sigma on matt surfaces, mask and paste; on grains and metal; and good pixels lost.
MATT, ROUGH, LOST = 0.01, 0.05, 0.1
ROUGH_REGIONS = ("pad", "solder", "flux", "type-3", "type-4", "type-5")
Row = tuple[str, dict[str, Any]]


def _light(x_mm: float, y_mm: float, z_mm: float) -> dict[str, Any]:
    return {"projectors.0.pose": {"origin_mm": [x_mm, y_mm, z_mm]}}


def _size(columns: int, rows: int) -> dict[str, Any]:
    return {"camera.resolution": [columns, rows]}


def _seeds(first: int) -> dict[str, Any]:
    return {f"objects.{2 + 2 * i}.shape.seed": first + i for i in range(3)}


def _thick(*mm: float) -> dict[str, Any]:
    return {f"objects.{i}.shape.size_mm": [8.0, 14.0, z] for i, z in enumerate(mm, 1)}


TUNED: dict[str, Row] = {
    "bench, 480 × 360": ("bench", _size(480, 360)),
    "spi": ("spi", {}),
    "spi, seed 7, 512 × 384": ("spi", _size(512, 384) | {"board.seed": 7}),
    "spi, seed 23, 512 × 384": ("spi", _size(512, 384) | {"board.seed": 23}),
    "spi-four, 400 × 300": ("spi-four", _size(400, 300)),
    "solder-grains, 360 × 270": ("solder-grains", _size(360, 270)),
    "ink-solder, 480 × 360": ("ink-solder", _size(480, 360)),
    "interreflection": ("interreflection", {}),
    "translucent": ("translucent", {}),
    "defocus, 400 × 300": ("defocus", _size(400, 300)),
    "chapter": ("chapter", {}),
    "cap": ("cap", {}),
}
HELD_OUT: dict[str, Row] = {
    "bench, light from 180°, 480 × 360": ("bench", _size(480, 360) | _light(150.0, 0.0, 260.0)),
    "bench, from 60°, 38°, 400 × 300": ("bench", _size(400, 300) | _light(92.0, 159.0, 235.0)),
    "spi, seed 131, 512 × 384": ("spi", _size(512, 384) | {"board.seed": 131}),
    "spi, seed 113, from 130°, 640 × 480": (
        "spi",
        _size(640, 480) | {"board.seed": 113} | _light(32.1, -38.3, 100.0),
    ),
    "spi-four, seed 103, 400 × 300": ("spi-four", _size(400, 300) | {"board.seed": 103}),
    "solder-grains, seeds 33, 320 × 240": ("solder-grains", _size(320, 240) | _seeds(33)),
    "solder-grains, seeds 43, from 135°, 360 × 270": (
        "solder-grains",
        _size(360, 270) | _seeds(43) | _light(40.8, -40.8, 100.0),
    ),
    "solder-grains, seeds 23, from 90°, 360 × 270": (
        "solder-grains",
        _size(360, 270)
        | _seeds(23)
        | {"projectors.0.pose": {"origin_mm": [0.0, -46.6, 100.0], "up": [-1.0, 0.0, 0.0]}},
    ),
    "ink-solder, from 180°, 400 × 300": ("ink-solder", _size(400, 300) | _light(150.0, 0.0, 260.0)),
    "interreflection, from 30°": ("interreflection", _light(-130.0, -75.0, 260.0)),
    "translucent, 0.05, 0.2, 0.5 mm": ("translucent", _thick(0.05, 0.2, 0.5)),
    "defocus, 12 mm aperture, 360 × 270": (
        "defocus",
        _size(360, 270) | {"projectors.0.lens.aperture_mm": 12.0},
    ),
    "chapter, 300 × 225": ("chapter", _size(300, 225)),
    "cap, from 60°, 400 × 300": ("cap", _size(400, 300) | _light(75.0, 130.0, 260.0)),
}


def main(names: list[str]) -> None:
    """Print one row for each scene."""
    print("| scene | region | beyond 5 sensor sigma, % | 5 total sigma | 3 total sigma | lost, % |")
    print("|---|---|---|---|---|---|")
    for rows, said in ((TUNED, " (tuned)"), (HELD_OUT, "")):
        for name, (scene, changes) in rows.items():
            if name in names or not names:
                print(_row(name + said, scenes.load(scene, changes)), flush=True)


def _row(name: str, scene: scenes.Scene) -> str:
    light = render.trace(scene)
    stack, truth = render.expose(light), render.truth(scene, light)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        whole = decode.reconstruct(stack, uncertainty="by-cause")
    doubt = any("of their modulation" in str(one.message) for one in said)
    sensor = decode.reconstruct(stack)
    inner = np.zeros(truth.label.shape, bool)
    inner[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = True
    before = np.abs(sensor.height_mm - truth.height_mm) / sensor.sigma_mm
    after = np.abs(whole.height_mm - truth.height_mm) / whole.total_sigma_mm
    columns: list[list[str]] = []
    for label in truth.labels:
        valid = truth.region(label) & truth.lit & inner & sensor.valid
        if valid.sum() < FEWEST:
            continue
        good, kept = valid & (before <= SIGMAS), valid & whole.valid
        beyond = ["none left", "-"]
        if kept.sum() >= FEWEST:
            limit = ROUGH if label in ROUGH_REGIONS else MATT
            beyond = [_percent(after[kept] > SIGMAS, 2, limit), _percent(after[kept] > 3.0, 1)]
        lost = _percent(~whole.valid[good], 1, LOST) if good.sum() >= FEWEST else "few good"
        columns.append([label, _percent(before[valid] > SIGMAS, 1), *beyond, lost])
    cells = [", ".join(cell) for cell in zip(*columns, strict=True)]
    return f"| {name}{'; warned' if doubt else ''} | {' | '.join(cells)} |"


def _percent(true: np.ndarray, digits: int, limit: float = 1.0) -> str:
    """How many are true, in per cent; bold above the limit."""
    text = f"{100.0 * true.mean():.{digits}f}"
    return f"**{text}**" if true.mean() > limit else text


if __name__ == "__main__":
    main(sys.argv[1:])
