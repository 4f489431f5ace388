"""Frames in a mapped file equal frames in memory, and take no memory."""

import mmap
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decode
import render
import scenes
from scenes.support import mapped, memory
from scenes.support.errors import TooLargeError
from tests.commands import program
from tests.scenes.files.test_exr import full_disk


def in_a_file(array: np.ndarray) -> bool:
    base: Any = array
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base.obj if isinstance(base, memoryview) else base, mmap.mmap)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where temporary files go."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_mapped_frames_equal_frames_in_memory(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path_factory.mktemp("out")
    light = render.trace(scenes.load("bench", {"camera.resolution": [67, 49]}), samples=2)
    stack = render.expose(light)
    stack.write(out / "held.exr")
    heights = decode.reconstruct(stack).height_mm
    monkeypatch.setattr(mapped, "MAX_IN_MEMORY_BYTES", 1000)
    other = render.expose(light)
    other.write(out / "mapped.exr")
    back = scenes.Stack.read(out / "held.exr")
    light.write(out / "light.exr")
    again = render.Transport.read(out / "light.exr")
    assert in_a_file(again.total)
    for kind in ("total", "direct", "ambient", "label"):
        assert np.array_equal(getattr(again, kind), getattr(light, kind)), kind
    assert not in_a_file(stack.frames)
    for one in (other, back):
        assert in_a_file(one.frames)
        assert np.array_equal(one.frames, stack.frames)
        assert np.array_equal(decode.reconstruct(one).height_mm, heights, equal_nan=True)
    assert (out / "mapped.exr").read_bytes() == (out / "held.exr").read_bytes()
    # The file has no name: nothing to clean up, however the process ends.
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("held", [0, 2**30])
def test_released_pages_keep_their_values(
    held: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mapped, "MAX_IN_MEMORY_BYTES", held)
    array = mapped.array((3, 100_000), np.uint16, "this", "go away")
    array[:] = np.arange(3)[:, None]
    for part in (array, array[1], array[:, 5:].reshape(-1), np.zeros(3)):
        mapped.release_pages(part)
    assert np.array_equal(array.sum(axis=1), [0, 100_000, 200_000])


def test_arrays_are_mapped_from_disk_when_memory_is_short(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ask() -> np.ndarray:
        return mapped.array((1000,), np.float64, "this", "go away")

    assert not in_a_file(ask())
    monkeypatch.setattr(memory, "available_bytes", lambda: 10_000)
    assert in_a_file(ask())
    # Better in memory than not at all.
    monkeypatch.setattr(mapped, "free_disk_bytes", lambda folder: 100)
    assert not in_a_file(ask())
    monkeypatch.setattr(memory, "available_bytes", lambda: 5000)
    with pytest.raises(TooLargeError, match=rf"this needs.*'{folder}' are free: go away, or let"):
        ask()


def test_full_disk_is_refused_before_anything_is_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A page that finds no room on the disk ends the process by a signal.
    monkeypatch.setattr(mapped, "MAX_IN_MEMORY_BYTES", 0)
    with full_disk(100_000), pytest.raises(TooLargeError, match=r"no room.*: go away"):
        mapped.array((100_001,), np.uint8, "this", "go away")
    assert list(folder.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="no such call here")
def test_disk_room_is_reserved_by_zeros_without_posix_fallocate(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(os, "posix_fallocate")
    monkeypatch.setattr(mapped, "MAX_IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(mapped, "_ZEROS", bytes(1000))
    array = mapped.array((2500,), np.uint8, "this", "go away")
    assert in_a_file(array)
    array[:] = 7
    assert array.sum() == 7 * 2500


def test_temporary_files_are_on_a_disk_unless_tmpdir_is_set(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memories: Callable[..., None] = lambda *names: monkeypatch.setattr(  # noqa: E731
        mapped, "_in_memory", lambda path: str(path) in names
    )
    monkeypatch.delenv("TMPDIR", raising=False)
    memories(str(folder))
    assert mapped._folder() == Path("/var/tmp")
    memories(str(folder), "/var/tmp")
    assert mapped._folder() == folder
    memories(str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    assert mapped._folder() == folder


@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="Linux's files in memory")
def test_folder_kept_in_memory_is_detected() -> None:
    assert mapped._in_memory(Path("/dev/shm"))
    assert not mapped._in_memory(Path("/proc"))


PEAK = """
    import dataclasses, os, re, resource, sys
    os.cpu_count = lambda: 2  # each thread's stack counts
    import numpy as np
    import decode, render, scenes
    from scenes.files import exr_rows
    from scenes.support import mapped
    from scenes.support.errors import TooLargeError

    path, steps, mapped.MAX_IN_MEMORY_BYTES = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    exr_rows.BAND_BYTES = 2**24
    size = {"camera.resolution": [1800, 1350], "patterns.steps": steps}
    own = {"patterns.periods_px": [16.0, 1024.0], "exposures.relative": [1.0], "sensor.read_noise_e": 0.0}
    small = scenes.load("bench", {"camera.resolution": [60, 45], "patterns.steps": steps} | own)
    light = render.trace(small, samples=1)
    decode.reconstruct(render.expose(light))

    def wide(image):  # what is seen does not matter
        return np.tile(image, [1] * (image.ndim - 2) + [30, 30])

    large = dataclasses.replace(
        light, total=wide(light.total), direct=wide(light.direct), ambient=wide(light.ambient),
        label=wide(light.label), scene=scenes.load("bench", size | own),
    )
    status = open("/proc/self/status").read()
    limit = int(re.search(r"VmData:\\s+(\\d+)", status)[1]) * 1024 + int(sys.argv[4])
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    try:
        stack = render.expose(large, noise=False)
        stack.write(path)
        del stack, large
        print(decode.reconstruct(scenes.Stack.read(path)).valid.any())
    except (TooLargeError, MemoryError) as error:
        print("refused", error)
    """


@pytest.mark.skipif(sys.platform != "linux", reason="limits of private memory are Linux's")
@pytest.mark.slow
def test_memory_does_not_grow_with_frames(tmp_path: Path) -> None:
    """Exposed, written, read and decoded in less memory than the frames take; held in memory, they do not fit."""
    # 120 frames of 1800 x 1350 pixels in uint16: 556 MiB. In bands they need about 200: a fixed part of 80, which grows with
    # the machine's threads and their allocators, and a chunk of each frame. The room is half-way.
    room = 350 * 2**20
    outcomes = {}
    for frames, held in ((12, 0), (120, 0), (120, 2**30)):
        words = (tmp_path / "a.exr", frames // 2, held, room)
        done = program(PEAK, *words, env={"TMPDIR": str(tmp_path)})
        assert done.returncode == 0, (frames, held, done.stderr[-500:])
        outcomes[frames, held] = done.stdout.split()[0]
    assert outcomes == {(12, 0): "True", (120, 0): "True", (120, 2**30): "refused"}
