"""The packages have no import circle, folders of few modules, and no module with a name of two meanings."""

import ast
from collections import Counter
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


def test_no_module_has_the_name_of_a_function_or_an_imported_package() -> None:
    # A module with the name of its function hides behind it, and importing both needs an alias.
    files = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    trees = [ast.parse(path.read_text("utf-8")) for path in files]
    functions = {n.name for tree in trees for n in tree.body if isinstance(n, ast.FunctionDef)}
    packages = set()
    for node in (node for tree in trees for node in ast.walk(tree)):
        if isinstance(node, ast.Import):
            packages |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            packages.add(node.module.partition(".")[0])
    modules = {path.parent.name if path.stem == "__init__" else path.stem for path in files}
    clashes = modules & (functions | packages) - set(ROOMS)
    assert clashes == set()


def test_no_two_classes_and_no_two_modules_have_one_name() -> None:
    files = [path for room in ROOMS for path in (ROOT / room).rglob("*.py")]
    modules = Counter(path.stem for path in files if not path.stem.startswith("__"))
    trees = [ast.parse(path.read_text("utf-8")) for path in files]
    classes = Counter(n.name for tree in trees for n in tree.body if isinstance(n, ast.ClassDef))
    twice = {name for name, count in (modules + classes).items() if count > 1}
    assert twice == set()
