"""Timing for a machine that others use too: works take turns, and ratios are medians of each round's ratio.

Processor time is given next to wall time: it counts all threads, and other programs hardly change it.
"""

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.result import Reads, Result, Target

Work = Callable[[], object]


@dataclass(frozen=True)
class Turns:
    """Seconds (round, work)."""

    wall_s: NDArray[np.float64]
    processor_s: NDArray[np.float64]

    def compared(
        self,
        name: str,
        baseline: str,
        ours: int = 0,
        theirs: int = 1,
        unit: str = "ms",
        reads: Reads = "x faster",
        target: Target | None = None,
        note: str = "",
    ) -> Result:
        """Time of one work compared with that of another."""
        scale = {"s": 1.0, "ms": 1e3}[unit]
        over, under = (theirs, ours) if reads == "x faster" else (ours, theirs)
        wall, processor = self.wall_s, self.processor_s
        return Result(
            name,
            scale * float(np.median(wall[:, ours])),
            unit,
            baseline,
            scale * float(np.median(wall[:, theirs])),
            float(np.median(wall[:, over] / wall[:, under])),
            reads,
            scale * float(np.median(processor[:, ours])),
            scale * float(np.median(processor[:, theirs])),
            float(np.median(processor[:, over] / processor[:, under])),
            target,
            note,
        )

    def rate(
        self,
        name: str,
        baseline: str,
        amounts: Sequence[float],
        unit: str,
        ours: int = 0,
        theirs: int = 1,
        target: Target | None = None,
        note: str = "",
    ) -> Result:
        """Amount per second (`amounts`: of each work) compared with another; by processor time, per core in use."""
        mine, other = amounts[ours], amounts[theirs]
        wall, processor = self.wall_s, self.processor_s
        return Result(
            name,
            mine / float(np.median(wall[:, ours])),
            unit,
            baseline,
            other / float(np.median(wall[:, theirs])),
            float(np.median((mine / wall[:, ours]) / (other / wall[:, theirs]))),
            "x baseline",
            mine / float(np.median(processor[:, ours])),
            other / float(np.median(processor[:, theirs])),
            float(np.median((mine / processor[:, ours]) / (other / processor[:, theirs]))),
            target,
            note,
        )


def take_turns(works: Sequence[Work], rounds: int, warm: bool = True) -> Turns:
    """Time each work in every round; with `warm`, run each once untimed before."""
    if warm:
        for work in works:
            work()
    spent = np.array([[seconds(work) for work in works] for _ in range(rounds)])
    return Turns(spent[..., 0], spent[..., 1])


class Elsewhere(NamedTuple):
    """Times returned by a work that ran in another process, in s."""

    wall_s: float
    processor_s: float


def seconds(work: Work) -> tuple[float, float]:
    """Wall-clock and processor time, in s."""
    wall, processor = time.perf_counter(), time.process_time()
    done = work()
    if isinstance(done, Elsewhere):
        return done
    # The clock of processor time has a resolution of a microsecond; zero would give no ratio.
    return time.perf_counter() - wall, max(time.process_time() - processor, 1e-6)


class Copy:
    """Copies that many bytes on all cores; read and written bytes both count towards the bandwidth of memory."""

    def __init__(self, nbytes: int) -> None:
        cores = os.cpu_count() or 1
        # Not zeros: the system maps those to one page until they are written, which is read from the cache.
        self._from = np.array_split(np.arange(nbytes // 8 + 1), cores)
        self._to = np.array_split(np.empty(nbytes // 8 + 1, np.int64), cores)
        self._pool = ThreadPoolExecutor(cores)
        self.moved_gb = 2e-9 * 8 * (nbytes // 8 + 1)

    def __call__(self) -> None:
        # NumPy releases the interpreter lock while it copies.
        for _ in self._pool.map(np.copyto, self._to, self._from):
            pass
