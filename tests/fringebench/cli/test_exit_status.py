"""What a shell or a program learns of how a command ended: 1 is a gate's verdict, and nothing else's."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import scenes
from fringebench.cli.app import BROKEN_PIPE, INTERNAL_ERROR
from tests.conftest import Call


def ran(*words: str, **how: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fringebench", *words]
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, **how)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    "words",
    [
        ["scenes"],
        ["scenes", "--schema"],
        # Its file is written before standard output is, and is not to blame.
        ["render", "step", "--set=camera.resolution=[32,24]", "--set=sampling.samples=1"],
    ],
)
def test_output_lost_on_a_full_disk_ends_with_status_2(words: list[str], tmp_path: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = ran(*words, stdout=full, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "fringebench: standard output cannot be written: No space left on device"
    ]


@pytest.mark.parametrize("words", [["scenes", "bench"], ["scenes", "--schema"]])
def test_closed_pipe_ends_the_command_silently(words: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = ran(*words, stdout=writer)
    os.close(writer)
    assert (done.returncode, done.stderr) == (BROKEN_PIPE, "")


def test_command_without_output_streams_works() -> None:
    for closed, words, status in ((">&-", "scenes bench", 0), ("2>&-", "scenes nowhere", 2)):
        line = f'"{sys.executable}" -m fringebench {words} {closed}'
        done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr


def test_internal_error_has_its_own_status_and_a_traceback(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(*_: object, **__: object) -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr(scenes, "load", wrong)
    status, _, err = call("regress", "decode:reconstruct", "--baseline", "missing.json")
    assert (status, "Traceback" in err) == (2, False)
    status, _, err = call("run", "step")
    assert status == INTERNAL_ERROR
    assert "IndexError: list index out of range" in err
    assert err.endswith("please report it\n")
