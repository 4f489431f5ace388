"""The packages have no import circle, and folders of few modules."""

from graphlib import TopologicalSorter
from pathlib import Path

import grimp

ROOMS = ("scenes", "render", "decode", "evaluation", "fringebench")
ROOT = Path(__file__).parents[1]


def test_no_module_imports_itself_through_others() -> None:
    # Imports for type checkers count too: they are what a reader follows.
    graph = grimp.build_graph(*ROOMS, exclude_type_checking_imports=False)
    edges = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert tuple(TopologicalSorter(edges).static_order())


def test_no_folder_holds_more_than_14_modules() -> None:
    for room in ROOMS:
        for folder in (ROOT / room, *(path for path in (ROOT / room).rglob("*") if path.is_dir())):
            modules = [path.stem for path in folder.glob("*.py") if path.stem != "__init__"]
            assert len(modules) <= 14, folder
