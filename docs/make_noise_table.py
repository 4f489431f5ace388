"""Noise of light paths on shipped scenes as they are, from two seeds: the table of docs/light.md.

    python docs/make_noise_table.py [SCENE ...]

Two seeds of light are exposed without the sensor's noise; what their heights differ by, over the root of two, is the noise of
light. Two seeds of the sensor's noise on the first of them give that of the sensor. Both are root mean squares over the lit
pixels of a label that all four reconstructions call valid; with screens of slopes. Pixels that another fringe order or match moves
are counted apart.
"""

import sys
import warnings
from typing import Any

import numpy as np

import decode
import render
import scenes

SEEDS = (1001, 2002)
# Too dark for the decoder's defaults, which is its lesson.
OPTIONS: dict[str, dict[str, Any]] = {
    "chapter-dim": {"min_modulation_dn": 5.0, "max_order_residual": 0.5}
}


def main(names: list[str]) -> None:
    """Print one row for each label of each scene."""
    print("| scene | label | asked for | stated | two seeds | pixels | of another order |")
    print("|---|---|--:|--:|--:|--:|--:|")
    for name in names:
        _rows(name, scenes.load(name))


def _rows(name: str, scene: scenes.Scene) -> None:
    made = render.surfaces(scene)
    lights = [render.trace(scene, seed=seed, surfaces=made) for seed in SEEDS]
    stacks = [render.expose(light, noise=False) for light in lights]
    stacks += [render.expose(lights[0], seed=seed) for seed in SEEDS]
    results = [decode.reconstruct(stack, **OPTIONS.get(name, {})) for stack in stacks]
    truth = render.truth(scene, lights[0])
    # Screens measure slopes, from which heights follow.
    found = np.stack(
        [result.height_mm[None] if result.slope is None else result.slope for result in results]
    )
    found = found.astype(np.float64)
    usable = truth.lit & np.all([result.valid for result in results], axis=0)
    jump = np.zeros_like(usable)
    if not scene.screens:
        # Another fringe or match is a jump of height, far beyond noise.
        jump = (np.ptp(found, axis=0) > _jump_mm(scene))[0]
    stated = {} if lights[0].render_noise is None else lights[0].render_noise.reached
    for label in truth.labels:
        at = usable & truth.region(label)
        good = at & ~jump
        if good.sum() < 100:
            continue
        light, sensor = (
            float(np.sqrt(np.mean((found[i] - found[i + 1])[:, good] ** 2) / 2.0)) for i in (0, 2)
        )
        said, asked = stated.get(label), scene.sampling.render_noise
        print(
            f"| `{name}` | {label} | {'' if asked is None else f'{asked:g}'} | {'' if said is None else f'{said:.2f}'} "
            f"| {light / sensor:.2f} | {int(good.sum())} | {int((at & jump).sum())} |",
            flush=True,
        )


def _jump_mm(scene: scenes.Scene) -> float:
    """Height of half a finest fringe in the middle of the image; of a pair of cameras, of half a pixel."""
    camera = scene.camera.projection()
    axis, width = 0, 1.0
    if scene.second_camera is not None:
        other = scene.second_view().camera.projection()
    else:
        other = scene.projectors[0].projection()
        frame = min((f for f in scene.frames if f.kind == "fringe"), key=lambda f: f.period_px)
        axis, width = ("column", "row").index(frame.axis), frame.period_px
    low, high = (
        other.project(camera.points_at(height))[0][..., axis] for height in (-0.005, 0.005)
    )
    return float(0.01 / np.nanmedian(np.abs(high - low)) * width / 2.0)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main(sys.argv[1:] or list(scenes.shipped()))
