"""Names in files stay in their folder, no code from a file is executed, and unusual names and folders work."""

import ast
import os
import sys
from pathlib import Path

import pytest

import scenes
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import Record
from scenes.support.errors import DatasetError, SceneError
from scenes.support.paths import as_file_name
from tests.commands import SMALL, contents, finish, parsed_modules, start
from tests.conftest import Call

ESCAPES = (
    "../../x",
    "/etc/x",
    "..",
    ".",
    "",
    "a/../../../x",
    "x\0y",
    "~root",
    "a\\..\\b",
    "x" * 5000,
)


@pytest.mark.parametrize("name", ESCAPES)
def test_text_as_file_name_stays_in_its_folder(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"fringebench-{as_file_name(name)}"
    assert path.resolve().parent == tmp_path
    path.mkdir()


@pytest.mark.parametrize("name", ["a/../../../escaped"])
def test_scene_name_does_not_lead_out_of_the_working_folder(
    name: str, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    monkeypatch.chdir(inner)
    status, _, err = call("run", "step", "--set", f'name="{name}"', "--json", small=True)
    assert status == 0, err
    folders = [path for path in tmp_path.rglob("*") if path.is_dir()]
    assert folders == [inner.parent, inner, *inner.iterdir()]
    assert len(folders) == 3


@pytest.mark.parametrize("label", ["../x", "a/b", "", "a b", ".x", "a\n", "<b>", "a" * 65])
def test_label_that_is_no_plain_word_is_refused(label: str) -> None:
    with pytest.raises(SceneError, match="label"):
        scenes.load("step", {"objects.0.label": label})


@pytest.mark.parametrize("name", ["../x", "a/b", "", ".", "a\0b"])
def test_split_that_is_no_plain_word_is_refused(name: str) -> None:
    with pytest.raises(DatasetError, match="splits"):
        DatasetPlan.of(scenes.load("step"), 2, splits={name: 1.0})


def test_record_folder_comes_from_its_number() -> None:
    # A record has no field that could name another folder.
    record = Record(index=7, split="../../x", status="made", reason="../../x", drawn="../../x")
    assert record.folder == "samples/000007"
    with pytest.raises(ValueError, match="index"):
        Record.model_validate({"index": "../../x", "split": "train", "status": "made"})


RUNS_TEXT = {"eval", "exec", "compile", "__import__"}
LOADS_CODE = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
# The gate passes a stack to the process of a decoder, whose code that process runs anyway; nobody else's file is read.
OWN_PICKLES = ("fringebench/gate/decoders.py", "fringebench/gate/worker.py")
# The parts of PyYAML that make only texts, lists and tables: other loaders make Python objects.
PLAIN_YAML = {
    "AliasEvent",
    "BaseLoader",
    "CollectionEndEvent",
    "CollectionStartEvent",
    "YAMLError",
    "load",
    "parse",
}


def test_no_code_from_a_file_is_executed() -> None:
    """No eval, no pickle, no shell anywhere in the packages."""
    found = []
    for name, tree in parsed_modules():
        for node in ast.walk(tree):
            where = f"{name}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, (ast.Import, ast.ImportFrom)):
                names = [a.name for a in node.names] + [getattr(node, "module", None) or ""]
                loads = [n for n in names if n.split(".")[0] in LOADS_CODE]
                own = loads == ["pickle"] and name in OWN_PICKLES
                found += [] if own else [(where, n) for n in loads]
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "yaml":
                found += [] if node.attr in PLAIN_YAML else [(where, f"yaml.{node.attr}")]
            if not isinstance(node, ast.Call):
                continue
            called = ast.unparse(node.func)
            keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
            if called in RUNS_TEXT or called in ("os.system", "os.popen"):
                found.append((where, called))
            if called == "np.load" and keywords.get("allow_pickle") != "False":
                found.append((where, "np.load"))
            if keywords.get("shell", "False") != "False":
                found.append((where, "shell"))
    assert found == []


PLACES = ("two words", "µ ü 測定", "a'b\"c", "-dash", os.fsdecode(b"bad\xff"))


@pytest.mark.parametrize("place", PLACES)
def test_folder_with_unusual_name_works(
    place: str, small_run: Path, tmp_path: Path, call: Call
) -> None:
    folder = tmp_path / place
    folder.mkdir()
    stack, reconstruction = folder / "stack.exr", folder / "r.exr"
    assert call("expose", small_run / "transport.exr", "-o", stack)[0] == 0
    assert call("decode", stack, "-o", reconstruction)[0] == 0
    status, out, err = call("evaluate", reconstruction, small_run / "truth.exr", "--json")
    assert status == 0, err
    assert out.startswith("{")
    assert call("export", stack, "-o", folder / "frames")[0] == 0
    manifest = folder / "frames" / "manifest.toml"
    # --force: the checks need more pixels than these frames have.
    assert call("import", manifest, "-o", folder / "again.exr", "--force")[0] == 0
    again = scenes.Stack.read(folder / "again.exr")
    assert (again.frames == scenes.Stack.read(stack).frames).all()


LOCALES = {
    "C, without UTF-8": {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "ASCII": {"PYTHONIOENCODING": "ascii", "LANG": "C"},
    # If it is installed, C libraries print and read a decimal comma.
    "German": {"LC_ALL": "de_DE.UTF-8", "LC_NUMERIC": "de_DE.UTF-8"},
}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="locales of POSIX")
def test_locales_change_no_byte_and_no_answer(tmp_path: Path) -> None:
    results = {}
    for name, env in {"plain": {}, **LOCALES}.items():
        folder = tmp_path / name
        folder.mkdir()
        command = start("run", "step", "-o", "µ out", *SMALL, folder=folder, env=env)
        status, out, err = finish(command)
        assert status == 0, (name, err)
        assert "step_height" in out
        (where,) = folder.iterdir()
        results[name] = {
            k: v
            for k, v in contents(where).items()
            if k.endswith((".exr", ".toml", ".json", ".ply"))
        }
    for name in LOCALES:
        assert results[name] == results["plain"], name
