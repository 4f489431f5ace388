"""One worker process: reads a plan and then sample numbers on stdin; makes each and answers with a line of JSON.

Started by `fringebench.datasets.execution.processes` as ``python -m fringebench.datasets.execution.sample_worker``. It ends when stdin ends, even
in the middle of a sample: the parent process is gone then.
"""

import gc
import json
import os
import sys
import threading
from collections import deque
from pathlib import Path
from typing import Any, TextIO

from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.execution.maker import made_with
from fringebench.datasets.sample import attempt
from scenes.support.errors import FringebenchError


def confine() -> None:
    """Keep this process's rendering to one core: a data set's cores are shared out by samples, which scales better."""
    from render.plugins.variant import dr, use

    use()
    dr.set_thread_count(1)


def main() -> None:
    """Serve until stdin ends."""
    # Libraries that print must not spoil the answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    orders = _Orders(sys.stdin)
    try:
        plan = DatasetPlan.loads(json.loads(orders.next()), "the plan")
        plan.require_maker(made_with())
        scene = plan.load_scene()
        confine()
    except FringebenchError as error:
        _answer(answers, {"fatal": str(error)})
        return
    _answer(answers, {"ready": os.getpid()})
    while True:
        order = json.loads(orders.next())
        try:
            record = attempt(plan, scene, order["index"], Path(order["folder"]))
        except FringebenchError as error:
            _answer(answers, {"fatal": str(error)})
            return
        _answer(answers, {"record": record.model_dump(mode="json")})
        # Mitsuba's scenes are in reference cycles; without this, dozens accumulate.
        gc.collect()


class _Orders:
    """Lines of stdin, read ahead by a thread, so that its end is noticed at once."""

    def __init__(self, source: TextIO) -> None:
        self._lines: deque[str] = deque()
        self._available = threading.Semaphore(0)
        threading.Thread(target=self._read, args=(source,), daemon=True).start()

    def next(self) -> str:
        """The next line."""
        self._available.acquire()
        return self._lines.popleft()

    def _read(self, source: TextIO) -> None:
        for line in source:
            self._lines.append(line)
            self._available.release()
        os._exit(0)


def _answer(answers: TextIO, message: dict[str, Any]) -> None:
    answers.write(json.dumps(message) + "\n")
    answers.flush()


if __name__ == "__main__":
    main()
