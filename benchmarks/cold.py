"""Cold start: cost of the first pass in a process compared with a later one.

Dr.Jit keeps compiled kernels in ~/.drjit, so a kernel is compiled once for a machine, not once for a process: the first pass
is timed with kernels found there, and with an empty folder (as after installation).
"""

import json
import sys
import time
from pathlib import Path

from benchmarks.process import empty_home, python
from benchmarks.result import Result, main


def measure(quick: bool) -> list[Result]:
    """Imports, and the first pass with and without cached kernels, compared with a later pass."""
    where = f"bench, 160 x 120, 16 samples; median of {1 if quick else 3} processes"
    cached = [_timed() for _ in range(2 if quick else 4)][1:]
    empty = []
    for _ in cached:
        with empty_home() as home:
            empty.append(_timed(home))
    middle = len(cached) // 2
    imports, first, later = (sorted(times)[middle] for times in zip(*cached, strict=True))
    compiling = sorted(times[1] for times in empty)[middle]
    return [
        Result("import of render", imports, "s", note="Mitsuba and its variant are loaded by the first pass"),
        Result("first pass, kernels cached", first, "s", "a later pass", later, first / later, note=where),
        Result("first pass, no kernel cached", compiling, "s", "a later pass", later, compiling / later, note=where),
    ]  # fmt: skip


def _timed(home: Path | None = None) -> tuple[float, float, float]:
    answer = python("-m", "benchmarks.cold", "--timed", home=home)
    times = json.loads(answer.output)
    return times["import"], times["first"], times["later"]


def timed() -> dict[str, float]:
    """In a process of its own: seconds of the imports, the first pass, a later one."""
    start = time.perf_counter()
    import render
    import scenes

    imported = time.perf_counter()
    scene = scenes.load("bench", {"camera.resolution": [160, 120], "sampling.samples": 16})
    begun = time.perf_counter()
    render.trace(scene, seed=1)
    first = time.perf_counter()
    render.trace(scene, seed=2)
    return {
        "import": imported - start,
        "first": first - begun,
        "later": time.perf_counter() - first,
    }


if __name__ == "__main__":
    if sys.argv[1:] == ["--timed"]:
        print(json.dumps(timed()))
        sys.exit()
    raise SystemExit(main("cold", __doc__, measure))
