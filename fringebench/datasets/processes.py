"""Samples made by processes on this machine, one core each.

Plain processes that talk over pipes, not a pool of `multiprocessing`: a worker that dies (out of memory, a crash in a
native library) costs one attempt at one sample, and the threads of its libraries are set before they are loaded.
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
from pathlib import Path
from typing import IO, Any

import fringebench
from fringebench.datasets.plan import Plan
from fringebench.datasets.sample import Record, failed
from fringebench.datasets.store import Store
from scenes.errors import DatasetError

# A sample may take its worker down this often before it counts as the cause.
DEATHS = 2
# Read by the libraries when they are loaded.
ONE_THREAD = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "PYTHON_CPU_COUNT",
)


def in_processes(
    plan: Plan, indices: Iterable[int], store: Store, workers: int
) -> Generator[tuple[Record, Path | None]]:
    """Records in the order in which samples are made, and the folder of each, None if it failed.

    Folders lie in the store's staging and are gone when the next record is asked for: put them in place before.
    Raises `DatasetError` when workers cannot start or cannot write.
    """
    waiting = iter(indices)
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
                    index, obituary = worker.index, worker.obituary()
                    if index is None:
                        raise DatasetError(f"a worker process could not start: {obituary}")
                    deaths[index] += 1
                    if deaths[index] < DEATHS:
                        again.append(index)
                    else:
                        yield failed(plan, index, f"its worker process died: {obituary}"), None
                    start()
                    continue
                if "fatal" in answer:
                    raise DatasetError(str(answer["fatal"]))
                if "record" in answer:
                    record = Record.model_validate(answer["record"])
                    yield record, worker.folder if record.status == "made" else None
                order = again.pop() if again else next(waiting, None)
                if order is None:
                    selector.unregister(worker.answers)
                    worker.stop()
                else:
                    worker.give(order, store)


class _Worker:
    """A worker process, and what it is at. As a context it ends the process."""

    def __init__(self, plan: Plan) -> None:
        self.index: int | None = None
        self.folder: Path | None = None
        self._staging = ExitStack()
        self._words: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  closed by `stop`
        root = str(Path(fringebench.__file__).parents[1])
        path = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))
        self._process = subprocess.Popen(
            # -P: whatever lies in the folder one happens to stand in is no package of ours.
            [sys.executable, "-P", "-m", "fringebench.datasets.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._words,
            env=os.environ | dict.fromkeys(ONE_THREAD, "1") | {"PYTHONPATH": path},
        )
        self._send(plan.dumps())

    def __enter__(self) -> "_Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def answers(self) -> IO[bytes]:
        """Readable when it has something to say, or is dead."""
        assert self._process.stdout is not None
        return self._process.stdout

    def answer(self) -> dict[str, Any] | None:
        """What it says, None if it is dead."""
        line = self.answers.readline()
        # A worker that dies while it speaks leaves half a line.
        return json.loads(line) if line.endswith(b"\n") else None

    def give(self, index: int, store: Store) -> None:
        """Have it make a sample."""
        self._staging.close()
        self.index, self.folder = index, self._staging.enter_context(store.staging())
        self._send({"index": index, "folder": str(self.folder)})

    def stop(self) -> None:
        """End it, whatever it is at."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._words):
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]
        self._staging.close()

    def obituary(self) -> str:
        """How it ended, and the last thing it said."""
        status = self._process.wait()
        how = f"killed by {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        self._words.seek(0)
        lines = self._words.read().decode(errors="replace").strip().splitlines()
        return f"{how}: {lines[-1]}" if lines else how

    def _send(self, message: Any) -> None:
        assert self._process.stdin is not None
        # A dead worker is noticed by its silence.
        with suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
