"""Commands and programs as child processes, and the files of the project and of a folder."""

import ast
import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
ROOMS = ("scenes", "render", "decode", "evaluation", "fringebench")
SMALL = ("--set", "camera.resolution=[24,18]", "--set", "sampling.samples=2")


class Done(NamedTuple):
    """Exit status and output of a command."""

    status: int
    out: str
    err: str


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


def finish(process: subprocess.Popen[str], timeout_s: float = 600) -> Done:
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return Done(process.returncode, out, err)


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


def parsed_modules() -> Iterator[tuple[str, ast.Module]]:
    """Every module of the rooms: its path from the root, and what Python's parser makes of it."""
    for room in ROOMS:
        for source in sorted((ROOT / room).rglob("*.py")):
            yield source.relative_to(ROOT).as_posix(), ast.parse(source.read_text("utf-8"))


def contents(folder: Path) -> dict[str, bytes]:
    """The bytes of every file below a folder, by its path there."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
