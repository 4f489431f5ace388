"""The command line as a child process, with scenes small enough to be run many times."""

import os
import subprocess
import sys
import textwrap
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
SMALL = ("--set", "camera.resolution=[24,18]", "--set", "sampling.samples=2")


def start(
    *words: str | Path, folder: Path, env: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    """``fringebench WORDS`` in a folder, its output kept."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-m", "fringebench", *(os.fspath(word) for word in words)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path} | dict(env or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="surrogateescape",
    )


def finish(process: subprocess.Popen[str], timeout_s: float = 600) -> tuple[int, str, str]:
    """Exit status, standard output, standard error."""
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, out, err


def program(
    script: str, *words: object, folder: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """An indented Python program, run in a process of its own with the project's packages."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), *map(str, words)],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | dict(env or {}),
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
