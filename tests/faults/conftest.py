"""Files of one small run, and small or read-only disks."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import render
from tests.commands import SMALL, Done
from tests.conftest import Call


@pytest.fixture(scope="session")
def transport(small_run: Path) -> render.Transport:
    """Transport of that run."""
    return render.Transport.read(small_run / "transport.exr")


@pytest.fixture
def call(call: Call) -> Call:
    """Run the command line, on a small scene with `small`."""

    def command(*words: str | Path, small: bool = False) -> Done:
        return call(*words, *(SMALL if small else ()))

    return command


Disk = Callable[..., Path]


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    """Mount a tmpfs of some KiB, or remount it read-only; skips if that is not allowed."""
    mounted: list[Path] = []

    def mount(kib: int = 1024, read_only: bool = False) -> Path:
        point = tmp_path / "disk"
        point.mkdir(exist_ok=True)
        options = f"size={kib}k"
        if point in mounted:
            options += ",remount"
        if read_only:
            options += ",ro"
        done = (
            subprocess.run(
                ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(point)],
                capture_output=True,
                text=True,
                check=False,
            )
            if sys.platform == "linux"
            else None
        )
        if done is None or done.returncode:
            pytest.skip(
                f"no disk can be mounted here: {done.stderr.strip() if done else sys.platform}"
            )
        if point not in mounted:
            mounted.append(point)
        return point

    yield mount
    for point in mounted:
        subprocess.run(["umount", str(point)], check=True)
