"""Which tests execute which lines: a pytest plugin for the recording run of `tests.mutation`.

Lines run in a fixture belong to the whole test file, since its other tests may use what the fixture made.
"""

import json
import os
from collections import defaultdict
from collections.abc import Generator, Iterable
from pathlib import Path

import coverage
import pytest

ROOMS = ("scenes", "render", "decode", "evaluation", "fringebench")
FOLDER = "MUTATION_RECORD"
# So many of the nearest and fastest tests are kept for a line.
KEPT = 40

Record = dict[str, dict[str, list[str]]]
"""File -> text of a line -> tests or test files, nearest and fastest first."""

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
    return {
        path: {line: ordered(found, path, seconds)[:KEPT] for line, found in lines.items()}
        for path, lines in tests.items()
    }


def ordered(tests: Iterable[str], path: str, seconds: dict[str, float]) -> list[str]:
    """Tests of the module first, then of its folder, then all others; the fast ones before the slow ones."""
    folder = str(Path("tests") / Path(path).parent)

    def rank(test: str) -> tuple[int, float, str]:
        named = Path(path).stem in Path(test.partition("::")[0]).stem
        near = test.startswith(folder)
        return 2 - named - near, seconds.get(test, 0.0), test

    return sorted(tests, key=rank)
