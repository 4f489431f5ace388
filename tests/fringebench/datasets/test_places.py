"""Data sets at URLs and from a Dask cluster equal those of a folder and of one worker."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import fsspec
import numpy as np
import pytest

import fringebench
from fringebench.datasets.building import build, repair
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.store import open_store
from fringebench.datasets.verification import verify
from scenes.support.errors import DatasetError

Checksums = Callable[[Path], dict[str, str]]
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def url() -> Iterator[str]:
    """A place in memory."""
    files = fsspec.filesystem("memory")
    yield "memory://set"
    files.rm("/", recursive=True)


@pytest.mark.usefixtures("here")
def test_set_at_a_url_is_the_same_and_can_be_read_verified_and_repaired(
    plan: DatasetPlan, undisturbed: Path, url: str, tmp_path: Path, checksums: Checksums
) -> None:
    build(plan, url)
    files = fsspec.filesystem("memory")
    files.get("/set/", str(tmp_path / "got"), recursive=True)
    assert checksums(tmp_path / "got") == checksums(undisturbed)
    sample = fringebench.Dataset(url)[2]
    same = fringebench.Dataset(undisturbed)[2]
    np.testing.assert_array_equal(sample.frames, same.frames)
    np.testing.assert_array_equal(sample.truth.height_mm, same.truth.height_mm)
    assert sample.scene == same.scene
    files.rm("/set/samples/000002/stack.exr")
    assert [p.file for p in verify(url)] == ["samples/000002/stack.exr"]
    assert repair(url).repaired == (2,)
    assert verify(url) == ()


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_folders_and_urls_behave_the_same(kind: str, tmp_path: Path, url: str) -> None:
    store = open_store(url if kind == "memory" else tmp_path / "place")
    assert store.list() == []
    assert store.read("a/b.txt") is None
    with store.local("a/b.txt") as path:
        assert path is None
    store.write("a/b.txt", b"one")
    store.write("a/b.txt", b"two")
    assert store.read("a/b.txt") == b"two"
    for content in (b"old", b"new"):
        with store.staging() as folder:
            (folder / "x").write_bytes(content)
            if content == b"old":
                (folder / "y").write_bytes(content)
            store.put(folder, "things/1")
    assert store.list("things/1") == ["x"]  # the new folder replaced the old, file y and all
    with store.local("things/1/x") as path:
        assert path is not None
        assert path.read_bytes() == b"new"
    store.remove("things")
    store.remove("things")
    assert store.list("things") == []


def _write_often(where: Path, name: str) -> None:
    for index in range(300):
        open_store(where).write(f"files/{name}-{index}", b"x")


def test_processes_that_write_at_once_leave_each_others_staging_alone(tmp_path: Path) -> None:
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(4, mp_context=spawned) as processes:
        for writing in [processes.submit(_write_often, tmp_path, name) for name in "abcd"]:
            writing.result()
    assert [path.name for path in tmp_path.iterdir()] == ["files"]
    assert len(list((tmp_path / "files").iterdir())) == 1200


@pytest.fixture
def start() -> Iterator[Start]:
    """Start a process of Dask's on loopback; it ends with the test."""
    with ExitStack() as stack:

        def begin(*words: object) -> subprocess.Popen[bytes]:
            process = subprocess.Popen(
                [sys.executable, "-m", *map(str, words)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=os.environ | {"PYTHONPATH": str(Path(fringebench.__file__).parents[1])},
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        yield begin


@pytest.fixture
def cluster(start: Start, tmp_path: Path) -> str:
    """Address of a real scheduler on loopback."""
    pytest.importorskip("distributed")
    about = tmp_path / "scheduler.json"
    start(
        *("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", 0),
        *("--no-dashboard", "--scheduler-file", about),
    )
    deadline = time.monotonic() + 300.0
    while not about.exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    address: str = json.loads(about.read_text())["address"]
    return address


def _worker(start: Start, address: str, threads: int = 1) -> subprocess.Popen[bytes]:
    return start(
        *("distributed.cli.dask_worker", address, "--nthreads", threads),
        *("--no-dashboard", "--no-nanny"),
    )


# Dask warns of its own sockets when a scheduler's other ends go away.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_cluster_makes_the_same_even_if_a_worker_is_killed_in_mid_run(
    plan: DatasetPlan,
    undisturbed: Path,
    cluster: str,
    start: Start,
    tmp_path: Path,
    checksums: Checksums,
) -> None:
    # Each with two threads: Mitsuba is called from several.
    victim, _ = _worker(start, cluster, 2), _worker(start, cluster, 2)
    longer = plan.model_copy(update={"count": 30})
    killed: list[int] = []

    def kill_one(done: int, bad: int, total: int) -> None:
        if done >= 4 and not killed:
            killed.append(done)
            victim.send_signal(signal.SIGKILL)

    built = build(longer, tmp_path / "set", scheduler=cluster, progress=kill_one)
    assert killed
    assert built.made == 30
    assert not built.failed
    build(longer, tmp_path / "here", workers=2)
    assert checksums(tmp_path / "set") == checksums(tmp_path / "here")
    # And the first six are those of any other run.
    for index in range(6):
        name = f"samples/{index:06d}"
        assert checksums(tmp_path / "set" / name) == checksums(undisturbed / name)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_workers_that_write_to_another_folder_are_detected(
    plan: DatasetPlan, cluster: str, start: Start, url: str
) -> None:
    # Memory is each process's own: what a worker writes there does not arrive here.
    _worker(start, cluster)
    with pytest.raises(DatasetError, match="is not there: workers of a cluster must share"):
        build(plan, url, scheduler=cluster)


def test_scheduler_that_does_not_answer_is_one_message(plan: DatasetPlan, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    from fringebench.datasets.execution import cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster, "CONNECT_S", 1)
        with pytest.raises(DatasetError, match="no Dask scheduler answers at"):
            build(plan, tmp_path / "set", scheduler="tcp://127.0.0.1:1")
    shutil.rmtree(tmp_path / "set", ignore_errors=True)
