"""Long steps report progress, and an interrupt leaves complete files and names them."""

import io
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from rich.console import Console

import render
import scenes
from fringebench import progress
from fringebench.progress import Mode, Steps
from tests.commands import finish, start


@pytest.fixture(autouse=True)
def python_handles_ctrl_c() -> Iterator[None]:
    """A shell starts background jobs with SIGINT ignored, and children inherit that: handle it, as in the foreground."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of a clock that only the test moves."""
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    return clock


def console(terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=80)


def said(where: Console) -> str:
    assert isinstance(where.file, io.StringIO)
    return where.file.getvalue()


@pytest.mark.parametrize(("mode", "lines"), [(Mode.AUTO, 2), (Mode.NONE, 0)])
def test_pipe_gets_lines_only_when_the_work_is_long(
    mode: Mode, lines: int, now: list[float]
) -> None:
    where = console(terminal=False)
    with Steps(where, mode).step("short") as done:
        done(0.5)
        now[0] += progress.PIPED_S - 1.0
        done(0.9)
    assert said(where) == ""
    with Steps(where, mode).step("long") as done:
        now[0] += progress.PIPED_S
        done(0.5)
        now[0] += progress.PLAIN_S
        done(0.6)
    assert len(said(where).splitlines()) == lines


def test_many_short_steps_are_long_work(now: list[float]) -> None:
    where = console(terminal=False)
    steps = Steps(where)
    for i in range(45):
        with steps.step(f"case {i}"):
            now[0] += 1.0
    # Silent for half a minute, then a line every 3 s.
    assert said(where).splitlines() == [f"case {i}: started" for i in range(30, 45, 3)]


def test_no_color_leaves_no_escape_codes_on_a_terminal(
    now: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    where = Console(file=io.StringIO(), force_terminal=True, width=80, color_system=None)
    with Steps(where).step("work") as done:
        now[0] += progress.PIPED_S
        done(0.5)
    assert said(where) == "work: 50 %, about 30 s left\n"


def test_terminal_shows_a_bar_while_the_step_runs() -> None:
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


def test_plain_lines_give_share_and_time_left(now: list[float]) -> None:
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


def test_speed_excludes_what_an_earlier_run_did(now: list[float]) -> None:
    where = console(terminal=False)
    with Steps(where, Mode.PLAIN).shown("samples", resumes=True) as show:
        show(0.5, "50 of 100")
        now[0] += 10.0
        show(0.6, "60 of 100")
    assert said(where).splitlines()[1] == "samples: 60 %, 60 of 100, about 40 s left"


def test_tracing_reports_progress_and_tiles_do_not_change_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = scenes.load("step", {"camera.resolution": [64, 48], "sampling.samples": 2})
    shares: list[float] = []
    whole = render.trace(scene)
    monkeypatch.setattr("render.pathtracer.one_pass.TILE_S", 0.0)
    monkeypatch.setattr("render.pathtracer.one_pass.FIRST_TILE_PATHS", 64 * 8 * 2)
    tiled = render.trace(scene, progress=shares.append)
    assert (whole.total == tiled.total).all()
    assert shares[-1] == 1.0
    assert shares == sorted(set(shares))
    assert len(shares) == 1 + 40, "one tile of 8 rows, then of 1: no time allowed"


def test_exposing_reports_each_frame() -> None:
    scene = scenes.load("step", {"camera.resolution": [32, 24], "sampling.samples": 2})
    shares: list[float] = []
    render.expose(render.trace(scene), progress=shares.append)
    assert shares == [(i + 1) / 12 for i in range(12)]


def _interrupted(words: list[str], when: str, cwd: Path) -> tuple[int, str]:
    """Exit status and stderr of a command that gets a SIGINT once it has printed `when`."""
    running = start(*words, folder=cwd)
    assert running.stderr is not None
    heard = ""
    for line in running.stderr:
        heard += line
        if when in line:
            running.send_signal(signal.SIGINT)
            break
    # Closes the pipes, and does not wait for ever for a process that ignores the signal.
    status, _, rest = finish(running, timeout_s=300)
    return status, heard + rest


def test_ctrl_c_names_the_complete_files(tmp_path: Path) -> None:
    # Minutes of light, were it not interrupted.
    words = ["run", "step", "-o", "out", "--progress", "plain", "--set", "sampling.samples=20000"]
    status, heard = _interrupted(words, "trace light: started", tmp_path)
    assert status == 130
    assert heard.splitlines()[-1] == "fringebench: interrupted; complete files in out: scene.toml"
    assert "Traceback" not in heard
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["scene.toml"]
    assert scenes.load(tmp_path / "out" / "scene.toml").name == "step"


@pytest.mark.slow
def test_ctrl_c_late_in_a_run_names_all_written_files(tmp_path: Path) -> None:
    small = ["--set", "camera.resolution=[64,48]", "--set", "sampling.samples=4"]
    words = ["run", "step", "-o", "out", "--progress", "plain", *small]
    status, heard = _interrupted(words, "report: started", tmp_path)
    assert status == 130
    kept = heard.splitlines()[-1].split("complete files in out: ")[1].split(", ")
    assert {"transport.exr", "truth.exr", "stack.exr", "reconstruction.exr"} <= set(kept)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(kept)
    scenes.Stack.read(tmp_path / "out" / "stack.exr")


@pytest.mark.slow
def test_ctrl_c_in_a_stage_ends_with_status_130_and_no_file(tmp_path: Path) -> None:
    words = ["render", "step", "--progress", "plain", "--set", "sampling.samples=20000"]
    status, heard = _interrupted(words, "trace light: started", tmp_path)
    assert status == 130
    assert heard.splitlines()[-1] == "fringebench: interrupted; no file is left half written"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_gives_the_terminal_its_cursor_back(tmp_path: Path) -> None:
    """A real pseudo terminal: the bar appears, and Ctrl-C gives the cursor back."""
    controller, terminal = pty.openpty()
    words = ["render", "step", "--set", "sampling.samples=20000"]
    running = subprocess.Popen(
        [sys.executable, "-m", "fringebench", *words],
        stderr=terminal,
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key != "NO_COLOR"}
        | {"TERM": "xterm"},
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
    assert running.wait(timeout=300) == 130
    assert b"interrupted" in text
    assert text.rindex(b"\x1b[?25h") > text.rindex(b"\x1b[?25l")


def test_interrupt_waits_for_the_next_report() -> None:
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


def test_error_after_an_interrupt_counts_as_interrupt() -> None:
    with pytest.raises(KeyboardInterrupt), Steps().step("child"):
        os.kill(os.getpid(), signal.SIGINT)
        raise ValueError("the child process was interrupted too")
    with pytest.raises(ValueError, match="nobody"), Steps().step("child"):
        raise ValueError("nobody interrupted")


def test_second_interrupt_is_raised_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), Steps().step("work"):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("the second signal was not raised at once")
