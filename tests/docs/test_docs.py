"""The documentation does what it says: its commands and programs are run, its files are written, and it builds.

A block of a page counts if a comment stands right above it:

- ``<!-- run -->``: a ``console`` block's ``$`` lines run in the shell and succeed, and what the block prints below them is
  in their output (``...`` stands for anything); a ``python`` block runs as a program. Status 1: ``<!-- run: status 1 -->``;
  where a package is needed: ``<!-- run: needs distributed -->``.
- ``<!-- file: NAME -->``: the block is written to that file; ``<!-- append: NAME -->``: added to it.

Blocks of a page run in order, in one empty folder.
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
LONGEST_S = 180
# Not one that is part of a name.
NUMBER = re.compile(r"(?<![\w.-])-?\d+(?:\.\d+)?(?![\w.])")


@dataclass(frozen=True)
class Block:
    """What to do with a block."""

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


def test_no_page_is_run() -> None:
    assert {"tutorial.md", "how-to-own-mesh.md", "how-to-own-decoder.md"} <= {p.name for p in PAGES}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_does_not_do_what_it_says(page: Path, tmp_path: Path) -> None:
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
        code, heard = _call([sys.executable, "block.py"], folder)
        assert code == status, heard
        return
    assert block.kind == "console", f"a block of {block.kind} cannot be run"
    for command, printed in _commands(block.text):
        code, heard = _call(["bash", "-c", command], folder)
        assert code == status, f"$ {command}\n{heard}"
        for line in printed:
            assert _told(line, heard), f"$ {command}\ndoes not print: {line}\nbut:\n{heard}"


def _call(words: list[str], folder: Path) -> tuple[int, str]:
    # The commands of the environment that runs the tests, as wide as a page shows them.
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    env = {**os.environ, "PATH": path, "COLUMNS": "120", "PYTHONWARNINGS": "default"}
    done = subprocess.run(
        words, cwd=folder, env=env, capture_output=True, text=True, timeout=LONGEST_S, check=False
    )
    return done.returncode, done.stdout + done.stderr


def _commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Each command (a backslash goes on) with what it prints."""
    command, printed, more = "", [], False
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


def _told(line: str, heard: str) -> bool:
    """Whether a line of the output is the page's: any space for a space, anything for ``...``, numbers near the page's.

    Another machine rounds otherwise: numbers may differ by a fifth, or by five of their last digit.
    """
    told = [float(number) for number in NUMBER.findall(line)]
    parts = [re.escape(part) for part in NUMBER.sub("\0", " ".join(line.split())).split("...")]
    pattern = (
        ".*".join(parts)
        .replace("\0", f"({NUMBER.pattern})")
        .replace(re.escape("\0"), f"({NUMBER.pattern})")
    )
    ends = [10.0 ** -len(text.partition(".")[2]) for text in NUMBER.findall(line)]
    for candidate in heard.splitlines():
        found = re.search(pattern, " ".join(candidate.split()))
        if found and all(
            abs(float(got) - want) <= max(0.2 * abs(want), 5.0 * end)
            for got, want, end in zip(found.groups(), told, ends, strict=True)
        ):
            return True
    return False


@pytest.mark.slow
def test_the_site_does_not_build_or_a_link_is_dead(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="mkdocs is not installed (pip install fringebench[docs])")
    pytest.importorskip("material", reason="mkdocs-material is not installed")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    reference = (tmp_path / "scene-reference.html").read_text("utf-8")
    for key in ("height_range_mm", "irradiance_w_m2", "quantum_efficiency", "periods_px"):
        assert key in reference
    assert (tmp_path / "scene.schema.json").stat().st_size > 10_000


def test_gallery_lacks_a_scene_or_its_pictures_are_large() -> None:
    import scenes

    text = (DOCS / "gallery.md").read_text("utf-8")
    for name in scenes.shipped():
        assert f"## {name}\n" in text
        assert (DOCS / "gallery" / f"{name}.webp").stat().st_size < 100_000
