"""Disks that are full, read-only or shared: a message and status 2, and every file that was there still is."""

import os
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

import scenes
from fringebench.alone import alone
from fringebench.datasets.build import build
from fringebench.datasets.plan import Plan
from fringebench.export import export
from scenes.errors import DatasetError, FileError
from scenes.replace_file import UNFINISHED, replacing

Call = Callable[..., tuple[int, str, str]]
Disk = Callable[..., Path]


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def fill(folder: Path, leave_kib: int) -> None:
    """Leave that much room on a small disk."""
    room = os.statvfs(folder)
    (folder / "ballast").write_bytes(bytes(room.f_bavail * room.f_frsize - leave_kib * 1024))


WRITERS: dict[str, Callable[[Path, Path], list[str | Path]]] = {
    "run": lambda made, out: ["run", "step", "-o", out],
    "render": lambda made, out: ["render", "step", "-o", out / "transport.exr", "--truth", out / "truth.exr"],
    "expose": lambda made, out: ["expose", made / "transport.exr", "-o", out / "stack.exr"],
    "decode": lambda made, out: ["decode", made / "stack.exr", "-o", out / "reconstruction.exr"],
    "evaluate": lambda made, out: ["evaluate", made / "reconstruction.exr", made / "truth.exr", "-o", out / "scores.json"],
    "export": lambda made, out: ["export", made / "stack.exr", "-o", out],
    "view": lambda made, out: ["view", made / "stack.exr", "-o", out / "view.html"],
    "convert": lambda made, out: ["convert", made / "reconstruction.exr", "-o", out / "cloud.ply"],
}  # fmt: skip
SCENES = ("run", "render")


@pytest.mark.parametrize("command", WRITERS)
def test_a_full_disk_keeps_what_was_there(command: str, made: Path, disk: Disk, call: Call) -> None:
    out = disk(4096)
    words = WRITERS[command](made, out)
    assert call(*words, small=command in SCENES)[0] == 0
    fill(out, leave_kib=0)
    before = contents(out)
    status, _, err = call(*words, small=command in SCENES)
    assert status == 2
    assert "No space left" in err or "cannot write" in err
    assert contents(out) == before


@pytest.mark.parametrize("leave_kib", [4, 16, 40])
def test_a_disk_that_fills_during_a_run_keeps_whole_files(
    leave_kib: int, disk: Disk, call: Call
) -> None:
    out = disk(2048)
    fill(out, leave_kib)
    status, _, err = call("run", "step", "-o", out, small=True)
    assert (status, "No space left" in err or "cannot write" in err) == (2, True)
    for name, read in (("transport.exr", scenes.exr.kind_of), ("scene.toml", scenes.load)):
        if (out / name).exists():
            read(out / name)
    assert not [name for name in contents(out) if UNFINISHED in name]


@pytest.mark.parametrize("command", WRITERS)
def test_a_read_only_disk_is_told(command: str, made: Path, disk: Disk, call: Call) -> None:
    out = disk(64, read_only=True)
    status, _, err = call(*WRITERS[command](made, out), small=command in SCENES)
    assert status == 2
    assert "Read-only file system" in err


def test_an_export_that_cannot_be_replaced_keeps_its_manifest(made: Path, disk: Disk) -> None:
    out = disk(1024)
    stack = scenes.Stack.read(made / "stack.exr")
    export(stack, out)
    before = contents(out)
    disk(1024, read_only=True)
    with pytest.raises(FileError, match="Read-only"):
        export(stack, out)
    assert contents(out) == before


def test_a_data_set_on_a_full_disk_stops_and_goes_on(disk: Disk, tmp_path: Path) -> None:
    out = disk(2048)
    small = {"camera.resolution": [24, 18], "sampling.samples": 2}
    plan = Plan.of(scenes.load("step", small), 2)
    fill(out, leave_kib=20)
    with pytest.raises(DatasetError, match=r"No space left|cannot be written"):
        build(plan, out)
    (out / "ballast").unlink()
    built = build(plan, out)
    assert [record.status for record in built.records] == ["made", "made"]


def test_two_runs_do_not_share_a_folder(tmp_path: Path, call: Call) -> None:
    with alone(tmp_path):
        status, _, err = call("run", "step", "-o", tmp_path, small=True)
    assert status == 2
    assert "another run is writing" in err
    assert not list(tmp_path.iterdir())
    with alone(tmp_path):
        pass


def test_two_writers_of_one_file_leave_one_of_the_two(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    texts = ["x" * 100_000, "y" * 100_000]

    def write(text: str) -> None:
        for _ in range(100):
            with replacing(path) as beside:
                beside.write_text(text)

    threads = [threading.Thread(target=write, args=(text,)) for text in texts]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        if path.exists():
            assert path.read_text() in texts
    assert list(tmp_path.iterdir()) == [path]


def test_times_of_files_mean_nothing(made: Path, tmp_path: Path, call: Call) -> None:
    # clocks jump, and files come from machines whose clocks are wrong
    for name in ("transport.exr", "stack.exr"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    os.utime(tmp_path / "transport.exr", (4e9, 4e9))
    os.utime(tmp_path / "stack.exr", (0, 0))
    before = (tmp_path / "stack.exr").read_bytes()
    assert call("expose", tmp_path / "transport.exr", "-o", tmp_path / "stack.exr")[0] == 0
    assert (tmp_path / "stack.exr").read_bytes() == before
