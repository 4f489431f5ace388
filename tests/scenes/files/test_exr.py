"""The project's EXR files under damage: every failure is a `FileError`, and what was there before stays."""

import json
import multiprocessing
import os
import resource
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from scenes.files import exr, exr_rows
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError

RNG = np.random.default_rng(5)
# Counts with noise on a fringe, radiance, labels: every channel type, and chunks that compress well and badly.
ROWS, COLUMNS = 203, 61
FRINGE = 800 + 700 * np.cos(np.arange(COLUMNS) / 9)
CHANNELS: dict[str, np.ndarray] = {
    "single": RNG.normal(size=(ROWS, COLUMNS)).astype(np.float32),
    "half": RNG.poisson(np.broadcast_to(FRINGE, (ROWS, COLUMNS))).astype(np.float16),
    "whole": np.repeat(np.arange(ROWS, dtype=np.uint32)[:, None] // 50, COLUMNS, axis=1),
}


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands of a chunk or two."""
    monkeypatch.setattr(exr_rows, "BAND_BYTES", 64 * COLUMNS * 10)


def read_rows(path: Path, kind: str = "thing") -> dict[str, np.ndarray]:
    """The channels of a file, read band by band."""
    with exr_rows.reading(path, kind) as bands:
        parts = [channels for _, channels in bands]
    return {name: np.concatenate([part[name] for part in parts]) for name in bands.names}


WAYS: dict[str, tuple[Callable[..., None], Callable[..., Any]]] = {
    "at once": (exr.write, exr.read),
    "by rows": (exr_rows.write, read_rows),
}
both_ways = pytest.mark.parametrize(("write", "read"), WAYS.values(), ids=WAYS)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.exr"
    exr.write(path, "thing", CHANNELS, {"note": "µ"})
    return path


def test_channels_and_meta_survive_exactly(file: Path) -> None:
    channels, meta = exr.read(file, "thing")
    assert meta["note"] == "µ"
    assert exr.kind_of(file) == "thing"
    assert channels.keys() == CHANNELS.keys()
    for name, plane in CHANNELS.items():
        assert channels[name].dtype == plane.dtype
        assert np.array_equal(channels[name], plane)


def test_views_and_other_memory_layouts_are_written_correctly(tmp_path: Path) -> None:
    base = np.arange(24, dtype=np.float32).reshape(4, 6)
    views = {"a": base[:, ::2], "b": base[::-1, :3], "c": np.asfortranarray(base[:, :3])}
    exr.write(tmp_path / "a.exr", "thing", views, {})
    back, _ = exr.read(tmp_path / "a.exr", "thing")
    for name, view in views.items():
        assert np.array_equal(back[name], view)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda p: p.unlink(), "does not exist"),
        (lambda p: (p.unlink(), p.mkdir()), "is a folder"),
        (lambda p: p.write_bytes(b""), "truncated, damaged or no OpenEXR"),
        (lambda p: p.write_text("not an image\n" * 100), "truncated, damaged or no OpenEXR"),
        (lambda p: p.write_bytes(p.read_bytes()[:4] + bytes(400)), "truncated, damaged or no"),
    ],
    ids=["missing", "folder", "empty", "text", "magic-only"],
)
def test_file_that_is_not_exr_is_refused(
    file: Path, make: Callable[[Path], object], says: str
) -> None:
    make(file)
    for ask in (lambda: exr.read(file, "thing"), lambda: exr.kind_of(file)):
        with pytest.raises(FileError, match=says) as failure:
            ask()
        assert str(file) in str(failure.value)


@both_ways
def test_truncated_file_is_refused_and_nothing_is_printed(
    file: Path, capfd: pytest.CaptureFixture[str], write: Any, read: Callable[..., Any]
) -> None:
    whole = file.read_bytes()
    for length in sorted({*range(0, 1000, 13), *range(1000, len(whole), 977), len(whole) - 1}):
        file.write_bytes(whole[:length])
        with pytest.raises(FileError, match=r"truncated,? (or )?damaged"):
            read(file, "thing")
    # The library prints by itself, on both streams: an answer in JSON on stdout would be spoilt.
    assert capfd.readouterr() == ("", "")


@both_ways
def test_flipped_bytes_raise_nothing_but_file_errors(
    file: Path, write: Any, read: Callable[..., Any]
) -> None:
    whole = file.read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        # Mostly in the header and the table of chunks, where one byte can mean anything.
        for at in rng.integers(0, 800 if rng.random() < 0.8 else len(whole), rng.integers(1, 5)):
            damaged[at] = rng.integers(256)
        file.write_bytes(damaged)
        try:
            read(file, "thing")
        except FileError:
            refused += 1
    assert refused > 50


def header(**own: object) -> dict[str, Any]:
    plain = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    return plain | own


@pytest.mark.parametrize(
    ("attributes", "says"),
    [
        ({}, "not one of fringebench's"),
        ({"fringebench": "{not json"}, "header is damaged"),
        ({"fringebench": "[1, 2]"}, "no JSON object"),
        ({"fringebench": json.dumps({"format": "other", "version": 1})}, "a other file where"),
        ({"fringebench": json.dumps({"format": "thing", "version": 99})}, "version 99.*reads 1"),
        ({"fringebench": json.dumps({"format": "thing"})}, "version None"),
        ({"fringebench": 7}, "not one of fringebench's"),
    ],
    ids=["foreign", "bad-json", "list", "kind", "version", "no-version", "number"],
)
def test_foreign_exr_is_refused(tmp_path: Path, attributes: dict[str, Any], says: str) -> None:
    path = tmp_path / "foreign.exr"
    channels = {"Y": np.zeros((4, 5), np.float32)}
    OpenEXR.File(header(**attributes), channels).write(str(path))
    with pytest.raises(FileError, match=says):
        exr.read(path, "thing")


@pytest.mark.parametrize(
    "channels",
    [
        {"x": np.zeros((4, 5), np.float64)},
        {"x": np.zeros((4, 5), np.uint8)},
        {"x": np.zeros((2, 4, 5), np.float32)},
        {"x": np.zeros((4, 5), np.float32), "y": np.zeros((5, 4), np.float32)},
        {"x": np.zeros((0, 5), np.float32)},
        {},
    ],
    ids=["float64", "uint8", "three-axes", "two-sizes", "no-pixels", "no-channels"],
)
def test_invalid_channels_are_refused_and_leave_no_file(
    tmp_path: Path, channels: dict[str, np.ndarray]
) -> None:
    with pytest.raises(FileError, match="cannot write"):
        exr.write(tmp_path / "a.exr", "thing", channels, {})
    assert list(tmp_path.iterdir()) == []


@contextmanager
def full_disk(limit: int) -> Iterator[None]:
    """No file of this process may grow beyond `limit` bytes: what a write sees when the disk is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    previous = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, previous)


