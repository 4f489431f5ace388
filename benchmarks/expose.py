"""Exposing: time for each frame and megapixel, against NumPy's own Poisson and normal draws of as many pixels.

The draws run in one thread per core, as `expose` does with frames: a lower bound for an exact sensor with that generator.
Memory: the float32 channels read and the counts written, compared with a copy.
"""

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import render
from benchmarks.light import scene
from benchmarks.result import Result, main
from benchmarks.turns import Copy, take_turns


def measure(quick: bool) -> list[Result]:
    """EMVA sensor, one exposure of 12 frames."""
    size, rounds = ((640, 480), 3) if quick else ((1280, 960), 5)
    light = render.trace(scene(size=size, samples=4), seed=1)
    time_ms = render.expose(light, noise=False).exposure_ms[1]
    mean = float(light.frames().mean())
    sensor = light.scene.sensor
    electrons = (sensor.mean_dn(mean, time_ms) - sensor.black_level_dn) / sensor.gain_dn_per_e  # type: ignore[union-attr]
    frames, pixels = len(light.scene.frames), size[0] * size[1]
    pool = ThreadPoolExecutor(os.cpu_count())

    def draw(frame: int) -> None:
        rng = np.random.default_rng(frame)
        rng.poisson(electrons, pixels)
        rng.standard_normal(pixels, dtype=np.float32)

    def plain() -> None:
        for _ in pool.map(draw, range(frames)):
            pass

    def exposed(noise: bool) -> int:
        return render.expose(light, seed=1, exposures=[time_ms], noise=noise).frames.nbytes

    copy = Copy(light.total.nbytes)
    turns = take_turns([lambda: exposed(True), plain, lambda: exposed(False), copy], rounds)
    moved = 1e-9 * (light.total.nbytes + exposed(False))
    amounts = [moved, moved, moved, copy.moved_gb]
    each = frames * pixels / 1e6
    wall, processor = (1e3 * np.median(t, axis=0) / each for t in (turns.wall_s, turns.processor_s))
    note = (
        f"bench, {size[0]} x {size[1]}, {frames} frames, EMVA 12 bits, {float(electrons):.0f} electrons on average; "
        f"without noise {wall[2]:.1f} ms"
    )
    result = turns.compared("", "NumPy's Poisson and normal draws alone", reads="x baseline")
    row = Result(
        "one frame, of a megapixel",
        float(wall[0]),
        "ms",
        result.baseline,
        float(wall[1]),
        result.ratio,
        "x baseline",
        float(processor[0]),
        float(processor[1]),
        result.processor_ratio,
        note=note,
    )
    return [
        row,
        turns.rate(
            "channels read, counts written", "copy of the channels", amounts, "GB/s", theirs=3, note=note
        ),
        turns.rate(
            "the same without noise", "copy of the channels", amounts, "GB/s", ours=2, theirs=3, note=note
        ),
    ]  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main("expose", __doc__, measure))
