"""Data sets: two workers against one confined to one core, samples a minute; and memory over many samples.

    python -m benchmarks.dataset                    # 640 x 480, scene `spi`
    python -m benchmarks.dataset --memory 200       # resident memory of a worker over 200 small samples instead

Runs alternate, one worker and then two, because other programs load a machine unevenly. Start-up (imports, first
kernels) is left out: time is measured from the moment each worker has made its first sample. The processor time
per sample is given next to the rates; other programs hardly change it: if it is the same for one worker and for two, only
the number of cores limits the ratio.
"""

import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import scenes
from benchmarks.result import Result, Target, main
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan

TARGET = Target("ratio", "at least", 1.6)


class Clock:
    """Records when each sample was done, and the time the workers had used until then."""

    def __init__(self) -> None:
        self.at_s: list[float] = []
        self.cpu_s: list[float] = []
        self.resident_mb: list[float] = []
        self._used: dict[int, float] = {}

    def __call__(self, done: int, bad: int, total: int) -> None:
        """One more sample is done."""
        if bad:
            raise SystemExit(f"{bad} samples failed")
        if done:
            usage = {pid: _usage(pid) for pid in _children()}
            # A worker without work has ended, but what it used counts.
            self._used |= {pid: cpu for pid, (cpu, _) in usage.items()}
            self.at_s.append(time.perf_counter())
            self.cpu_s.append(sum(self._used.values()))
            self.resident_mb.append(max(resident for _, resident in usage.values()))


def run(scene: scenes.Scene, count: int, workers: int, core: int | None) -> Clock:
    """Make a data set in a temporary folder, its workers confined to one core if one is given."""
    cores = os.sched_getaffinity(0)
    clock = Clock()
    try:
        if core is not None:
            os.sched_setaffinity(0, {core})
        with tempfile.TemporaryDirectory() as folder:
            build(
                DatasetPlan.of(scene, count), Path(folder) / "set", workers=workers, progress=clock
            )
    finally:
        os.sched_setaffinity(0, cores)
    return clock


def measure(quick: bool) -> list[Result]:
    """Rates of one worker on one core and of two, round by round."""
    size, more, rounds = ((160, 120), 3, 1) if quick else ((640, 480), 6, 2)
    scene = scenes.load("spi", {"camera.resolution": list(size)})
    rates: dict[int, list[float]] = {1: [], 2: []}
    processor: dict[int, list[float]] = {1: [], 2: []}
    cores = sorted(os.sched_getaffinity(0))
    for round_ in range(rounds):
        for workers in (1, 2):
            core = cores[round_ % len(cores)] if workers == 1 else None
            clock = run(scene, (1 + more) * workers, workers, core)
            # At the w-th sample each of w workers has made its first.
            made = len(clock.at_s) - workers
            rates[workers].append(60.0 * made / (clock.at_s[-1] - clock.at_s[workers - 1]))
            processor[workers].append((clock.cpu_s[-1] - clock.cpu_s[workers - 1]) / made)
    spent = {workers: float(np.median(each)) for workers, each in processor.items()}
    return [
        Result(
            "two workers",
            float(np.median(rates[2])),
            "samples/min",
            "one worker on one core",
            float(np.median(rates[1])),
            float(np.median(np.divide(rates[2], rates[1]))),
            target=TARGET,
            note=f"spi, {size[0]} x {size[1]}, {rounds} rounds; {spent[1]:.2f} s of processor a sample with one worker, "
            f"{spent[2]:.2f} with two",
        )
    ]


def memory(scene: scenes.Scene, count: int) -> dict[str, Any]:
    """Resident memory of one worker, and its slope from the tenth sample on."""
    resident = np.array(run(scene, count, 1, None).resident_mb)
    steady = resident[10:]
    slope = np.polyfit(np.arange(len(steady)), steady, 1)[0]
    return {
        "resident_mb_at_10": float(resident[9]),
        "resident_mb_at_end": float(resident[-1]),
        "slope_mb_per_100_samples": float(100 * slope),
    }


def _children() -> list[int]:
    return [
        int(pid)
        for task in Path("/proc/self/task").iterdir()
        for pid in (task / "children").read_text().split()
    ]


def _usage(pid: int) -> tuple[float, float]:
    """Processor seconds and resident MB of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE") / 2**20


if __name__ == "__main__":
    if sys.argv[1:2] == ["--memory"]:
        small = scenes.load("spi", {"camera.resolution": [160, 120], "sampling.samples": 4})
        print(json.dumps(memory(small, int(sys.argv[2])), indent=2))
        sys.exit()
    raise SystemExit(main("dataset", __doc__, measure))