@both_ways
@pytest.mark.parametrize("limit", [0, 100, 20_000])
def test_full_disk_keeps_the_old_file(
    file: Path, limit: int, write: Callable[..., None], read: Callable[..., Any]
) -> None:
    old = file.read_bytes()
    assert len(old) > 20_000
    with full_disk(limit), pytest.raises(FileError, match="cannot write"):
        write(file, "thing", CHANNELS, {})
    assert file.read_bytes() == old
    assert list(file.parent.iterdir()) == [file]
    write(file, "thing", CHANNELS, {})
    assert read(file, "thing")


def test_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"cannot write.*folder that exists and is writable"):
        exr.write(tmp_path / "none" / "a.exr", "thing", CHANNELS, {})


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_unwritable_folder_is_named_and_the_old_file_stays(file: Path) -> None:
    old = file.read_bytes()
    file.parent.chmod(0o500)
    try:
        with pytest.raises(FileError, match="folder that exists and is writable"):
            exr.write(file, "thing", CHANNELS, {})
    finally:
        file.parent.chmod(0o700)
    assert file.read_bytes() == old


def test_folder_that_refuses_new_files_keeps_the_old_one(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = file.read_bytes()

    def refuse(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("scenes.support.atomic_file.os.open", refuse)
    with pytest.raises(FileError, match="Permission denied; choose a folder"):
        exr.write(file, "thing", CHANNELS, {})
    assert file.read_bytes() == old


@pytest.mark.parametrize("path", ["/dev/null", "/dev/full", "/", ""])
def test_devices_and_folders_are_never_replaced(path: str) -> None:
    with pytest.raises(FileError, match="a folder or a device"):
        exr.write(path, "thing", CHANNELS, {})
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("path", ["a" * 300, "a\0b"])
def test_invalid_names_are_file_errors(tmp_path: Path, path: str) -> None:
    with pytest.raises(FileError, match="cannot write"):
        exr.write(tmp_path / path, "thing", CHANNELS, {})


def test_link_stays_and_its_target_is_replaced(file: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.exr"
    link.symlink_to(file)
    exr.write(link, "other", CHANNELS, {})
    assert link.is_symlink()
    assert exr.kind_of(file) == "other"


def test_files_follow_the_umask_and_do_not_change_it(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        with replacing(tmp_path / "a.txt") as staged:
            staged.write_text("x")
        assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)


def test_interrupted_block_leaves_only_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(KeyboardInterrupt), replacing(target) as staged:
        staged.write_text("half of the n")
        raise KeyboardInterrupt
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_failing_threads_restore_stderr(tmp_path: Path) -> None:
    before = os.fstat(2)
    good, bad = tmp_path / "good.exr", tmp_path / "bad.exr"
    exr.write(good, "thing", CHANNELS, {})
    bad.write_bytes(good.read_bytes()[:3000])
    failures: list[str] = []

    def work(number: int) -> None:
        own = tmp_path / f"{number}.exr"
        for _ in range(10):
            exr.write(own, "thing", CHANNELS, {"number": number})
            if exr.read(own, "thing")[1]["number"] != number:
                failures.append("another thread's file")
            try:
                exr.read(bad, "thing")
                failures.append("a damaged file was read")
            except FileError as error:
                if "EXR_ERR" not in str(error):
                    failures.append(f"another thread's message: {error}")

    threads = [threading.Thread(target=work, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
    after = os.fstat(2)
    assert (after.st_dev, after.st_ino) == (before.st_dev, before.st_ino)


def test_output_of_other_threads_is_passed_on(
    file: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    library = OpenEXR.File

    def chatty(*args: object, **kwargs: object) -> object:
        print("on stdout")
        os.write(2, b"on stderr\n")
        return library(*args, **kwargs)

    monkeypatch.setattr(OpenEXR, "File", chatty)
    exr.kind_of(file)
    assert capfd.readouterr() == ("on stdout\n", "on stderr\n")


@pytest.mark.skipif(sys.platform != "linux", reason="fork is Linux's way")
@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_forked_child_can_read_and_write(tmp_path: Path) -> None:
    # OpenEXR's worker threads do not live on in a child, which would wait for them forever.
    plane = np.random.default_rng(0).normal(size=(500, 500)).astype(np.float32)
    path = tmp_path / "a.exr"
    exr.write(path, "thing", {"x": plane}, {})

    def child() -> None:
        back = exr.read(path, "thing")[0]
        exr.write(tmp_path / "b.exr", "thing", back, {})

    process = multiprocessing.get_context("fork").Process(target=child)
    process.start()
    process.join(60)
    hung = process.is_alive()
    process.kill()
    assert not hung
    assert process.exitcode == 0
    assert np.array_equal(exr.read(tmp_path / "b.exr", "thing")[0]["x"], plane)
