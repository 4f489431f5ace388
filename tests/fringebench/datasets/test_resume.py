"""The same bytes whoever makes them, in whatever order, however often it is interrupted."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fringebench.datasets.build import build
from fringebench.datasets.plan import Plan
from fringebench.datasets.sample import attempt
from scenes.errors import DatasetError

Checksums = Callable[[Path], dict[str, str]]


def test_a_sample_made_alone_in_another_process_is_the_same(
    plan: Plan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    # This process has other threads than a worker and has made no sample before.
    attempt(plan, plan.load_scene(), 4, tmp_path)
    assert checksums(tmp_path) == checksums(undisturbed / "samples" / "000004")


def test_two_workers_make_what_one_makes(
    plan: Plan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    build(plan, tmp_path / "two", workers=2)
    assert checksums(tmp_path / "two") == checksums(undisturbed)


def test_a_set_that_grows_keeps_its_samples_and_equals_one_made_at_once(
    plan: Plan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    folder = tmp_path / "growing"
    build(plan.model_copy(update={"count": 2}), folder)
    kept = (folder / "samples/000001/stack.exr").stat().st_mtime_ns
    built = build(plan, folder)
    assert built.made == 4
    assert (folder / "samples/000001/stack.exr").stat().st_mtime_ns == kept
    assert checksums(folder) == checksums(undisturbed)


def test_a_whole_set_is_left_as_it_is(plan: Plan, copy: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in copy.rglob("*") if path.is_file()}
    assert build(plan, copy).made == 0
    assert before == {path: path.stat().st_mtime_ns for path in before}


def test_what_a_killed_run_left_half_done_is_made_again(
    plan: Plan, copy: Path, undisturbed: Path, checksums: Checksums
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
    (copy / ".staging/abc/new").mkdir(parents=True)
    (copy / "half").rename(copy / ".staging/abc/new/000004")
    (copy / "samples/000005/stack.exr").write_bytes(b"half")
    assert build(plan, copy).made == 2
    assert checksums(copy) == checksums(undisturbed)


@pytest.mark.slow
def test_killed_ten_times_at_random_moments_it_ends_as_if_undisturbed(
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
        deadline = time.monotonic() + 60.0
        # Start-up takes seconds and makes nothing: wait until it makes samples, then kill at any moment.
        while len(list(folder.glob("samples/*"))) <= before and run.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        # Short, lest a fast machine makes all sixty before the tenth kill.
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


def test_a_worker_that_dies_costs_a_sample_one_attempt(
    plan: Plan, undisturbed: Path, tmp_path: Path, checksums: Checksums
) -> None:
    # Its workers are this process's children; the first is killed in the middle of its work.
    from fringebench.datasets import processes

    struck: list[int] = []

    class Fragile(processes._Worker):
        def give(self, index: int, store: object) -> None:
            super().give(index, store)  # type: ignore[arg-type]
            if not struck:
                struck.append(index)
                self._process.kill()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_Worker", Fragile)
        build(plan, tmp_path / "set", workers=1)
    assert struck
    assert checksums(tmp_path / "set") == checksums(undisturbed)


def test_a_sample_that_always_kills_its_worker_is_recorded_and_the_others_are_made(
    plan: Plan, tmp_path: Path
) -> None:
    from fringebench.datasets import processes

    class Fragile(processes._Worker):
        def give(self, index: int, store: object) -> None:
            super().give(index, store)  # type: ignore[arg-type]
            if index == 1:
                self._process.kill()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(processes, "_Worker", Fragile)
        built = build(plan.model_copy(update={"count": 3}), tmp_path / "set", workers=1)
    assert [record.index for record in built.failed] == [1]
    assert "killed by SIGKILL" in built.failed[0].reason
    assert not (tmp_path / "set/samples/000001").exists()


def test_two_runs_at_once_on_one_folder_are_refused(plan: Plan, copy: Path) -> None:
    from fringebench.datasets.store import open_store

    with open_store(copy).alone(), pytest.raises(DatasetError, match="another run"):
        build(plan, copy)
