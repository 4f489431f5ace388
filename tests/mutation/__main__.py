"""Mutation testing: do the tests notice small changes of numerical code?

    python -m tests.mutation --count 200 --seed 1           a random sample over all rooms
    python -m tests.mutation --module evaluation/gate --count 50
    python -m tests.mutation --record                       record again which tests execute which lines

Each change is made in a copy of the repository, where up to forty tests that execute the changed line are run, the nearest and
fastest first, until one fails. Which tests these are is recorded once, by one run of the quick suite, to a file outside the
repository; test files that the record does not know yet come first, if they are near. What survives is listed, unless ``harmless.toml`` says why it changes nothing. Exit status 1 if more than 5 %
survive without a reason.
"""

import argparse
import ast
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import traceback
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from tests.mutation.mutants import Mutant, mutants
from tests.mutation.recorder import FOLDER, KEPT, Record, merged

ROOT = Path(__file__).parents[2]
HARMLESS = Path(__file__).with_name("harmless.toml")
RECORD = Path.home() / ".cache" / "fringebench" / "mutation.json"
# Where numbers are made: no pages, no command line, no files of text.
MODULES = (
    "scenes/acquisition", "scenes/board", "scenes/rig", "scenes/shapes",
    "render", "decode",
    "evaluation/gate", "evaluation/hdr", "evaluation/inspection", "evaluation/scoring", "evaluation/theory",
    "fringebench/datasets", "fringebench/experiments", "fringebench/gate",
)  # fmt: skip
# Loaded once, before the processes of the mutants are forked; Dr.Jit starts threads, and plugins of pytest's are rewritten by
# it: both are left to them.
PRELOADED = (
    "cv2", "jinja2", "matplotlib.pyplot", "numpy", "numpy.testing", "pydantic", "pytest", "scipy.ndimage",
    "scipy.optimize", "scipy.signal", "scipy.spatial", "scipy.stats", "shapely", "skimage.measure", "trimesh", "typer",
)  # fmt: skip
ALLOWED = 0.05
# By pytest's exit status; any other, or a signal, is a test that noticed. 4 is also that of a module that cannot be imported.
OUTCOMES = {0: "survived", 5: "without a test"}
# A changed loop may never end.
TIMEOUT_S = 300.0


@dataclass
class Trial:
    """A mutant whose tests are running."""

    path: str
    mutant: Mutant
    source: str
    process: int
    started: float


def main() -> int:
    """Run a sample and list the survivors."""
    parser = argparse.ArgumentParser(description="Mutation testing of the numerical modules.")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2, help="mutants tried at a time")
    parser.add_argument(
        "--module", action="append", help="folder, file or file:line; default: all numerical ones"
    )
    parser.add_argument("--record", action="store_true", help="only record what tests execute")
    parser.add_argument("--list", action="store_true", help="only list what would be changed")
    chosen = parser.parse_args()
    if chosen.record or not (chosen.list or RECORD.is_file()):
        record(chosen.jobs)
        if chosen.record:
            return 0
    sample = sampled(ROOT, chosen.module, chosen.count, chosen.seed)
    if chosen.list:
        for path, mutant in sample:
            print(said(path, mutant, (ROOT / path).read_text("utf-8")))
        return 0
    known: Record = json.loads(RECORD.read_text("utf-8"))
    reasons = {
        (entry["file"], entry["after"]): entry["reason"]
        for entry in tomllib.loads(HARMLESS.read_text("utf-8"))["harmless"]
    }
    survived = 0
    for i, (path, mutant, source, outcome, spent_s) in enumerate(
        outcomes(sample, known, chosen.jobs)
    ):
        reason = reasons.get((path, mutant.described(source)[1]), "")
        noticed = outcome in ("killed", "stopped")
        survived += not (noticed or reason)
        why = f" (harmless: {reason})" if reason and not noticed else ""
        print(
            f"{i + 1}/{len(sample)} {outcome}{why}: {said(path, mutant, source)}  [{spent_s:.0f} s]",
            flush=True,
        )
    share = survived / max(len(sample), 1)
    print(
        f"{survived} of {len(sample)} survived without a stated reason ({share:.1%}; {ALLOWED:.0%} allowed)"
    )
    return int(share > ALLOWED)


