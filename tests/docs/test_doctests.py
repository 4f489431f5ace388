"""Examples with a prompt (``>>>``) work: in docstrings of every module, and on pages."""

import doctest
import importlib
import pkgutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.commands import ROOMS, ROOT

DOCS = ROOT / "docs"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
PAGES = sorted(page for page in DOCS.glob("*.md") if "\n>>> " in page.read_text("utf-8"))


@pytest.mark.parametrize("room", [*ROOMS[:-1], pytest.param(ROOMS[-1], marks=pytest.mark.slow)])
def test_examples_in_docstrings_work(room: str) -> None:
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    said: list[str] = []
    for example in _examples(room):
        runner.run(example, out=said.append)
    assert runner.tries > 0
    assert not runner.failures, "".join(said)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_prompts_on_a_page_work(page: Path) -> None:
    assert doctest.testfile(str(page), module_relative=False, optionflags=FLAGS).failed == 0


def _examples(room: str) -> Iterator[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    package = importlib.import_module(room)
    names = [room, *(found.name for found in pkgutil.walk_packages(package.__path__, f"{room}."))]
    for name in names:
        # `python -m fringebench` runs when it is imported.
        if not name.endswith("__main__"):
            yield from finder.find(importlib.import_module(name), name)
