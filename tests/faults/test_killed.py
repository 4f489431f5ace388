"""kill -9 at any moment: each file is the old or the complete new one, and leftovers are removed by the next write."""

import ast
import random
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

import scenes
from scenes.files import exr
from scenes.support.atomic_file import UNFINISHED, replacing
from tests.commands import SMALL, contents, finish, parsed_modules, program, start

OLD, NEW = "the old file\n" * 1000, "the new file\n" * 1000
# A process is killed at each of these moments while it replaces a file.
MOMENTS = {
    "just opened": "die()",
    "half written": "staged.write_text(new[: len(new) // 2]); die()",
    "written": "staged.write_text(new); die()",
    "about to be renamed": "staged.write_text(new); os.fsync = lambda fd: die()",
    "renamed": "staged.write_text(new); Path.replace = renamed_then_die",
}


def killed_while_replacing(folder: Path) -> None:
    """Children of one process, killed while each replaces ``folder/MOMENT/a.txt``."""
    moments = {name: textwrap.indent(code, "    ") for name, code in MOMENTS.items()}
    script = f"""
import os, signal
from pathlib import Path
from scenes.support.atomic_file import replacing

def die():
    os.kill(os.getpid(), signal.SIGKILL)

def renamed_then_die(self, target):
    os.replace(self, target)
    die()

for name, code in {moments!r}.items():
    child = os.fork()
    if not child:
        path = Path({str(folder)!r}) / name / "a.txt"
        exec("with replacing(path) as staged:\\n" + code, globals() | {{"path": path, "new": {NEW!r}}})
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL, name
"""
    done = program(script)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="fork")
def test_killed_write_leaves_the_old_or_the_new_file(tmp_path: Path) -> None:
    for moment in MOMENTS:
        (tmp_path / moment).mkdir()
        (tmp_path / moment / "a.txt").write_text(OLD)
    killed_while_replacing(tmp_path)
    for moment in MOMENTS:
        path = tmp_path / moment / "a.txt"
        assert path.read_text() == (NEW if moment == "renamed" else OLD)
        left = [p.name for p in path.parent.iterdir() if p != path]
        assert all(name.startswith(UNFINISHED) for name in left)
        assert len(left) == (moment != "renamed")
        with replacing(path.with_name("b.txt")) as staged:
            staged.write_text("another")
        assert {p.name for p in path.parent.iterdir()} == {"a.txt", "b.txt"}


def test_unfinished_file_of_a_running_process_is_kept(tmp_path: Path) -> None:
    with replacing(tmp_path / "slow.txt") as slow:
        slow.write_text("begun")
        for name in ("a.txt", "b.txt"):
            with replacing(tmp_path / name) as staged:
                staged.write_text(name)
        slow.write_text("done")
    assert (tmp_path / "slow.txt").read_text() == "done"
    assert len(list(tmp_path.iterdir())) == 3


# Names of the paths that `replacing` and the store of data sets give.
STAGED = {"beside", "staged", "temporary"}
APART = {
    # Staged, then put in place by the store.
    "fringebench/datasets/building.py": {"write_text"},
    # Inside the process that runs a decoder: a folder that is deleted with it.
    "fringebench/gate/warden.py": {"write_text"},
    # To a buffer in memory.
    "scenes/support/notebook.py": {"savefig"},
}


def test_every_file_is_written_under_a_temporary_name() -> None:
    """Each write goes to a path that `replacing` gave, or the tests above say nothing about that command."""
    found = []
    for name, tree in parsed_modules():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute):
                continue
            method, owner = node.func.attr, node.func.value
            if method == "open" and any(
                isinstance(a, ast.Constant) and str(a.value)[:1] in "wax" for a in node.args[:1]
            ):
                found.append((name, ast.unparse(node)))
            if method in ("write_text", "write_bytes", "savefig", "imwrite", "tofile"):
                target = owner if method.startswith("write") else node.args[0]
                if ast.unparse(target) not in STAGED and method not in APART.get(name, set()):
                    found.append((name, ast.unparse(node)))
    # Labels of a split go piece by piece to the staging folder of the store, a decoder's stack to a temporary folder.
    assert found == [
        ("fringebench/datasets/coco_files.py", "path.open('w', encoding='utf-8')"),
        ("fringebench/gate/decoders.py", "(place / 'stack').open('xb')"),
    ]


COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", "step", "--seed", "{seed}", "-o", ".", *SMALL),
    "stages": ("expose", "{made}/transport.exr", "--seed", "{seed}", "-o", "stack.exr"),
    "export": ("export", "{made}/stack.exr", "-o", "."),
    "dataset": ("dataset", "step", "--count", "4", "--workers", "1", "-o", ".", *SMALL),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_killed_at_random_lose_nothing_and_can_be_repeated(
    command: str, small_run: Path, tmp_path: Path
) -> None:
    def words(seed: int) -> list[str]:
        return [w.format(seed=seed, made=small_run) for w in COMMANDS[command]]

    began = time.perf_counter()
    status, _, err = finish(start(*words(0), folder=tmp_path))
    took = time.perf_counter() - began
    assert status == 0, err
    whole = {0: contents(tmp_path)}
    rng = random.Random(command)
    for seed in (1, 2):
        if command == "dataset":
            for path in tmp_path.glob("*"):
                subprocess.run(["rm", "-r", str(path)], check=True)
        process = start(*words(seed if command != "dataset" else 0), folder=tmp_path)
        # The first half is mostly imports.
        time.sleep(took * rng.uniform(0.4, 1.0))
        process.kill()
        finish(process)
        after = contents(tmp_path)
        assert not [n for n in whole[0].keys() - after.keys() if command in ("run", "stages")]
        for name, content in after.items():
            if UNFINISHED in name or name.startswith((".staging", "records")):
                continue
            if content != whole[0].get(name):
                read_whole(tmp_path / name)
    status, _, err = finish(start(*words(0), folder=tmp_path))
    assert status == 0, err
    again = contents(tmp_path)
    assert again.keys() == whole[0].keys()
    for name in again:
        if not name.endswith((".html", ".parquet")):
            assert again[name] == whole[0][name], name


def read_whole(path: Path) -> None:
    """Fail unless a file is complete."""
    if path.suffix == ".exr":
        assert exr.load(path)[1] is not None
    elif path.name == "scene.toml":
        scenes.load(path)
    else:
        text = path.read_bytes()
        assert text
        ends = {".html": b"</html>", ".json": b"}", ".toml": b"\n"}
        assert text.rstrip(b"\n").endswith(ends.get(path.suffix, b"").rstrip(b"\n"))
