"""The verbs on the front door: documented, typed, and quick to import."""

import inspect
import json
from pathlib import Path

import pytest

import fringebench
from fringebench.output_folder import write_json
from tests.commands import program

VERBS = ("run", "compare", "regress", "budget", "dataset", "accept")


def test_front_door_exports_verbs_and_nouns() -> None:
    assert set(VERBS) <= set(fringebench.__all__) <= set(dir(fringebench))
    for name in fringebench.__all__:
        assert getattr(fringebench, name) is not None, name


@pytest.mark.parametrize("name", VERBS)
def test_verb_is_documented_and_typed(name: str) -> None:
    verb = getattr(fringebench, name)
    text = inspect.getdoc(verb) or ""
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n---" in text, section
    # `tests/docs/test_doctests.py` runs it.
    assert ">>> " in text
    signature = inspect.signature(verb)
    assert signature.return_annotation is not inspect.Signature.empty
    for parameter in signature.parameters.values():
        assert parameter.annotation is not inspect.Parameter.empty, parameter.name
        assert parameter.kind is not inspect.Parameter.VAR_KEYWORD
        assert f"\n{parameter.name}\n" in text, parameter.name


def _loaded(code: str) -> set[str]:
    """Top-level packages that are loaded after a program has run."""
    code += "; import sys; print({name.partition('.')[0] for name in sys.modules})"
    done = program(code)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].strip("{}").replace("'", "").split(", "))


@pytest.mark.parametrize(
    "code",
    [
        "import fringebench; fringebench.__version__",
        "from typer.testing import CliRunner; from fringebench.cli.app import app; "
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0",
        "from typer.testing import CliRunner; from fringebench.cli.app import app; "
        "assert CliRunner().invoke(app, ['run', '--help']).exit_code == 0",
    ],
    ids=["import", "help", "help of a command"],
)
def test_import_and_help_load_no_room(code: str) -> None:
    # What takes time: 1.5 s of processor time for scenes alone, 0.3 s for all of the command line.
    assert not _loaded(code) & {"scenes", "numpy", "mitsuba", "drjit", "render", "decode"}


def test_json_files_are_replaced_as_a_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json({"a": [1.5]}, path)
    with pytest.raises(ValueError, match="JSON"):
        write_json({"a": float("nan")}, path)
    assert json.loads(path.read_text()) == {"a": [1.5]}
    assert list(tmp_path.iterdir()) == [path]
