"""Examples in the documentation work: commands and programs are run, and files are written.

A block of a page is used if the line above it is one of these comments:

- ``<!-- run -->``: a ``console`` block's ``$`` lines run in the shell and succeed, and what the block prints below them is
  in their output (``...`` matches anything); a ``python`` block runs as a program. Status 1: ``<!-- run: status 1 -->``;
  where a package is needed: ``<!-- run: needs distributed -->``.
- ``<!-- file: NAME -->``: the block is written to that file; ``<!-- append: NAME -->``: added to it.

The blocks of a page run in order, in one folder that is empty at first.
"""

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BLOCK = re.compile(
    r"^[ ]*<!-- (?P<what>run|file|append)(?:: (?P<how>[^>]*?))? -->\s*\n(?P<indent>[ ]*)```(?P<kind>\w+)\n"
    r"(?P<text>.*?)^(?P=indent)```\s*$",
    re.MULTILINE | re.DOTALL,
)
TIMEOUT_S = 600
# A number that is part of a name does not count.
NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?![\w.])")


@dataclass(frozen=True)
class Block:
    """A marked block: what to do with it, the rest of the comment, its language and its text."""

    what: str
    how: str
    kind: str
    text: str


def blocks(page: Path) -> list[Block]:
    """A page's marked blocks."""
    found = []
    for match in BLOCK.finditer(page.read_text("utf-8")):
        indent = len(match["indent"])
        text = "".join(line[indent:] for line in match["text"].splitlines(keepends=True))
        found.append(Block(match["what"], match["how"] or "", match["kind"], text))
    return found


PAGES = sorted(page for page in DOCS.glob("*.md") if blocks(page))


def test_pages_with_examples_are_found() -> None:
    assert {"tutorial.md", "how-to-own-mesh.md", "how-to-own-decoder.md"} <= {p.name for p in PAGES}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_a_page_work(page: Path, tmp_path: Path) -> None:
    for block in blocks(page):
        if block.what == "file":
            (tmp_path / block.how).write_text(block.text, "utf-8")
        elif block.what == "append":
            with (tmp_path / block.how).open("a", encoding="utf-8") as file:
                file.write(block.text)
        elif not block.how.startswith("needs ") or importlib.util.find_spec(block.how.split()[1]):
            _run(block, tmp_path)


def _run(block: Block, folder: Path) -> None:
    status = int(block.how.removeprefix("status ")) if block.how.startswith("status ") else 0
    if block.kind == "python":
        (folder / "block.py").write_text(block.text, "utf-8")
        code, output = _call([sys.executable, "block.py"], folder)
        assert code == status, output
        return
    assert block.kind == "console", f"a block of {block.kind} cannot be run"
    for command, printed in _commands(block.text):
        # With a command after it, the shell stays its parent: `--show-completion` looks for it.
        code, output = _call(["bash", "-c", f"{command}\nexit $?"], folder)
        assert code == status, f"$ {command}\n{output}"
        for line in printed:
            assert _printed(line, output), f"$ {command}\ndoes not print: {line}\nbut:\n{output}"


def _call(words: list[str], folder: Path) -> tuple[int, str]:
    # Commands come from the environment that runs the tests; tables are as wide as on the page.
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "COLUMNS": "120", "PYTHONWARNINGS": "default"}
    done = subprocess.run(
        words, cwd=folder, env=env, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    return done.returncode, done.stdout + done.stderr


def _commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Each command with what it prints; a backslash at the end of a line continues it."""
    command, more = "", False
    printed: list[str] = []
    for line in text.splitlines():
        if line.startswith("$ ") or more:
            if not more and command:
                yield command, printed
            command = f"{command}\n{line}" if more else line[2:]
            printed = printed if more else []
            more = line.endswith("\\")
        elif line.strip():
            printed.append(line)
    if command:
        yield command, printed


def _printed(line: str, output: str) -> bool:
    """Whether the output has the page's line: ``...`` matches anything, numbers may differ a little.

    Rounding differs between machines, so a number may differ by a fifth, or by five units of its last digit.
    """
    wanted = [float(number) for number in NUMBER.findall(line)]
    parts = [re.escape(part) for part in NUMBER.sub("\0", " ".join(line.split())).split("...")]
    pattern = (
        ".*".join(parts)
        .replace("\0", f"({NUMBER.pattern})")
        .replace(re.escape("\0"), f"({NUMBER.pattern})")
    )
    ends = [10.0 ** -len(text.partition(".")[2]) for text in NUMBER.findall(line)]
    for candidate in output.splitlines():
        found = re.search(pattern, " ".join(candidate.split()))
        if found and all(
            abs(float(got) - want) <= max(0.2 * abs(want), 5.0 * end)
            for got, want, end in zip(found.groups(), wanted, ends, strict=True)
        ):
            return True
    return False
