"""Samples made by the workers of a Dask cluster (optional extra `cluster`)."""

import json
import threading
from collections.abc import Generator, Iterable
from itertools import islice
from pathlib import Path
from typing import Any

from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.execution.maker import made_with
from fringebench.datasets.execution.sample_worker import confine
from fringebench.datasets.sample import Record, attempt, failed
from fringebench.datasets.store import open_store
from scenes.support.errors import DatasetError, FringebenchError

# Tasks submitted per thread of the cluster: enough to keep it busy while answers travel.
TASKS_PER_THREAD = 3
CONNECT_S = 10
WORKERS_S = 60

# A renderer fills a process; Dask's workers may run several tasks in one.
_ONE_AT_A_TIME = threading.Lock()


def on_cluster(
    plan: DatasetPlan, indices: Iterable[int], where: str, address: str
) -> Generator[tuple[Record, None]]:
    """Records in the order in which samples are made; the workers put the samples in place at `where` themselves.

    Tasks of workers that are lost go to others. Raises `DatasetError` when the scheduler cannot be reached, or its
    workers would make other bytes or cannot write to `where`.
    """
    client = _client(address)
    import distributed

    target, text = _everywhere(where), plan.dumps()
    waiting = iter(indices)
    with client:
        ours: dict[Any, int] = {}
        finished = distributed.as_completed(loop=client.loop)

        def submit() -> None:
            room = max(TASKS_PER_THREAD * sum(client.nthreads().values()), 1) - len(ours)
            for index in islice(waiting, max(room, 0)):
                future = client.submit(remote, text, index, target, pure=False)
                ours[future] = index
                finished.add(future)

        submit()
        while ours:
            future = next(finished)
            index = ours.pop(future)
            submit()
            answer = _answer(plan, future, index)
            if "fatal" in answer:
                client.cancel(list(ours))
                raise DatasetError(str(answer["fatal"]))
            yield Record.model_validate(answer), None


def maker_of(address: str) -> dict[str, str]:
    """What decides the bytes that a cluster's workers make, as reported by one of them."""
    with _client(address) as client:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            raise DatasetError(
                f"the cluster at '{address}' has had no worker for {WORKERS_S} s: start some (dask worker {address})"
            ) from error
        answer: dict[str, str] = json.loads(client.submit(remote_maker, pure=False).result())
    if "fatal" in answer:
        raise DatasetError(answer["fatal"])
    return answer


def remote_maker() -> str:
    """`made_with` on a worker, as JSON."""
    try:
        return json.dumps(made_with())
    except FringebenchError as error:
        return json.dumps({"fatal": f"{error} (on a worker of the cluster)"})


def _client(address: str) -> Any:
    try:
        import distributed
    except ImportError as error:
        raise DatasetError(
            f"--scheduler needs Dask ({error}): pip install 'fringebench[cluster]'"
        ) from error
    try:
        return distributed.Client(
            address, timeout=CONNECT_S, set_as_default=False, name="fringebench"
        )
    except (OSError, ValueError, TimeoutError) as error:
        raise DatasetError(
            f"no Dask scheduler answers at '{address}': {error}; give its address as tcp://host:8786"
        ) from error


def remote(plan_toml: str, index: int, where: str) -> str:
    """What a cluster's worker does for one sample; the answer is JSON, for workers of other versions can send that too."""
    try:
        with _ONE_AT_A_TIME:
            plan = DatasetPlan.loads(plan_toml, "the plan")
            plan.require_maker(made_with())
            confine()
            store = open_store(where)
            with store.staging() as folder:
                record = attempt(plan, plan.load_scene(), index, folder)
                if record.status == "made":
                    store.put(folder, record.folder)
        return record.model_dump_json()
    except FringebenchError as error:
        return json.dumps({"fatal": f"{error} (on a worker of the cluster)"})


def _answer(plan: DatasetPlan, future: Any, index: int) -> dict[str, Any]:
    import distributed

    try:
        answer: dict[str, Any] = json.loads(future.result())
    except distributed.KilledWorker as error:
        lost = failed(plan, index, f"its worker processes died: {error}")
        return lost.model_dump(mode="json")
    except Exception as error:  # any error of a worker's own installation
        return {
            "fatal": f"the cluster could not run sample {index}: {type(error).__name__}: {error}"
        }
    return answer


def _everywhere(where: str) -> str:
    """The path in a form that is valid for workers with another current folder."""
    return where if "://" in where else str(Path(where).absolute())
