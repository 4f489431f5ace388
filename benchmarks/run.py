"""`fringebench run bench` as a user calls it, from start to report, and where its time goes.

In its own process; the times of the stages are those the command prints. The rest is start-up, imports and printing. Warm:
kernels in ~/.drjit from a run before; cold: an empty home, as after installation (matplotlib's caches are new then, too).
"""

import re
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.process import Program, empty_home, python
from benchmarks.result import Result, Target, main

TARGET = Target("value", "at most", 25.0)
PRINTED = re.compile(r"files in .*\((.*)\)")
STAGE = re.compile(r"([a-z ]+?) (\d+\.\d) s")
SMALL = ("--set", "camera.resolution=[320,240]", "--set", "sampling.samples=16")


def measure(quick: bool) -> list[Result]:
    """Warm and cold, and each stage's share of the warm run."""
    small = SMALL if quick else ()
    _run(small)
    warm = [_run(small) for _ in range(1 if quick else 3)]
    with empty_home() as home:
        cold, _ = _run(small, home)
    imports = python("-c", "import fringebench.cli, fringebench.run, fringebench.run_report")
    taken = float(np.median([program.wall_s for program, _ in warm]))
    processor = float(np.median([program.processor_s for program, _ in warm]))
    size = (
        "320 x 240, 16 samples"
        if quick
        else "as shipped: 640 x 480, 64 samples, 12 frames, 3 exposures"
    )
    rows = [
        Result("warm", taken, "s", processor_value=processor, target=TARGET, note=f"bench, {size}"),
        Result(
            "cold", cold.wall_s, "s", "warm", taken, cold.wall_s / taken,
            processor_value=cold.processor_s, processor_baseline=processor, processor_ratio=cold.processor_s / processor,
        ),
    ]  # fmt: skip
    stages = {name: float(np.median([spent[name] for _, spent in warm])) for name in warm[0][1]}
    rows += [_share(name, seconds, taken) for name, seconds in stages.items()]
    rows.append(_share("the rest: start, imports, tables", taken - sum(stages.values()), taken))
    rows.append(_share("imports, among the rest", imports.wall_s, taken))
    return rows


def _share(name: str, seconds: float, whole: float) -> Result:
    return Result(f"of warm: {name}", seconds, "s", "warm", whole, seconds / whole)


def _run(settings: tuple[str, ...], home: Path | None = None) -> tuple[Program, dict[str, float]]:
    """The command, and its stages' seconds."""
    with tempfile.TemporaryDirectory() as folder:
        program = python("-m", "fringebench", "run", "bench", "-o", folder, *settings, home=home)
    printed = PRINTED.search(program.output)
    assert printed, f"the command prints no times: {program.output[-300:]}"
    return program, {name.strip(): float(s) for name, s in STAGE.findall(printed[1])}


if __name__ == "__main__":
    raise SystemExit(main("run", __doc__, measure))
