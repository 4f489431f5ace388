"""kill -9 at any moment: each file is the old one or the whole new one, and what is left besides is swept away later."""

import ast
import os
import random
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

import scenes
from scenes.replace_file import UNFINISHED, replacing
from tests.faults.commands import ROOT, SMALL, finish, start

OLD, NEW = "the old file\n" * 1000, "the new file\n" * 1000
# One process dies at each of these moments while it replaces a file.
MOMENTS = {
    "just opened": "die()",
    "half written": "beside.write_text(new[: len(new) // 2]); die()",
    "written": "beside.write_text(new); die()",
    "about to be renamed": "beside.write_text(new); os.fsync = lambda fd: die()",
    "renamed": "beside.write_text(new); Path.replace = renamed_then_die",
}


def killed_while_replacing(path: Path, moment: str) -> None:
    script = f"""
        import os, signal
        from pathlib import Path
        from scenes.replace_file import replacing

        def die():
            os.kill(os.getpid(), signal.SIGKILL)

        def renamed_then_die(self, target):
            os.replace(self, target)
            die()

        new = {NEW!r}
        with replacing({str(path)!r}) as beside:
            {moment}
        """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        timeout=60,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_file_is_old_or_new_at_every_moment_and_leftovers_go(moment: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text(OLD)
    killed_while_replacing(path, MOMENTS[moment])
    assert path.read_text() == (NEW if moment == "renamed" else OLD)
    left = [p.name for p in tmp_path.iterdir() if p != path]
    assert all(name.startswith(UNFINISHED) for name in left)
    assert len(left) == (moment != "renamed")
    with replacing(tmp_path / "b.txt") as beside:
        beside.write_text("another")
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", "b.txt"}


def test_what_a_living_process_writes_is_not_swept_away(tmp_path: Path) -> None:
    with replacing(tmp_path / "slow.txt") as slow:
        slow.write_text("begun")
        for name in ("a.txt", "b.txt"):
            with replacing(tmp_path / name) as beside:
                beside.write_text(name)
        slow.write_text("done")
    assert (tmp_path / "slow.txt").read_text() == "done"
    assert len(list(tmp_path.iterdir())) == 3


# What `replacing` and the data sets' store give to write to.
STAGED = {"beside", "staged"}
APART = {
    # staged, then put in place by the store
    "fringebench/datasets/build.py": {"write_text"},
}


def test_every_file_is_written_beside() -> None:
    """Each write goes to what `replacing` gave, or the tests above say nothing of the command it belongs to."""
    found = []
    for package in ("scenes", "render", "decode", "evaluation", "fringebench"):
        for source in sorted((ROOT / package).rglob("*.py")):
            name = str(source.relative_to(ROOT))
            for node in ast.walk(ast.parse(source.read_text("utf-8"))):
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
    # a split's labels, piece by piece into the store's staging
    assert found == [("fringebench/datasets/coco_files.py", "path.open('w', encoding='utf-8')")]


def states(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()
    }


COMMANDS: dict[str, tuple[str, ...]] = {
    "run": ("run", "step", "--seed", "{seed}", "-o", ".", *SMALL),
    "stages": ("expose", "{made}/transport.exr", "--seed", "{seed}", "-o", "stack.exr"),
    "export": ("export", "{made}/stack.exr", "-o", "."),
    "dataset": ("dataset", "step", "--count", "4", "--workers", "1", "-o", ".", *SMALL),
}


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_commands_killed_at_random_lose_nothing_and_go_on(
    command: str, made: Path, tmp_path: Path
) -> None:
    def words(seed: int) -> list[str]:
        return [w.format(seed=seed, made=made) for w in COMMANDS[command]]

    began = time.perf_counter()
    status, _, err = finish(start(*words(0), folder=tmp_path))
    took = time.perf_counter() - began
    assert status == 0, err
    whole = {0: states(tmp_path)}
    rng = random.Random(command)
    for seed in (1, 2):
        if command == "dataset":
            for path in tmp_path.glob("*"):
                subprocess.run(["rm", "-r", str(path)], check=True)
        process = start(*words(seed if command != "dataset" else 0), folder=tmp_path)
        # the first half is mostly imports
        time.sleep(took * rng.uniform(0.4, 1.0))
        process.kill()
        finish(process)
        after = states(tmp_path)
        assert not [n for n in whole[0].keys() - after.keys() if command in ("run", "stages")]
        for name, content in after.items():
            if UNFINISHED in name or name.startswith((".staging", "records")):
                continue
            if content != whole[0].get(name):
                read_whole(tmp_path / name)
    status, _, err = finish(start(*words(0), folder=tmp_path))
    assert status == 0, err
    again = states(tmp_path)
    assert again.keys() == whole[0].keys()
    for name in again:
        if not name.endswith((".html", ".parquet")):
            assert again[name] == whole[0][name], name


def read_whole(path: Path) -> None:
    """Raise unless a file is whole."""
    if path.suffix == ".exr":
        assert scenes.exr.load(path)[1] is not None
    elif path.name == "scene.toml":
        scenes.load(path)
    else:
        text = path.read_bytes()
        assert text
        ends = {".html": b"</html>", ".json": b"}", ".toml": b"\n"}
        assert text.rstrip(b"\n").endswith(ends.get(path.suffix, b"").rstrip(b"\n"))
