"""Which tests execute which lines: a pytest plugin for the recording run of `tests.mutation`.

Lines run in a fixture belong to the whole test file, since its other tests may use what the fixture made.
"""

import json
import os
from collections import defaultdict
from collections.abc import Generator, Iterable
from pathlib import Path
from typing import TypedDict

import coverage
import pytest

ROOMS = ("scenes", "render", "decode", "evaluation", "fringebench")
FOLDER = "MUTATION_RECORD"
# The tests chosen for a mutant may take so long, by the record; each at least a start's share.
BUDGET_S, START_S = 90.0, 0.1
# Tests taken from a file at a time: from the module's own, from its folder or of its name, from its room, from others.
SHARES = (8, 4, 2, 1)


class Record(TypedDict):
    """Which tests execute which lines, and how long they take."""

    seconds: dict[str, float]
    """Test, or test file -> duration."""
    tests: list[str]
    """Tests, or test files whose fixtures execute a line."""
    lines: dict[str, dict[str, list[int]]]
    """File -> text of a line -> places in `tests`."""


_SECONDS: dict[str, float] = defaultdict(float)
_COVERAGE = coverage.Coverage(
    data_file=f"{os.environ.get(FOLDER, '')}/{os.environ.get('PYTEST_XDIST_WORKER', 'main')}",
    source=[str(Path.cwd() / room) for room in ROOMS],
    config_file=False,
    messages=False,
)


def pytest_sessionstart() -> None:
    """Start to record."""
    _COVERAGE.start()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """What a fixture executes is the file's."""
    _COVERAGE.switch_context(item.nodeid.partition("::")[0])
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """What a test executes is its own, whatever its parameters: later ones belong to it."""
    _COVERAGE.switch_context(item.nodeid.partition("[")[0])
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """How long a test takes, with its fixtures."""
    for name in (report.nodeid.partition("[")[0], report.nodeid.partition("::")[0]):
        _SECONDS[name] += report.duration


def pytest_sessionfinish() -> None:
    """Write what was seen."""
    _COVERAGE.stop()
    _COVERAGE.save()
    data = _COVERAGE.get_data()
    Path(data.data_filename()).with_suffix(".json").write_text(json.dumps(_SECONDS), "utf-8")


def merged(folder: Path, root: Path) -> Record:
    """The record of all processes of a run."""
    seconds: dict[str, float] = defaultdict(float)
    for file in folder.glob("*.json"):
        for test, spent in json.loads(file.read_text("utf-8")).items():
            seconds[test] = max(seconds[test], spent)
    tests: dict[str, dict[str, set[str]]] = defaultdict(lambda: defaultdict(set))
    for file in folder.glob("*"):
        if file.suffix:
            continue
        data = coverage.CoverageData(str(file))
        data.read()
        for measured in data.measured_files():
            path = str(Path(measured).relative_to(root))
            text = Path(measured).read_text("utf-8").splitlines()
            for line, contexts in data.contexts_by_lineno(measured).items():
                # Python numbers the end of some files as a line.
                if line <= len(text):
                    tests[path][text[line - 1].strip()].update(filter(None, contexts))
    names = sorted({test for lines in tests.values() for found in lines.values() for test in found})
    place = {name: i for i, name in enumerate(names)}
    return Record(
        seconds={name: round(seconds[name], 3) for name in names},
        tests=names,
        lines={
            path: {line: sorted(place[test] for test in found) for line, found in lines.items()}
            for path, lines in tests.items()
        },
    )


def chosen(tests: Iterable[str], path: str, seconds: dict[str, float]) -> list[str]:
    """The tests of a module to run within `BUDGET_S`: some of every file, more of the nearer ones; near files, fast tests first."""

    def distance(file: str) -> int:
        """0 for the module's own tests, 1 for those of its folder or name, 2 for those of its room, 3 for others."""
        named = Path(path).stem in Path(file).stem
        near = Path(file).is_relative_to(Path("tests") / Path(path).parent)
        same_room = Path(file).is_relative_to(Path("tests") / Path(path).parts[0])
        return 2 - named - near if named or near else 3 - same_room

    files: dict[str, list[str]] = defaultdict(list)
    for test in sorted(set(tests), key=lambda test: (seconds.get(test, 0.0), test)):
        files[test.partition("::")[0]].append(test)
    rounds = sorted(
        (i // SHARES[distance(file)], distance(file), max(seconds.get(test, 0.0), START_S), test)
        for file, of_file in files.items()
        for i, test in enumerate(of_file)
    )
    taken: dict[str, float] = {}
    for *_, spent_s, test in rounds:
        if not taken or sum(taken.values()) + spent_s <= BUDGET_S:
            taken[test] = spent_s
    # Together in a file, for the sake of its fixtures; a whole file includes its tests.
    groups = [
        (distance(file), [file] if file in taken else [test for test in of_file if test in taken])
        for file, of_file in files.items()
    ]
    groups.sort(key=lambda group: (group[0], sum(taken[test] for test in group[1])))
    return [test for _, group in groups for test in group]
