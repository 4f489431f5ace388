"""One pass for all frames against one render of one frame by Mitsuba's `path`, at equal samples.

Scene `bench`, 640 x 480, 64 samples, three surface vertices, 12 frames; kernels warm. `path` is given each of the samplers a
careful user would consider. The pass's time includes tessellating the objects and building the scene; `path` is handed a
scene already built.
"""

from benchmarks.light import Path, scene, seeds, tracing
from benchmarks.result import Result, Target, main
from benchmarks.turns import take_turns

SAMPLERS = ("independent", "multijitter")
TARGET = Target("ratio", "at most", 1.6)


def measure(quick: bool) -> list[Result]:
    """The pass beside `path` with each sampler."""
    size, samples, rounds = ((320, 240), 16, 3) if quick else ((640, 480), 64, 7)
    shown = scene(size=size, samples=samples)
    draw = seeds(1)
    paths = [Path(shown, sampler) for sampler in SAMPLERS]
    works = [tracing(shown, draw)]
    works += [one.one_frame(samples, draw) for one in paths]
    turns = take_turns(works, rounds)
    frames = len(shown.patterns.frames())
    return [
        turns.beside(
            f"pass, {frames} frames",
            f"path, {sampler}, one frame",
            theirs=1 + i,
            unit="s",
            reads="x baseline",
            target=TARGET,
            note=f"bench, {size[0]} x {size[1]}, {samples} samples, depth 3; {rounds} rounds",
        )
        for i, sampler in enumerate(SAMPLERS)
    ]


if __name__ == "__main__":
    raise SystemExit(main("trace", __doc__, measure))
