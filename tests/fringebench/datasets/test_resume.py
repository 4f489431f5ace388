"""The bytes are the same for any worker, order and number of interruptions."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringebench.datasets import building
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import attempt, failed
from scenes.support.errors import DatasetError

Checksums = Callable[[Path], dict[str, str]]


def test_sample_made_alone_in_another_process_is_the_same(
    plan: DatasetPlan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    # This process has other threads than a worker and has made no sample before.
    attempt(plan, plan.load_scene(), 4, tmp_path)
    assert checksums(tmp_path) == checksums(undisturbed / "samples" / "000004")


def test_two_workers_make_what_one_makes(
    plan: DatasetPlan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    build(plan, tmp_path / "two", workers=2)
    assert checksums(tmp_path / "two") == checksums(undisturbed)


@pytest.mark.parametrize(("workers", "started"), [(1, 1), (4, 3)])
def test_no_more_workers_start_than_are_allowed_or_have_a_sample(
    plan: DatasetPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int, started: int
) -> None:
    asked = []

    def none(_: object, indices: Iterable[int], __: object, workers: int) -> Iterator[Any]:
        asked.append(workers)
        yield from ((failed(plan, index, "not made"), None) for index in indices)

    monkeypatch.setattr(building, "in_processes", none)
    with pytest.raises(DatasetError, match="not made"):
        build(plan.model_copy(update={"count": 3}), tmp_path / "set", workers=workers)
    assert asked == [started]


@pytest.mark.usefixtures("here")
def test_set_that_grows_keeps_its_samples_and_equals_one_made_at_once(
    plan: DatasetPlan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    folder = tmp_path / "growing"
    build(plan.model_copy(update={"count": 2}), folder)
    kept = (folder / "samples/000001/stack.exr").stat().st_mtime_ns
    built = build(plan, folder)
    assert built.made == 4
    assert (folder / "samples/000001/stack.exr").stat().st_mtime_ns == kept
    assert checksums(folder) == checksums(undisturbed)


def test_whole_set_is_left_as_it_is(plan: DatasetPlan, copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*") if path.is_file()}
    assert build(plan, copy).made == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.usefixtures("here")
def test_what_a_killed_run_left_half_done_is_made_again(
    plan: DatasetPlan, copy: Path, undisturbed: Path, checksums: Checksums
) -> None:
    # A run killed after putting sample 5, before its record; while it made sample 4; and its manifest was never written.
    from fringebench.datasets.contents import keep_record, records_of
    from fringebench.datasets.store import open_store

    store = open_store(copy)
    records = records_of(store)
    (copy / "manifest.parquet").unlink()
    for index in range(4):
        keep_record(store, records[index])
    (copy / "samples/000004").rename(copy / "half")
    (copy / ".staging-abc/new").mkdir(parents=True)
    (copy / "half").rename(copy / ".staging-abc/new/000004")
    (copy / "samples/000005/stack.exr").write_bytes(b"half")
    assert build(plan, copy).made == 2
    assert checksums(copy) == checksums(undisturbed)


@pytest.mark.slow
@pytest.mark.trust
def test_set_killed_ten_times_equals_an_undisturbed_one(
    scene_file: Path, tmp_path: Path, checksums: Checksums
) -> None:
    def command(folder: Path) -> list[str]:
        words = ["dataset", str(scene_file), "--count", "60", "--seed", "3", "--workers", "2"]
        return [sys.executable, "-m", "fringebench", *words, "-o", str(folder)]

    subprocess.run(command(tmp_path / "calm"), check=True, capture_output=True)
    rng = np.random.default_rng(11)
    folder = tmp_path / "killed"
    seen = []
    for _ in range(10):
        run = subprocess.Popen(command(folder), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        before = len(list(folder.glob("samples/*")))
        deadline = time.monotonic() + 300.0
        # Start-up takes seconds and makes nothing: wait until it makes samples, then kill at any moment.
        while len(list(folder.glob("samples/*"))) <= before and run.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        # Short, so that a fast machine does not finish before the tenth kill.
        time.sleep(rng.uniform(0.0, 0.2))
        run.send_signal(signal.SIGKILL)
        run.communicate()
        assert run.returncode == -signal.SIGKILL
        seen.append(len(list(folder.glob("samples/*"))))
    assert seen == sorted(seen)  # what was made stays made
    subprocess.run(command(folder), check=True, capture_output=True)
    killed, calm = (checksums(path) for path in (folder, tmp_path / "calm"))
    # The page says how long it all took.
    assert killed.pop("report.html")
    assert calm.pop("report.html")
    assert killed == calm


def test_dead_worker_costs_an_attempt_and_a_sample_that_always_kills_it_is_recorded(
    plan: DatasetPlan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    # Its workers are this process's children; they are killed in the middle of their work.
    from fringebench.datasets.execution import processes

    given: list[int] = []

    class Fragile(processes._Worker):
        def give(self, index: int, store: object) -> None:
            super().give(index, store)  # type: ignore[arg-type]
            given.append(index)
            if given == [0] or index == 1:
                self._stderr.write(b"no lamp\n")
                self._stderr.flush()
                self._process.kill()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_Worker", Fragile)
        built = build(plan.model_copy(update={"count": 3}), tmp_path / "set", workers=1)
    assert given == [0, 0, 1, 1, 2]
    assert [record.index for record in built.failed] == [1]
    assert built.failed[0].reason.endswith("killed by SIGKILL: no lamp")
    assert not (tmp_path / "set/samples/000001").exists()
    for name in ("000000", "000002"):
        same = checksums(tmp_path / "set/samples" / name)
        assert same == checksums(undisturbed / "samples" / name)


def test_two_runs_at_once_on_one_folder_are_refused(plan: DatasetPlan, copy: Path) -> None:
    from fringebench.datasets.store import open_store

    with open_store(copy).alone(), pytest.raises(DatasetError, match="another run"):
        build(plan, copy)
