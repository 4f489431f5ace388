"""Mutants are valid code, each differs from its source, and what is no number stays as it is."""

import ast
from pathlib import Path

import pytest

from tests.mutation.__main__ import MODULES, modules
from tests.mutation.mutants import mutants
from tests.mutation.recorder import ordered
from tests.mutation.trials import ROOT, covering, unrecorded

SOURCE = '''
"""A docstring with 2 numbers and a + b."""


def f(x: "tuple[int, 3]") -> int:
    """Gives 1."""
    if x <= 0.5 and not (x):
        raise ValueError(f"x = {x + 1}: give more than 0.5")
    return -abs(x) + max(x * 2, 3)


Number = Annotated[int | float, Field(ge=0)]
'''


def test_every_kind_of_change_is_made_and_messages_stay() -> None:
    after = [m.described(SOURCE)[1] for m in mutants(SOURCE)]
    assert after == [
        "if x < 0.5 and not (x):",
        "if x <= 1.0 and not (x):",
        "if x <= 0.5 and (x):",
        "return abs(x) + max(x * 2, 3)",
        "return -(x) + max(x * 2, 3)",
        "return -abs(x) - max(x * 2, 3)",
        "return -abs(x) + min(x * 2, 3)",
        "return -abs(x) + max(x / 2, 3)",
        "return -abs(x) + max(x * 3, 3)",
        "return -abs(x) + max(x * 2, 4)",
    ]


@pytest.mark.parametrize("path", modules(MODULES)[::7])
def test_mutants_of_our_modules_are_valid_and_differ(path: str) -> None:
    source = Path(ROOT / path).read_text("utf-8")
    tree = ast.dump(ast.parse(source))
    for mutant in mutants(source)[::10]:
        assert ast.dump(ast.parse(mutant.applied(source))) != tree


def test_tests_that_execute_the_changed_line_are_chosen() -> None:
    """Of a statement over several lines, and of a line that only an import executes, those of what is around it."""
    source = "LIMIT = 3\n\n\ndef f(x):\n    return max(\n        x,\n        2,\n    )\n"
    name, near, far = "tests/mutation/test_mutants.py", "a", "b"
    known = {"m.py": {"return max(": [f"{name}::{near}", f"{name}::{far}"]}}
    constant, function, number = mutants(source)
    for mutant in (constant, function, number):
        found = covering("m.py", mutant, source, known)
        assert found == [f"{name}::{near}", f"{name}::{far}"]
    assert covering("m.py", number, source, {"m.py": {"return max(": ["gone.py::a"]}}) == []


def test_files_that_the_record_does_not_know_are_found_by_name_and_import(tmp_path: Path) -> None:
    texts = {
        "a/test_light.py": "",
        "a/test_lightning.py": "",
        "b/test_other.py": "from render import light\n",
        "b/test_third.py": "from render.light import glow\n",
        "b/test_far.py": "from render.lighter import glow\nfrom render import lights\n",
        "b/test_known.py": "import render.light\n",
        "render/test_near.py": "",
        "render/plugins/test_further.py": "",
    }
    for name, text in texts.items():
        (tmp_path / "tests" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / name).write_text(text)
    found = unrecorded("render/light.py", frozenset({"tests/b/test_known.py"}), tmp_path)
    named, importing = (
        ("a/test_light.py", "a/test_lightning.py"),
        ("b/test_other.py", "b/test_third.py"),
    )
    assert found == [f"tests/{name}" for name in (*named, *importing, "render/test_near.py")]


def test_nearest_and_fastest_tests_come_first() -> None:
    tests = ["tests/a/test_b.py::x", "tests/render/test_a.py::x", "tests/render/test_light.py::x"]
    seconds = {tests[0]: 0.1, tests[1]: 2.0, tests[2]: 3.0}
    assert ordered(tests, "render/light.py", seconds) == tests[::-1]
