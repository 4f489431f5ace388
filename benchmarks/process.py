"""Wall time, processor time and peak memory of a program in its own process."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]

# Linux passes the peak memory before exec on to the new program, so a child of a large process reports the peak of its
# parent. A small process in between starts the program and reports what it used.
BETWEEN = """
import json, os, sys, time
start = time.perf_counter()
pid = os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ)
_, status, used = os.wait4(pid, 0)
with open(sys.argv[1], "w") as report:
    json.dump([os.waitstatus_to_exitcode(status), time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss], report)
"""


@dataclass(frozen=True)
class Program:
    """Output and resources of a program."""

    output: str
    wall_s: float
    processor_s: float
    peak_mb: float
    """Largest resident memory, 1e6 bytes."""


class ProgramFailedError(Exception):
    """A program of a benchmark ended with a status other than 0."""


def run(command: Sequence[str | Path], home: Path | None = None, longest_s: float = 900) -> Program:
    """Run a program to its end; `home`: its HOME, an empty folder for no cached kernels.

    Raises `ProgramFailedError` with its last words.
    """
    # Wide enough to print each row on one line.
    env = dict(os.environ) | {"COLUMNS": "500", "PYTHONPATH": str(ROOT)}
    if home:
        env["HOME"] = str(home)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "used.json"
        done = subprocess.run(
            [sys.executable, "-S", "-E", "-c", BETWEEN, report, *command],
            env=env,
            capture_output=True,
            text=True,
            timeout=longest_s,
            check=False,
        )
        if not report.is_file():
            raise ProgramFailedError(f"{command[0]} did not start: {done.stderr[-300:]}")
        status, wall_s, processor_s, peak_kb = json.loads(report.read_text())
    if status:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:] or ["no output"]
        raise ProgramFailedError(f"{' '.join(map(str, command[:5]))}: status {status}, {last[0]}")
    return Program(done.stdout, wall_s, processor_s, peak_kb * 1024 / 1e6)


def python(*words: str | Path, home: Path | None = None) -> Program:
    """Run this interpreter."""
    return run([sys.executable, *words], home)


@contextmanager
def empty_home() -> Iterator[Path]:
    """A HOME without caches: Dr.Jit stores its kernels in ~/.drjit."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)
