"""Documentation, messages, comments, docstrings and tests are in plain contemporary English.

The list holds words that have no plain use here; what they meant, or what to write instead, is on the right.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.commands import ROOMS, ROOT

FOLDERS = (*ROOMS, "benchmarks", "adapters", "tests")
INSTEAD = {
    r"thrice": "three times",
    r"anew": "again",
    r"astride": "on the edge between",
    r"obituary": "reason of an exit",
    r"doom(?:ed|s)?": "say what happens",
    r"befalls?|befell|befallen": "happens to",
    r"mend(?:s|ed|ing)?": "fix, correct",
    r"(?:goes|go|gone|going) on with": "continues",
    r"h[eo]ld(?:s|ing)? (?:\w+ ){0,4}against": "compare with",
    r"could not be had": "were skipped, with the reason",
    r"(?:is|are|be|was|were|been|unless|when|as|not) told": "is given, is detected",
    r"told (?:from|apart)": "distinguished from",
    r"what one takes": "say what it is",
    r"for who needs": "to reuse",
    r"whence|thence|hither|whither": "from where, from there",
    r"amiss": "wrong",
    r"(?:stands?|stood|standing) (?:beside|for itself|ready)": "is next to",
    r"beside and renamed": "under another name and renamed",
    r"let go of": "release",
    r"aught|naught": "anything, nothing",
    r"begets?|begotten": "causes",
    r"of its own accord": "by itself, automatically",
    r"takes? who": "say what it is",
    r"knows? nobody": "imports no other room",
    r"never meet": "do not import each other",
    r"(?:which|what) cause owns|owns? which": "how much each cause contributes",
    r"in vain": "without effect",
}
WORD = re.compile(rf"\b(?:{'|'.join(INSTEAD)})\b", re.IGNORECASE)


def _texts() -> Iterator[Path]:
    yield from sorted(ROOT.glob("*.md"))
    yield from sorted((ROOT / "docs").rglob("*.md"))
    yield from sorted((ROOT / "docs").rglob("*.py"))
    for room in FOLDERS:
        for ending in ("py", "toml", "j2"):
            # This file is made of the words.
            yield from sorted(set((ROOT / room).rglob(f"*.{ending}")) - {Path(__file__)})


def test_word_list_matches_its_own_examples() -> None:
    for said in ("drawn anew", "held it against theory", "unless told", "mends most of it"):
        assert WORD.search(said), said
    for said in ("recommended", "threefold", "amended", "holds for all"):
        assert not WORD.search(said), said


@pytest.mark.parametrize("folder", ["docs", *FOLDERS, "."])
def test_texts_use_plain_words(folder: str) -> None:
    found = []
    for path in _texts():
        place = path.relative_to(ROOT)
        if (place.parts[0] if len(place.parts) > 1 else ".") == folder:
            # A phrase may run over the end of a line, or be a name.
            text = path.read_text("utf-8")
            for match in WORD.finditer(re.sub(r"[\s_]", " ", text)):
                line = text.count("\n", 0, match.start()) + 1
                found.append(f"{place}:{line}: {match.group()}")
    assert not found, "\n".join(found)
