"""One pass for all frames against one render of one frame by Mitsuba's `path`, at equal samples.

Scene `bench`, 640 x 480, 64 samples, three surface vertices, 12 frames; kernels warm. `path` is given each of the samplers a
careful user would consider. The pass's time includes tessellating the objects and building the scene; `path` is handed a
scene already built.
"""

import scenes
from benchmarks.light import Path, scene, seeds, tracing
from benchmarks.result import Result, Target, main
from benchmarks.turns import take_turns

SAMPLERS = ("independent", "multijitter")
TARGET = Target("ratio", "at most", 1.6)


def measure(quick: bool) -> list[Result]:
    """The pass compared with `path` and each sampler."""
    size, samples, rounds = ((320, 240), 16, 3) if quick else ((640, 480), 64, 7)
    note = f"bench, {size[0]} x {size[1]}, {samples} samples, depth 3; {rounds} rounds"
    return compared_with_path(scene(size=size, samples=samples), 1, rounds, TARGET, note)


def compared_with_path(
    shown: scenes.Scene, seed: int, rounds: int, target: Target, note: str
) -> list[Result]:
    """A pass for all frames in turns with one frame by `path`, with each sampler."""
    samples, draw = shown.sampling.samples, seeds(seed)
    paths = [Path(shown, sampler) for sampler in SAMPLERS]
    works = [tracing(shown, draw)]
    works += [one.one_frame(samples, draw) for one in paths]
    turns = take_turns(works, rounds)
    return [
        turns.compared(
            f"pass, {len(shown.patterns.frames())} frames",
            f"path, {sampler}, one frame",
            theirs=1 + i,
            unit="s",
            reads="x baseline",
            target=target,
            note=note,
        )
        for i, sampler in enumerate(SAMPLERS)
    ]


if __name__ == "__main__":
    raise SystemExit(main("trace", __doc__, measure))
