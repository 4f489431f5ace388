"""Data sets, scene `spi` at 640 x 480: samples a minute with two workers and with one, of each stage, of a further variant.

Memory over many samples is measured by `python -m benchmarks.killed`.

Runs alternate, one worker and then two, because other programs load a machine unevenly. Start-up (imports, first
kernels) is left out: time is measured from the moment each worker has made its first sample. The processor time
per sample is given next to the rates; other programs hardly change it: if it is the same for one worker and for two, only
the number of cores limits the ratio.
"""

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import decode
import render
import scenes
from benchmarks.killed import children
from benchmarks.result import Result, Target, main
from fringebench.datasets import sample
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.execution.sample_worker import confine

TARGET = Target("ratio", "at least", 1.6)
WHOLE = "whole"
STAGES: dict[str, tuple[Any, str]] = {
    "mesh": (render, "surfaces"),
    "light": (render, "trace"),
    "truth": (render, "truth"),
    "exposure": (render, "expose"),
    "ring light": (render, "ring_light_picture"),
    "decode": (decode, "reconstruct"),
    "write": (sample._Content, "write"),
}


class Clock:
    """Records when each sample was done, and the time the workers had used until then."""

    def __init__(self) -> None:
        self.at_s: list[float] = []
        self.cpu_s: list[float] = []
        self._used: dict[int, float] = {}

    def __call__(self, done: int, bad: int, total: int) -> None:
        """One more sample is done."""
        if bad:
            raise SystemExit(f"{bad} samples failed")
        if done:
            # A worker without work has ended, but what it used counts.
            self._used |= {pid: _processor_s(pid) for pid in children(os.getpid())}
            self.at_s.append(time.perf_counter())
            self.cpu_s.append(sum(self._used.values()))


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
    two = Result(
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
    return [two, *stages(scene, more)]


def stages(scene: scenes.Scene, rounds: int) -> list[Result]:
    """Samples that each stage could make in a minute of processor time, relative to a sample as a whole; cost of what
    is on request.
    """
    confine()
    plain = [timed_sample(scene, i) for i in range(rounds + 1)][1:]
    asked = {"heights": True, "modulation": True, "ring_light": True}
    full = [timed_sample(scene, i, **asked) for i in range(rounds + 1)][1:]
    # Of four variants of a light the first pays for it.
    again = [timed_sample(scene, i, variants=4) for i in range(4)][1:]
    whole_s = median_s(plain, WHOLE)
    named = [(f"stage: {n}", median_s(plain, n), "a whole sample") for n in plain[0] if n != WHOLE]
    named += [
        (f"on request: {n}", median_s(full, n), "a whole sample") for n in ("ring light", "decode")
    ]
    named += [("a further variant of the same light", median_s(again, WHOLE), "the first")]
    width, height = scene.camera.resolution
    note = f"spi, {width} x {height}; minutes of processor time, one thread; median of {rounds}"
    return [
        Result(
            *(name, 60.0 / own_s, "samples/min", baseline, 60.0 / whole_s, whole_s / own_s),
            note=note,
        )
        for name, own_s, baseline in named
    ]


def timed_sample(scene: scenes.Scene, index: int, **asked: Any) -> dict[str, float]:
    """Make a sample in this process: processor seconds of each stage, in all, and of the rest."""
    plan = DatasetPlan.of(scene, index + 1, **asked)
    spent: dict[str, float] = {}

    def watched(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def watch(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            done = work(*args, **kwargs)
            spent[name] = time.process_time() - start
            return done

        return watch

    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name, (module, function) in STAGES.items():
            work = watched(name, getattr(module, function))
            stack.enter_context(patch.object(module, function, work))
        made = watched(WHOLE, sample.attempt)(plan, plan.load_scene(), index, folder)
    if made.status == "failed":
        raise SystemExit(f"sample {index} failed: {made.reason}")
    rest = 2.0 * spent[WHOLE] - sum(spent.values())
    return spent | {"drawing, labels, checksums": rest}


def median_s(samples: Sequence[dict[str, float]], name: str) -> float:
    """Median processor time of a stage."""
    return float(np.median([spent[name] for spent in samples]))


def _processor_s(pid: int) -> float:
    """Processor seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    raise SystemExit(main("dataset", __doc__, measure))
