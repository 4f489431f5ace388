"""Requests beyond memory are refused before they start, with what they need, what is free and what to change."""

import re
import struct
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import decode
import render
import scenes
from scenes.files import exr
from scenes.support import mapped, memory
from scenes.support.errors import FileError, TooLargeError
from tests.commands import program
from tests.conftest import Call

GIB = 2**30


@pytest.fixture
def free(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Make the machine report that many free bytes of memory and disk."""

    def say(count: int) -> None:
        monkeypatch.setattr(memory, "available_bytes", lambda: count)
        monkeypatch.setattr(mapped, "free_disk_bytes", lambda folder: count)

    return say


@pytest.mark.slow
def test_scene_beyond_memory_is_refused_at_once(
    free: Callable[[int], None], transport: render.Transport
) -> None:
    free(4 * GIB)
    size = (11_600, 8_700)
    huge = scenes.load("step", {"camera.resolution": list(size)})
    with pytest.raises(TooLargeError, match=r"11600 x 8700 pixels.*GiB are free: lower camera"):
        render.trace(huge)
    # 100 Mpx of light by broadcasting, without the memory.
    plane = np.broadcast_to(np.float32(1.0), size[::-1])
    light = np.broadcast_to(plane, (*transport.total.shape[:2], *plane.shape))
    label = np.broadcast_to(np.uint16(0), size[::-1])
    wide = render.Transport(
        light, light, plane, label, transport.labels, transport.bases, huge, 0, 2, 3
    )
    with pytest.raises(TooLargeError, match=r"4 exposures of 12 frames .* are free: take fewer"):
        render.expose(wide, exposures=[1.0, 2.0, 4.0, 8.0])


@pytest.mark.parametrize("command", ["run", "render"])
def test_command_refuses_too_large_a_scene_before_it_starts(
    command: str, free: Callable[[int], None], tmp_path: Path, call: Call
) -> None:
    free(GIB)
    out = tmp_path / ("out" if command == "run" else "transport.exr")
    status, _, err = call(command, "bench", "-o", out, "--set", "camera.resolution=[20000,15000]")
    assert status == 2
    assert re.search(r"20000 x 15000 pixels.*needs about .*GiB of memory, 1 GiB are free", err)
    assert not out.is_file()


def test_truth_decoding_and_reading_check_memory(
    free: Callable[[int], None], small_run: Path, transport: render.Transport
) -> None:
    stack = scenes.Stack.read(small_run / "stack.exr")
    free(1000)
    for ask in (
        lambda: render.truth(transport.scene, transport),
        lambda: decode.reconstruct(stack),
        lambda: scenes.Stack.read(small_run / "stack.exr"),
        lambda: render.Transport.read(small_run / "transport.exr"),
    ):
        with pytest.raises(TooLargeError, match="are free"):
            ask()


def test_memory_error_is_reported_as_too_large() -> None:
    with (
        pytest.raises(TooLargeError, match="more than is free: go away"),
        memory.room_for(1, "this", "go away"),
    ):
        raise MemoryError


def test_limits_of_container_and_process_are_respected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if memory.available_bytes() is None:
        pytest.skip("this system does not say how much memory is free")
    monkeypatch.setattr(memory, "CGROUP", tmp_path)
    whole = memory.available_bytes()
    assert whole is not None
    # cgroup version 2: cached pages of files can be dropped, so they are free.
    (tmp_path / "memory.max").write_text("50000000\n")
    (tmp_path / "memory.current").write_text("30000000\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 5000000\n")
    assert memory.available_bytes() == 25_000_000
    (tmp_path / "memory.max").write_text("max\n")
    assert memory.available_bytes() == pytest.approx(whole, rel=0.5)


@pytest.mark.skipif(sys.platform != "linux", reason="address-space limits are a feature of Linux")
@pytest.mark.slow
def test_hard_memory_limit_gives_an_error_and_no_crash() -> None:
    """Out of memory, Dr.Jit ends the process; the estimate must be above the memory used, at any size."""
    script = """
        import re, resource, sys
        import render, scenes
        from scenes.support.errors import TooLargeError

        small = scenes.load("step", {"camera.resolution": [64, 48]})
        light = render.trace(small, samples=2)
        render.expose(light)
        status = open("/proc/self/status").read()
        taken = int(re.search(r"VmSize:\\s+(\\d+)", status)[1]) * 1024
        limit = taken + int(float(sys.argv[2]) * 2**30)
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        try:
            width = int(sys.argv[1])
            render.trace(small.model_copy(update={
                "camera": small.camera.model_copy(update={"resolution": (width, width * 3 // 4)})
            }), samples=2)
        except TooLargeError as error:
            print("refused", error)
        else:
            print("done")
        """
    outcomes = []
    for width, gib in ((1600, 0.1), (1600, 0.25), (1600, 0.31), (1600, 0.6), (12_000, 1.0)):
        done = program(script, width, gib)
        assert done.returncode == 0, (width, gib, done.returncode, done.stderr[-500:])
        outcomes.append(done.stdout.split()[0])
    assert outcomes[0] == outcomes[-1] == "refused"
    assert outcomes[3] == "done"


@pytest.mark.skipif(sys.platform != "linux", reason="address-space limits are a feature of Linux")
@pytest.mark.parametrize(
    ("words", "limit_mb"), [(["run", "step"], 300), (["run", "step"], 600), (["decode", "x"], 1000)]
)
def test_address_space_too_small_for_the_libraries_ends_in_one_line(
    words: list[str], limit_mb: int, tmp_path: Path
) -> None:
    """They end the process by a signal: it is refused before they are loaded."""
    script = f"""
        import resource, sys
        resource.setrlimit(resource.RLIMIT_AS, ({limit_mb} << 20, {limit_mb} << 20))
        sys.argv[1:] = {words}
        from fringebench.cli.app import main
        main()
        """
    done = program(script, folder=tmp_path)
    assert done.returncode == 2
    assert re.fullmatch(
        r"fringebench: .* address space \(ulimit -v\).*raise the limit.*\n", done.stderr
    )
    assert not list(tmp_path.iterdir())


def claiming(whole: bytes, width: int, height: int) -> bytes:
    """An EXR file whose header says another size."""
    changed = bytearray(whole)
    for name in (b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"):
        at = changed.index(name) + len(name) + 4
        changed[at : at + 16] = struct.pack("<4i", 0, 0, width - 1, height - 1)
    return bytes(changed)


SIZES = (
    (10**9, 10**9),
    (2**31 - 1, 2**31 - 1),
    (10, 10**9),
    (10**9, 8),
    (10**8, 16),
    (100_000, 100_000),
    (0, 0),
    (-5, -5),
)


@pytest.mark.parametrize("size", SIZES)
def test_exr_header_that_claims_too_much_is_refused(
    size: tuple[int, int], tmp_path: Path, free: Callable[[int], None]
) -> None:
    free(8 * GIB)
    path = tmp_path / "a.exr"
    exr.write(path, "thing", {"x": np.zeros((8, 10), np.float16)}, {})
    path.write_bytes(claiming(path.read_bytes(), *size))
    with pytest.raises((FileError, TooLargeError), match=str(path)):
        exr.read(path, "thing")


@pytest.mark.skipif(sys.platform != "linux", reason="peak memory as Linux reports it")
def test_exr_header_that_claims_too_much_allocates_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "whole.exr"
    exr.write(path, "thing", {"x": np.zeros((8, 10), np.float16)}, {})
    paths = []
    for i, size in enumerate(SIZES):
        paths.append(tmp_path / f"{i}.exr")
        paths[-1].write_bytes(claiming(path.read_bytes(), *size))
    script = f"""
        import resource
        from scenes.files import exr
        from scenes.support.errors import FringebenchError
        exr.read({str(path)!r}, "thing")
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        for path in {[str(p) for p in paths]}:
            try:
                exr.read(path, "thing")
            except FringebenchError:
                continue
            raise SystemExit(f"{{path}} was read")
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
        """
    done = program(script)
    assert done.returncode == 0, done.stderr
    # A few pages of code, no images.
    assert int(done.stdout) < 20_000
