"""Names and paths in the documentation exist."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

from tests.commands import ROOMS, ROOT

PAGES = [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
# A dotted name of a room; in a path, a file name or an address it is none.
NAME = re.compile(rf"(?<![\w./\"'-])(?:{'|'.join(ROOMS)})(?:\.[A-Za-z_]\w*)+(?![\w./-]*[/\w])")
FOLDERS = ("adapters", "benchmarks", "docs", "tests", *ROOMS)
# A path from the root, as far as it is spelled out; not one below a placeholder, and not part of a longer path.
PATH = re.compile(rf"`((?:{'|'.join(FOLDERS)})/[\w./-]*)`")
FILE_ENDINGS = {"toml", "exr", "json", "html", "ply", "md"}
# Keys of a scene file or entry points that look like names.
NOT_PYTHON = {"fringebench.fusion"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_python_names_on_a_page_exist(page: Path) -> None:
    names = {match.group() for match in NAME.finditer(page.read_text("utf-8"))} - NOT_PYTHON
    missing = [
        name
        for name in sorted(names)
        if name.rsplit(".", 1)[1] not in FILE_ENDINGS and not _exists(name)
    ]
    assert not missing


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_paths_on_a_page_exist(page: Path) -> None:
    paths = {match.group(1) for match in PATH.finditer(page.read_text("utf-8"))}
    assert not [path for path in sorted(paths) if not (ROOT / path).exists()]


def _exists(name: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[count:]:
            if not hasattr(found, attribute) and attribute not in getattr(
                found, "__annotations__", {}
            ):
                return False
            found = getattr(found, attribute, None)
        return True
    return False
