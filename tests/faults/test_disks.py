"""Full, read-only and shared disks: one message, status 2, and every existing file is kept."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import scenes
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.exchange.capture_export import export
from fringebench.output_folder import locked
from scenes.files import exr
from scenes.support.atomic_file import UNFINISHED, replacing
from scenes.support.errors import DatasetError, FileError
from tests.commands import contents
from tests.conftest import Call

Disk = Callable[..., Path]


def fill(folder: Path, leave_kib: int) -> None:
    """Fill a small disk up to that much free space."""
    room = os.statvfs(folder)
    (folder / "ballast").write_bytes(bytes(room.f_bavail * room.f_frsize - leave_kib * 1024))


WRITERS: dict[str, Callable[[Path, Path], list[str | Path]]] = {
    "run": lambda small_run, out: ["run", "step", "-o", out],
    "render": lambda small_run, out: ["render", "step", "-o", out / "transport.exr", "--truth", out / "truth.exr"],
    "expose": lambda small_run, out: ["expose", small_run / "transport.exr", "-o", out / "stack.exr"],
    "decode": lambda small_run, out: ["decode", small_run / "stack.exr", "-o", out / "reconstruction.exr"],
    "evaluate": lambda small_run, out: ["evaluate", small_run / "reconstruction.exr", small_run / "truth.exr", "-o", out / "scores.json"],
    "export": lambda small_run, out: ["export", small_run / "stack.exr", "-o", out],
    "view": lambda small_run, out: ["view", small_run / "stack.exr", "-o", out / "view.html"],
    "convert": lambda small_run, out: ["convert", small_run / "reconstruction.exr", "-o", out / "cloud.ply"],
}  # fmt: skip
SCENES = ("run", "render")


@pytest.mark.parametrize("command", WRITERS)
def test_full_disk_keeps_existing_files(
    command: str, small_run: Path, disk: Disk, call: Call
) -> None:
    out = disk(4096)
    words = WRITERS[command](small_run, out)
    assert call(*words, small=command in SCENES)[0] == 0
    fill(out, leave_kib=0)
    before = contents(out)
    status, _, err = call(*words, small=command in SCENES)
    assert status == 2
    assert "No space left" in err or "cannot write" in err
    assert contents(out) == before


@pytest.mark.parametrize("leave_kib", [4, 16, 40])
def test_disk_that_fills_during_a_run_keeps_complete_files(
    leave_kib: int, disk: Disk, call: Call
) -> None:
    out = disk(2048)
    fill(out, leave_kib)
    status, _, err = call("run", "step", "-o", out, small=True)
    assert (status, "No space left" in err or "cannot write" in err) == (2, True)
    for name, read in (("transport.exr", exr.kind_of), ("scene.toml", scenes.load)):
        if (out / name).exists():
            read(out / name)
    assert not [name for name in contents(out) if UNFINISHED in name]


@pytest.mark.parametrize("command", WRITERS)
def test_read_only_disk_is_reported(command: str, small_run: Path, disk: Disk, call: Call) -> None:
    out = disk(64, read_only=True)
    status, _, err = call(*WRITERS[command](small_run, out), small=command in SCENES)
    assert status == 2
    assert "Read-only file system" in err


def test_export_that_cannot_be_replaced_keeps_its_manifest(small_run: Path, disk: Disk) -> None:
    out = disk(1024)
    stack = scenes.Stack.read(small_run / "stack.exr")
    export(stack, out)
    before = contents(out)
    disk(1024, read_only=True)
    with pytest.raises(FileError, match="Read-only"):
        export(stack, out)
    assert contents(out) == before


@pytest.mark.slow
def test_data_set_on_a_full_disk_stops_and_resumes(disk: Disk, tmp_path: Path) -> None:
    out = disk(2048)
    small = {"camera.resolution": [24, 18], "sampling.samples": 2}
    plan = DatasetPlan.of(scenes.load("step", small), 2)
    fill(out, leave_kib=20)
    with pytest.raises(DatasetError, match=r"No space left|cannot be written"):
        build(plan, out)
    (out / "ballast").unlink()
    built = build(plan, out)
    assert [record.status for record in built.records] == ["made", "made"]


def test_second_run_in_a_folder_is_refused(tmp_path: Path, call: Call) -> None:
    with locked(tmp_path):
        status, _, err = call("run", "step", "-o", tmp_path, small=True)
    assert status == 2
    assert "another run is writing" in err
    assert not list(tmp_path.iterdir())
    with locked(tmp_path):
        pass


def test_two_writers_of_one_file_leave_one_of_the_two(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    texts = ["x" * 100_000, "y" * 100_000]

    def write(text: str) -> None:
        for _ in range(100):
            with replacing(path) as staged:
                staged.write_text(text)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if path.exists():
            assert path.read_text() in texts
    assert list(tmp_path.iterdir()) == [path]


def test_file_times_are_ignored(small_run: Path, tmp_path: Path, call: Call) -> None:
    # Clocks jump, and files come from machines with wrong clocks.
    for name in ("transport.exr", "stack.exr"):
        (tmp_path / name).write_bytes((small_run / name).read_bytes())
    os.utime(tmp_path / "transport.exr", (4e9, 4e9))
    os.utime(tmp_path / "stack.exr", (0, 0))
    before = (tmp_path / "stack.exr").read_bytes()
    assert call("expose", tmp_path / "transport.exr", "-o", tmp_path / "stack.exr")[0] == 0
    assert (tmp_path / "stack.exr").read_bytes() == before
