"""Samples made by processes on this machine, one core each.

Plain processes and pipes. A worker that dies (out of memory, a crash in a native library) costs one attempt at one
sample, and the threads of its libraries are set before they are loaded. Tried instead, on 40 samples of the tests'
small board with two workers: a local cluster of `distributed` needs 41 % more processor time and 2.5 times the
wall time (its nannies wait for workers that render), and loses the worker's last words; `pebble` took 7 % longer on four samples, and starts
workers by `multiprocessing.spawn`, so that a script without a ``__main__`` guard cannot make a data set.
"""

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Generator, Iterable
from contextlib import ExitStack, suppress
from itertools import groupby
from pathlib import Path
from typing import IO, Any

from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import Record, failed
from fringebench.datasets.store import Store
from scenes.support.errors import DatasetError

# A sample may take its worker down this often before it counts as the cause.
DEATHS = 2
# Read by libraries when they are loaded.
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "PYTHON_CPU_COUNT",
)


def in_processes(
    plan: DatasetPlan, indices: Iterable[int], store: Store, workers: int
) -> Generator[tuple[Record, Path | None]]:
    """Records in the order in which samples are made, and the folder of each, None if it failed.

    Folders are in the store's staging and are deleted when the next record is requested: move them before that.
    Raises `DatasetError` when workers cannot start or cannot write.
    """
    # Whole lights: the variants of one are made by one worker, which keeps it.
    waiting = (list(own) for _, own in groupby(indices, plan.light_of))
    again: list[int] = []
    deaths: Counter[int] = Counter()
    with ExitStack() as stack, selectors.DefaultSelector() as selector:

        def start() -> None:
            worker = stack.enter_context(_Worker(plan))
            selector.register(worker.answers, selectors.EVENT_READ, worker)

        for _ in range(workers):
            start()
        while selector.get_map():
            for key, _ in selector.select():
                worker: _Worker = key.data
                answer = worker.answer()
                if answer is None:
                    selector.unregister(worker.answers)
                    index, exit_reason = worker.index, worker.exit_reason()
                    again += worker.queue
                    if index is None:
                        raise DatasetError(f"a worker process could not start: {exit_reason}")
                    deaths[index] += 1
                    if deaths[index] < DEATHS:
                        again.append(index)
                    else:
                        yield failed(plan, index, f"its worker process died: {exit_reason}"), None
                    start()
                    continue
                if "fatal" in answer:
                    raise DatasetError(str(answer["fatal"]))
                if "record" in answer:
                    record = Record.model_validate(answer["record"])
                    yield record, worker.folder if record.status == "made" else None
                if not worker.queue:
                    worker.queue = [again.pop()] if again else next(waiting, [])
                if not worker.queue:
                    selector.unregister(worker.answers)
                    worker.stop()
                else:
                    worker.give(worker.queue.pop(0), store)


class _Worker:
    """A worker process and its current sample. Leaving the context ends the process."""

    def __init__(self, plan: DatasetPlan) -> None:
        self.index: int | None = None
        self.queue: list[int] = []
        self.folder: Path | None = None
        self._staging = ExitStack()
        self._stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed by `stop`
        root = str(Path(__file__).parents[3])
        path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            # -P: a package in the current folder must not be taken for ours.
            [sys.executable, "-P", "-m", "fringebench.datasets.execution.sample_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            env=os.environ | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": path},
        )
        self._send(plan.dumps())

    def __enter__(self) -> "_Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def answers(self) -> IO[bytes]:
        """Readable when it has answered or has died."""
        assert self._process.stdout is not None
        return self._process.stdout

    def answer(self) -> dict[str, Any] | None:
        """Its next answer, None if it has died."""
        line = self.answers.readline()
        # A worker that dies while writing leaves half a line.
        return json.loads(line) if line.endswith(b"\n") else None

    def give(self, index: int, store: Store) -> None:
        """Order a sample."""
        self._staging.close()
        self.index, self.folder = index, self._staging.enter_context(store.staging())
        self._send({"index": index, "folder": str(self.folder)})

    def stop(self) -> None:
        """Kill it."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._stderr):
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]
        self._staging.close()

    def exit_reason(self) -> str:
        """How it ended, and the last line of its stderr."""
        status = self._process.wait()
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        self._stderr.seek(0)
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        return f"{how}: {lines[-1]}" if lines else how

    def _send(self, message: Any) -> None:
        assert self._process.stdin is not None
        # A dead worker is detected at its next answer.
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
