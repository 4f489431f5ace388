"""A cap and a step on a plate: 640 x 480, 64 samples, 12 frames, three surface vertices.

Of this scene there is a figure for Blender's Cycles (the PyPI wheel `bpy`): 139 s for the 12 frames on two cores, at equal
scatter. It was measured once, on another day; Blender is not run here, so it is no baseline of the same run.
"""

import numpy as np

import render
from benchmarks.light import Path, scene, seeds, tracing
from benchmarks.quality import P95, SCATTER, STEPS, Judge, phase
from benchmarks.result import Result, main
from benchmarks.turns import take_turns

KEPT = ("base", "cap", "step")
CYCLES_S = 139.0


def measure(quick: bool) -> list[Result]:
    """The pass compared with one frame by `path`."""
    size, rounds = ((160, 120), 3) if quick else ((640, 480), 5)
    shown = scene(size=size)
    shown = shown.model_copy(
        update={"objects": tuple(item for item in shown.objects if item.label in KEPT)}
    )
    draw = seeds(5)
    path = Path(shown, "multijitter")
    turns = take_turns([tracing(shown, draw), path.one_frame(shown.sampling.samples, draw)], rounds)
    frames = [render.trace(shown, seed=draw()).frames()[:STEPS].astype(np.float64) for _ in "ab"]
    # Two runs differ by the errors of both.
    errors = Judge(shown, phase(frames[1])).errors(frames[0])
    taken = float(np.median(turns.wall_s[:, 0]))
    cycles = "" if quick else f", {CYCLES_S / taken:.0f} times ours"
    return [
        turns.compared(
            f"pass, {len(shown.patterns.frames())} frames",
            "path, multijitter, one frame",
            unit="s",
            reads="x baseline",
            note=f"{size[0]} x {size[1]}, 64 samples, depth 3; scatter on flats {1e3 * errors[SCATTER]:.2f} mrad; two runs "
            f"differ by {1e3 * errors[P95]:.2f} mrad (95th percentile). Blender Cycles took {CYCLES_S:.0f} s at 640 x 480, "
            f"once, on two cores, at equal scatter{cycles}; it was not run here",
        )
    ]


if __name__ == "__main__":
    raise SystemExit(main("plate", __doc__, measure))
