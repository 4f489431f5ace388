"""One pass for all frames against one render of one frame by Mitsuba's `path`: run `python benchmarks/trace.py`.

Same scene, resolution, samples and depth; kernels warm (the first calls are timed apart). The two take turns, and the
median of the paired ratios is given, so that a busy machine slows both alike. The pass's time includes tessellating the
objects and building the scene; `path` is handed a scene already built.
"""

import argparse
import resource
import statistics
import time
from collections.abc import Callable

import numpy as np

import render
import scenes
from render.variant import mi

TARGET = 1.6


def seconds(work: Callable[[int], object], seed: int) -> float:
    start = time.perf_counter()
    work(seed)
    return time.perf_counter() - start


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="bench")
    parser.add_argument("--resolution", type=int, nargs=2, default=(640, 480))
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--depth", type=int, default=3)
    parser.add_argument("--pairs", type=int, default=7)
    chosen = parser.parse_args()
    scene = scenes.load(
        chosen.scene,
        {
            "camera.resolution": list(chosen.resolution),
            "sampling.samples": chosen.samples,
            "sampling.depth": chosen.depth,
        },
    )
    judge = render.mitsuba_scene(scene)

    def one_pass(seed: int) -> None:
        render.trace(scene, seed=seed)

    def one_frame(seed: int) -> None:
        np.array(mi.render(judge, spp=chosen.samples, seed=seed))

    print(f"cold: pass {seconds(one_pass, 0):.2f} s, path {seconds(one_frame, 0):.2f} s")
    pairs = [
        (seconds(one_pass, seed), seconds(one_frame, seed)) for seed in range(1, chosen.pairs + 1)
    ]
    ratio = statistics.median(ours / theirs for ours, theirs in pairs)
    ours, theirs = (statistics.median(times) for times in zip(*pairs, strict=True))
    print(
        f"warm: pass {ours:.2f} s for {len(scene.patterns.frames())} frames, path {theirs:.2f} s for one: "
        f"ratio {ratio:.2f} (target {TARGET})"
    )
    # Linux counts kilobytes.
    print(
        f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:.2f} GB, path's included"
    )
    return 0 if ratio <= TARGET else 1


if __name__ == "__main__":
    raise SystemExit(main())
