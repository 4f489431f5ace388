"""Mutants are valid code, each differs from its source, and what is no number stays as it is."""

import ast
from pathlib import Path

import pytest

from tests.mutation.__main__ import MODULES, modules
from tests.mutation.mutants import mutants
from tests.mutation.recorder import BUDGET_S, Record, chosen
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
    known = Record(
        seconds={},
        tests=[f"{name}::{near}", f"{name}::{far}", "gone.py::a"],
        lines={"m.py": {"return max(": [0, 1]}, "n.py": {"return max(": [2]}},
    )
    constant, function, number = mutants(source)
    for mutant in (constant, function, number):
        found = covering("m.py", mutant, source, known)
        assert found == [f"{name}::{near}", f"{name}::{far}"]
    assert covering("n.py", number, source, known) == []


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


def test_a_lines_tests_are_of_many_files_and_the_nearest_come_first() -> None:
    """Of a thousand tests the near files give more, yet each file gives some, and no more than the time allows."""
    own, near, far = "tests/render/test_light.py", "tests/render/test_a.py", "tests/a/test_{}.py"
    seconds = {f"{file}::{i}": 1.0 + i / 1000 for file in (own, near) for i in range(100)}
    seconds |= {f"{far.format(file)}::{i}": 1.0 for file in range(40) for i in range(20)}
    found = chosen(seconds, "render/light.py", seconds)
    files = [test.partition("::")[0] for test in found]
    assert files.count(own) > files.count(near) > 4
    assert set(files) == {test.partition("::")[0] for test in seconds}
    assert found[:2] == [f"{own}::0", f"{own}::1"]
    assert files == sorted(files, key=lambda file: (file != own, file != near, files.index(file)))
    assert 0.9 * BUDGET_S < sum(seconds[test] for test in found) <= BUDGET_S


def test_a_file_whose_fixture_executes_the_line_is_run_once_and_whole() -> None:
    tests = ["tests/a/test_b.py::x", "tests/a/test_b.py"]
    assert chosen(tests, "render/light.py", {}) == tests[1:]
    assert chosen(tests[:1], "render/light.py", {tests[0]: 2.0 * BUDGET_S}) == tests[:1]
