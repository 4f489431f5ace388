"""What a shell or a program learns of how a command ended: 1 is a gate's verdict, and nothing else's."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import scenes
from fringebench.cli import FAULT, UNREAD

COMMAND = [sys.executable, "-m", "fringebench"]
Call = Callable[..., tuple[int, str, str]]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize("words", [["scenes", "bench"], ["scenes"], ["scenes", "--schema"]])
def test_an_answer_that_a_full_disk_lost_passes_for_done_or_for_a_failed_gate(
    words: list[str],
) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *words], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "fringebench: the answer cannot be written or read: No space left on device"
    ]


@pytest.mark.parametrize("words", [["scenes", "bench"], ["scenes", "--schema"]])
def test_a_reader_that_went_away_gets_a_traceback(words: list[str]) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [*COMMAND, *words], stdout=writer, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(writer)
    assert (done.returncode, done.stderr) == (UNREAD, "")


def test_a_command_without_output_streams_fails() -> None:
    for closed, words, status in ((">&-", "scenes bench", 0), ("2>&-", "scenes nowhere", 2)):
        line = f'"{sys.executable}" -m fringebench {words} {closed}'
        done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
        assert done.returncode == status, done.stderr


def test_a_fault_of_ours_passes_for_a_failed_gate(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(*_: object, **__: object) -> None:
        raise IndexError("list index out of range")

    monkeypatch.setattr(scenes, "load", wrong)
    status, _, err = call("regress", "decode:reconstruct", "--baseline", "missing.json")
    assert (status, "Traceback" in err) == (2, False)
    status, _, err = call("run", "step")
    assert status == FAULT
    assert "IndexError: list index out of range" in err
    assert err.endswith("please report it\n")
