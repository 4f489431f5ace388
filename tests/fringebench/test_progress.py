"""Long steps say how far they are, and an interrupt leaves whole files and says which."""

import io
import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

import render
import scenes
from fringebench import progress
from fringebench.progress import Lines, Mode, Steps

COMMAND = [sys.executable, "-m", "fringebench"]


def console(terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=80)


def said(where: Console) -> str:
    assert isinstance(where.file, io.StringIO)
    return where.file.getvalue()


def test_a_pipe_gets_lines_nobody_asked_for() -> None:
    for mode in (Mode.AUTO, Mode.NONE):
        quiet = console(terminal=False)
        with Steps(quiet, mode).step("work") as done:
            done(0.5)
        assert said(quiet) == ""


def test_a_terminal_shows_no_bar_or_keeps_it() -> None:
    shown = console(terminal=True)
    steps = Steps(shown)
    with steps.step("outer"), steps.step("work") as done:
        for i in range(5):
            done(i / 5)
            time.sleep(0.12)  # rich draws ten times a second
    text = said(shown)
    assert "work" in text
    assert re.search(r"\b[2468]0%", text)
    assert set(steps.seconds) == {"outer", "work"}
    assert steps.seconds["work"] > 0.5


def test_plain_lines_lack_the_share_or_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    where = console(terminal=False)
    with Steps(where, Mode.PLAIN).step("work") as done:
        for share in (0.1, 0.2, 0.3, 0.4):
            now[0] += 2.0
            done(share)
    # A line every 3 s at most: after 4 s a fifth was done, so four times as long is left.
    assert said(where).splitlines() == [
        "work: started",
        "work: 20 %, about 16 s left",
        "work: 40 %, about 12 s left",
        "work: done in 8.0 s",
    ]


def test_what_an_earlier_run_did_counts_as_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    where = console(terminal=False)
    lines = Lines(where, "samples", resumes=True)
    lines.report(0.5, "50 of 100")
    now[0] = 10.0
    lines.report(0.6, "60 of 100")
    assert said(where).splitlines() == ["samples: 60 %, 60 of 100, about 40 s left"]


def test_tracing_tells_no_progress_or_tiles_change_the_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = scenes.load("step", {"camera.resolution": [64, 48], "sampling.samples": 2})
    told: list[float] = []
    whole = render.trace(scene)
    monkeypatch.setattr("render.tracer.TILE_S", 0.0)
    monkeypatch.setattr("render.tracer.FIRST_TILE_PATHS", 64 * 8 * 2)
    tiled = render.trace(scene, progress=told.append)
    assert (whole.total == tiled.total).all()
    assert told[-1] == 1.0
    assert told == sorted(set(told))
    assert len(told) == 1 + 40, "one tile of 8 rows, then of 1: no time allowed"


def test_exposing_tells_no_progress() -> None:
    scene = scenes.load("step", {"camera.resolution": [32, 24], "sampling.samples": 2})
    told: list[float] = []
    render.expose(render.trace(scene), progress=told.append)
    assert told == [(i + 1) / 12 for i in range(12)]


def _interrupted(words: list[str], when: str, cwd: Path) -> tuple[int, str]:
    """Exit status and stderr of a command that gets a SIGINT once it has said `when`."""
    running = subprocess.Popen([*COMMAND, *words], stderr=subprocess.PIPE, text=True, cwd=cwd)
    assert running.stderr is not None
    heard = ""
    for line in running.stderr:
        heard += line
        if when in line:
            running.send_signal(signal.SIGINT)
            break
    heard += running.stderr.read()
    running.stderr.close()
    return running.wait(timeout=60), heard


def test_ctrl_c_leaves_half_files_a_traceback_or_no_word_of_what_is_kept(tmp_path: Path) -> None:
    # Minutes of light, were it not interrupted.
    words = ["run", "step", "-o", "out", "--progress", "plain", "--set", "sampling.samples=20000"]
    status, heard = _interrupted(words, "trace light: started", tmp_path)
    assert status == 130
    assert heard.splitlines()[-1] == "fringebench: interrupted; whole and kept in out: scene.toml"
    assert "Traceback" not in heard
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["scene.toml"]
    assert scenes.load(tmp_path / "out" / "scene.toml").name == "step"


def test_ctrl_c_late_in_a_run_forgets_what_was_written(tmp_path: Path) -> None:
    small = ["--set", "camera.resolution=[64,48]", "--set", "sampling.samples=4"]
    words = ["run", "step", "-o", "out", "--progress", "plain", *small]
    status, heard = _interrupted(words, "report: started", tmp_path)
    assert status == 130
    kept = heard.splitlines()[-1].split("kept in out: ")[1].split(", ")
    assert {"transport.exr", "truth.exr", "stack.exr", "reconstruction.exr"} <= set(kept)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(kept)
    scenes.Stack.read(tmp_path / "out" / "stack.exr")


def test_ctrl_c_in_a_stage_is_no_failed_gate(tmp_path: Path) -> None:
    words = ["render", "step", "--progress", "plain", "--set", "sampling.samples=20000"]
    status, heard = _interrupted(words, "trace light: started", tmp_path)
    assert status == 130
    assert heard.splitlines()[-1] == "fringebench: interrupted; no file is left half written"
    assert list(tmp_path.iterdir()) == []


def test_a_terminal_is_left_without_its_cursor(tmp_path: Path) -> None:
    """A real pseudo terminal: the bar appears, and Ctrl-C gives the cursor back."""
    controller, terminal = pty.openpty()
    words = ["render", "step", "--set", "sampling.samples=20000"]
    running = subprocess.Popen(
        [*COMMAND, *words], stderr=terminal, cwd=tmp_path, env={**os.environ, "TERM": "xterm"}
    )
    os.close(terminal)
    text = b""
    while b"trace light" not in text:
        text += os.read(controller, 4096)
    running.send_signal(signal.SIGINT)
    while True:
        try:
            read = os.read(controller, 4096)
        except OSError:  # Linux: the other end is closed
            break
        if not read:
            break
        text += read
    os.close(controller)
    assert running.wait(timeout=60) == 130
    assert b"interrupted" in text
    assert text.rindex(b"\x1b[?25h") > text.rindex(b"\x1b[?25l")


def test_an_interrupt_hits_native_code_or_is_lost() -> None:
    """Raised inside a callback of native code it would abort the process: it waits for the next report."""
    before = signal.getsignal(signal.SIGINT)
    reached = []
    with pytest.raises(KeyboardInterrupt), Steps().step("outer"), Steps().step("work") as done:
        os.kill(os.getpid(), signal.SIGINT)
        reached.append("after the signal")
        done(0.5)
        reached.append("after the report")
    assert reached == ["after the signal"]
    with pytest.raises(KeyboardInterrupt), Steps().step("work"):
        os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_what_an_interrupt_broke_is_told_as_an_error() -> None:
    with pytest.raises(KeyboardInterrupt), Steps().step("child"):
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError("the child process was interrupted too")
    with pytest.raises(ValueError, match="nobody"), Steps().step("child"):
        raise ValueError("nobody interrupted")


def test_asked_twice_it_does_not_wait() -> None:
    with pytest.raises(KeyboardInterrupt), Steps().step("work"):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second signal was not raised at once")