def record(jobs: int) -> None:
    """Run the quick suite once and keep which tests execute which lines."""
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        words = ["-q", "-n", str(jobs), "-p", "tests.mutation.recorder", "-p", "no:cacheprovider"]
        subprocess.run(
            [sys.executable, "-m", "pytest", *words],
            cwd=ROOT,
            check=False,
            env={**os.environ, FOLDER: folder, "PYTHONPATH": str(ROOT)},
        )
        RECORD.parent.mkdir(parents=True, exist_ok=True)
        RECORD.write_text(json.dumps(merged(Path(folder), ROOT)), "utf-8")


def said(path: str, mutant: Mutant, source: str) -> str:
    """A mutant in words."""
    before, after = mutant.described(source)
    return f"{path}:{mutant.line}: {before}  ->  {after}"


def sampled(
    root: Path, chosen: list[str] | None, count: int, seed: int
) -> list[tuple[str, Mutant]]:
    """A random sample of the mutants of the chosen modules."""
    lines = {tuple(name.split(":")) for name in chosen or () if ":" in name}
    pool = [
        (path, mutant)
        for path in modules([name.partition(":")[0] for name in chosen or MODULES], root)
        for mutant in mutants((root / path).read_text("utf-8"))
        if not lines or (path, str(mutant.line)) in lines
    ]
    return random.Random(seed).sample(pool, min(count, len(pool)))


def modules(chosen: list[str] | tuple[str, ...], root: Path = ROOT) -> list[str]:
    """Files of the chosen folders, relative to the repository."""
    found = set()
    for name in chosen:
        place = root / name
        files = [place] if place.is_file() else place.rglob("*.py")
        found |= {str(file.relative_to(root)) for file in files if file.name != "__init__.py"}
    return sorted(found)


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


def covering(path: str, mutant: Mutant, source: str, known: Record) -> list[str]:
    """Tests that execute the changed statement; of a line that only an import executes, those of the module."""
    text = source.splitlines()
    lines = known.get(path, {})
    found = lines.get(text[mutant.line - 1].strip()) or [
        test
        for line in range(*_statement(source, mutant.line))
        for test in lines.get(text[line - 1].strip(), ())
    ]
    if not found:
        # The nearest tests of each line come first.
        ranked = zip_longest(*lines.values())
        found = [test for same_rank in ranked for test in same_rank if test]
    return [test for test in dict.fromkeys(found) if (ROOT / test.partition("::")[0]).is_file()]


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


def outcomes(
    sample: list[tuple[str, Mutant]], known: Record, jobs: int
) -> Iterator[tuple[str, Mutant, str, str, float]]:
    """Try the mutants, some at a time: file, mutant, unchanged source, what became of it, seconds.

    ``killed``; ``survived``; ``stopped`` after `TIMEOUT_S`; ``without a test``.
    """
    for name in PRELOADED:
        __import__(name)
    waiting = sample[::-1]
    all_tests = (tests for lines in known.values() for tests in lines.values())
    recorded = frozenset(test.partition("::")[0] for tests in all_tests for test in tests)
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
                path, mutant = waiting.pop()
                copy = free.pop()
                source = (copy / path).read_text("utf-8")
                new = unrecorded(path, recorded if path in known else frozenset())
                tests = [*new, *covering(path, mutant, source, known)][:KEPT]
                if not tests:
                    free.append(copy)
                    yield path, mutant, source, "without a test", 0.0
                    continue
                (copy / path).write_text(mutant.applied(source), "utf-8")
                process = forked(copy, tests)
                running[copy] = Trial(path, mutant, source, process, time.monotonic())
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
                exit_status = os.waitstatus_to_exitcode(status)
                outcome = "stopped" if not ended else OUTCOMES.get(exit_status, "killed")
                yield trial.path, trial.mutant, trial.source, outcome, spent_s


def forked(copy: Path, tests: list[str]) -> int:
    """Run tests in a copy, in a process of their own; it ends with 0 if all pass."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        os.setsid()
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


if __name__ == "__main__":
    sys.exit(main())
