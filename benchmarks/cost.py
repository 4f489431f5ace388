"""Cost of a pass, and of exposing, against each size: series on the scene `cap`, with the fitted exponent.

The largest size is compared with the smallest. An exponent of 1 is a cost in proportion, 0 a constant cost; it is the slope
of log time against log size over the upper half of the series, where the constant part (tessellation, building the scene)
matters least.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

import render
import scenes
from benchmarks.light import scene, seeds
from benchmarks.result import Result, digits, main
from benchmarks.turns import Turns, Work, take_turns
from scenes.acquisition.patterns import PhaseShift
from scenes.shapes.solids import Cap

NAME = "cap"
PERIODS_PX = (8.0, 16.0, 32.0, 64.0, 128.0, 256.0)


def measure(quick: bool) -> list[Result]:
    """Frames, samples, resolution, triangles, exposures, bounces."""
    small = (160, 120) if quick else (320, 240)
    rounds = 1 if quick else 4
    draw = seeds(11)

    def pass_of(shown: scenes.Scene) -> Work:
        return lambda: render.trace(shown, seed=draw())

    base = scene(NAME, size=small)

    def steps(n: float) -> Work:
        return pass_of(_with(base, PhaseShift(steps=int(n), periods_px=PERIODS_PX[:3])))

    def periods(n: float) -> Work:
        return pass_of(_with(base, PhaseShift(steps=4, periods_px=PERIODS_PX[: int(n)])))

    def samples(n: float) -> Work:
        return pass_of(scene(NAME, size=small, samples=int(n)))

    def pixels(n: float) -> Work:
        height = round(np.sqrt(n * 1e6 * 3 / 4))
        return pass_of(scene(NAME, size=(height * 4 // 3, height), samples=16))

    def triangles(n: float) -> Work:
        return pass_of(_with_triangles(base, int(n)))

    def bounces(n: float) -> Work:
        return pass_of(scene(NAME, size=small, depth=int(n)))

    light = render.trace(scene(NAME, size=small, samples=4), seed=1)

    def exposures(n: float) -> Work:
        return lambda: render.expose(light, seed=draw(), exposures=[1.0] * int(n))

    ladders: list[tuple[str, str, Sequence[float], Callable[[float], Work]]] = [
        ("more steps", "frames of 3 periods", (12, 24, 48), lambda n: steps(n / 3)),
        ("more periods", "frames of 4 steps", (4, 8, 16, 24), lambda n: periods(n / 4)),
        ("samples", "samples", (16, 64, 256), samples),
        ("resolution", "Mpx", (0.08, 0.3, 1.2), pixels),
        ("triangles", "triangles", (1e3, 1e4, 1e5, 1e6), triangles),
        ("bounces", "surface vertices", (1, 2, 3, 4, 6), bounces),
        ("exposures (expose)", "exposures of 12 frames", (1, 2, 4), exposures),
    ]
    where = f"{NAME}, {small[0]} x {small[1]}, 64 samples, depth 3 where not varied"
    return [
        _row(name, sizes, unit, take_turns([make(n) for n in sizes], rounds), where)
        for name, unit, rungs, make in ladders
        # Quick: the ends only.
        for sizes in ([rungs[0], rungs[-1]] if quick else rungs,)
    ]


def _row(name: str, sizes: Sequence[float], unit: str, turns: Turns, where: str) -> Result:
    """The largest size compared with the smallest; exponents and all sizes in the note."""
    times, processor = np.median(turns.wall_s, axis=0), np.median(turns.processor_s, axis=0)
    rungs = ", ".join(f"{n:g}: {digits(1e3 * t)} ms" for n, t in zip(sizes, times, strict=True))
    each = 1e3 * (times[-1] - times[0]) / (sizes[-1] - sizes[0])
    return turns.compared(
        f"{name}: {sizes[-1]:g} {unit}",
        f"{sizes[0]:g}",
        ours=len(sizes) - 1,
        theirs=0,
        reads="x baseline",
        note=f"grows as n^{exponent(sizes, times):.2f}, by processor n^{exponent(sizes, processor):.2f}; "
        f"one more: {each:.3g} ms; {rungs}; {where}",
    )


def exponent(sizes: Sequence[float], times: Sequence[float] | NDArray[np.float64]) -> float:
    """Slope of log time against log size over the upper half of a series, at least its last two sizes."""
    kept = max(2, (len(sizes) + 1) // 2)
    return float(np.polyfit(np.log(sizes[-kept:]), np.log(times[-kept:]), 1)[0])


def _with(base: scenes.Scene, patterns: PhaseShift) -> scenes.Scene:
    return base.model_copy(update={"patterns": patterns})


def _with_triangles(base: scenes.Scene, count: int) -> scenes.Scene:
    """The cap tessellated into that many triangles, with twice as many segments as rings."""
    rings = max(4, round(np.sqrt(count / 4)))
    objects = tuple(
        item.model_copy(update={"shape": item.shape.model_copy(update={"rings": rings, "segments": 2 * rings})})
        if isinstance(item.shape, Cap) and item.label == "cap"
        else item
        for item in base.objects
    )  # fmt: skip
    return base.model_copy(update={"objects": objects})


if __name__ == "__main__":
    raise SystemExit(main("cost", __doc__, measure))
