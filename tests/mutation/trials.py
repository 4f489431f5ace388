"""Each mutant is tried in a copy of the repository, by the tests nearest to it."""

import ast
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.mutants import Mutant
from tests.mutation.recorder import Record, chosen

ROOT = Path(__file__).parents[2]
# Loaded once, before the processes of the mutants are forked; Dr.Jit starts threads, and plugins of pytest's are rewritten by
# it: both are left to them.
PRELOADED = (
    "cv2", "jinja2", "matplotlib.pyplot", "numpy", "numpy.testing", "pydantic", "pytest", "scipy.ndimage",
    "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.stats", "shapely", "skimage.measure", "trimesh", "typer",
)  # fmt: skip
# By pytest's exit status; any other, or a signal, is a test that noticed. 4 is also that of a module that cannot be imported.
OUTCOMES = {0: "survived", 5: "without a test"}
NOTICED = ("killed", "killed slowly", "stopped")
# A changed loop may never end: a test may compute so long, as processor time, which no other work on the machine uses up;
# and all tests of a mutant may take so long.
PROCESSOR_S = 300
TIMEOUT_S = 1200.0
# So are slow tests chosen that continuous integration runs.
SLOW = "slow and not trust"


@dataclass
class Trial:
    """A mutant whose tests are running."""

    path: str
    mutant: Mutant
    source: str
    process: int
    started: float
    slow: bool


def outcomes(
    sample: list[tuple[str, Mutant]], known: Record, jobs: int, quick: bool = False
) -> Iterator[tuple[str, Mutant, str, str, float]]:
    """Try the mutants, some at a time: file, mutant, unchanged source, what became of it, seconds.

    ``killed``; ``killed slowly`` by a slow test near it, all of which are run on what the quick ones let pass, unless `quick`; ``stopped``
    after `PROCESSOR_S` or `TIMEOUT_S`, the quick ones only; ``survived``; ``without a test``.
    """
    for name in PRELOADED:
        __import__(name)
    waiting = [(path, mutant, False) for path, mutant in sample[::-1]]
    recorded = frozenset(test.partition("::")[0] for test in known["tests"])
    with tempfile.TemporaryDirectory(prefix="mutation-", ignore_cleanup_errors=True) as folder:
        free = [copied(Path(folder) / str(job)) for job in range(jobs)]
        control = ["tests/evaluation/gate/test_equivalence.py"]
        if os.waitpid(forked(free[0], control), 0)[1]:
            log = (free[0] / ".log").read_text("utf-8", "replace")
            raise SystemExit(
                f"tests fail without a change, so that no mutant could be noticed:\n{log}"
            )
        running: dict[Path, Trial] = {}
        while waiting or running:
            while waiting and free:
                path, mutant, slow = waiting.pop()
                copy = free.pop()
                source = (copy / path).read_text("utf-8")
                if slow:
                    tests = ["-m", SLOW, *slow_files(path, copy)]
                else:
                    old = recorded if path in known["lines"] else frozenset()
                    found = covering(path, mutant, source, known, copy)
                    tests = [*unrecorded(path, old, copy), *chosen(found, path, known["seconds"])]
                (copy / path).write_text(mutant.applied(source), "utf-8")
                process = forked(copy, tests or ["--collect-only", "-m", "none"])
                running[copy] = Trial(path, mutant, source, process, time.monotonic(), slow)
            time.sleep(0.02)
            for copy, trial in list(running.items()):
                spent_s = time.monotonic() - trial.started
                ended, status = os.waitpid(trial.process, os.WNOHANG)
                if not ended and spent_s < TIMEOUT_S:
                    continue
                with_all_it_started = -trial.process
                with suppress(ProcessLookupError):
                    os.kill(with_all_it_started, signal.SIGKILL)
                if not ended:
                    os.waitpid(trial.process, 0)
                (copy / trial.path).write_text(trial.source, "utf-8")
                free.append(copy)
                del running[copy]
                outcome = outcome_of(
                    os.waitstatus_to_exitcode(status) if ended else -signal.SIGXCPU
                )
                if trial.slow:
                    outcome = "killed slowly" if outcome == "killed" else "survived"
                elif not quick and outcome not in NOTICED and slow_files(trial.path, copy):
                    waiting.append((trial.path, trial.mutant, True))
                    continue
                yield trial.path, trial.mutant, trial.source, outcome, spent_s


def outcome_of(status: int) -> str:
    """What became of a mutant, by the exit status of its tests."""
    return "stopped" if status == -signal.SIGXCPU else OUTCOMES.get(status, "killed")


def forked(copy: Path, tests: list[str]) -> int:
    """Run tests in a copy, in a process of their own; it ends with 0 if all pass."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR_S, resource.RLIM_INFINITY))
        os.chdir(copy)
        with (copy / ".log").open("wb") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
        os.environ |= {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
        sys.dont_write_bytecode = True
        sys.path[:] = [str(copy), *(path for path in sys.path if path not in ("", str(ROOT)))]
        for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
            del sys.modules[name]
        import pytest

        options = ["-q", "-x", "-p", "no:cacheprovider", "--basetemp", str(copy / ".pytest")]
        status = int(pytest.main([*options, "--no-header", *tests]))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(status)


def copied(folder: Path) -> Path:
    """A copy of the tracked files as they are now."""
    names = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True
    ).stdout.decode().split("\0")  # fmt: skip
    for name in filter(None, names):
        source = ROOT / name
        if source.is_file():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
    return folder


def covering(path: str, mutant: Mutant, source: str, known: Record, root: Path = ROOT) -> list[str]:
    """Tests that execute the changed statement; of a line that only an import executes, those of the module."""
    text = source.splitlines()
    lines = known["lines"].get(path, {})
    statement = range(*_statement(source, mutant.line))
    found = (
        lines.get(text[mutant.line - 1].strip())
        or [place for line in statement for place in lines.get(text[line - 1].strip(), ())]
        or [place for places in lines.values() for place in places]
    )
    names = (known["tests"][place] for place in sorted(set(found)))
    return [name for name in names if (root / name.partition("::")[0]).is_file()]


def slow_files(path: str, root: Path = ROOT) -> list[str]:
    """Files with slow tests near a module, in the order of `unrecorded`."""
    files = unrecorded(path, frozenset(), root)
    return [file for file in files if "pytest.mark.slow" in (root / file).read_text("utf-8")]


def unrecorded(path: str, recorded: frozenset[str], root: Path = ROOT) -> list[str]:
    """Test files that the record does not know: of the module's name, then those that import it, then those of its folder."""
    stem, module = Path(path).stem, path.removesuffix(".py").replace("/", ".")
    parent, _, name = module.rpartition(".")
    imports = re.compile(
        rf"from {module} import|import {module}\b|from {parent} import .*\b{name}\b"
    )

    def rank(file: Path) -> int:
        """0 for the module's name, 1 for an import, 2 for the module's folder, 3 for all else."""
        if stem in file.stem:
            return 0
        if imports.search((root / file).read_text("utf-8")):
            return 1
        return 2 if file.parent == Path("tests") / Path(path).parent else 3

    files = [file.relative_to(root) for file in sorted((root / "tests").rglob("test_*.py"))]
    ranked = sorted((rank(file), str(file)) for file in files if str(file) not in recorded)
    return [file for number, file in ranked if number < 3]


def _statement(source: str, line: int) -> tuple[int, int]:
    """First line, and the one after the last, of the innermost statement around a line."""
    around = [
        (node.lineno, (node.end_lineno or node.lineno) + 1)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or node.lineno)
    ]
    return min(around, key=lambda lines: lines[1] - lines[0])
