"""Gerber text as commands: words such as ``X100Y200D01``, and extended commands between percent signs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

# No board is larger; a nanometre is lost beyond.
FARTHEST_MM = 1e5

_COMMENT = re.compile(r"G0?4(?!\d)[^*]*\*?")
# Attributes of apertures in files for readers older than X2.
_ATTRIBUTE = re.compile(r"G0?4\s*#@!\s*(T[AD][^*]*)\*")
_LENGTH = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")


class Malformed(ValueError):
    """A command that is not allowed or not known; the caller adds the file's name."""


@dataclass(frozen=True)
class Command:
    """One command without its asterisk and percent signs."""

    text: str
    extended: bool


def split_commands(text: str) -> Iterator[Command]:
    """Commands in order; comments are left out. Raises `Malformed` for an extended command without an end."""
    at = 0
    while at < len(text):
        if text[at].isspace():
            at += 1
        elif comment := _COMMENT.match(text, at):
            at = comment.end()
            if attribute := _ATTRIBUTE.match(comment[0]):
                yield Command(attribute[1], True)
            # Eagle writes percent signs into comments, the closing one after the asterisk.
            if comment[0].count("%") % 2 and text[at : at + 1] == "%":
                at += 1
        elif text[at] == "%":
            end = text.find("%", at + 1)
            if end < 0:
                raise Malformed("the file ends inside an extended command: it is cut off")
            yield from _extended(text[at + 1 : end])
            at = end + 1
        else:
            end = text.find("*", at)
            end = len(text) if end < 0 else end
            yield Command(re.sub(r"\s+", "", text[at:end]), False)
            at = end + 1


def _extended(text: str) -> Iterator[Command]:
    text = text.strip()
    if text.startswith("AM"):
        yield Command(text, True)
        return
    for part in text.split("*"):
        if part.strip():
            yield Command(part.strip(), True)


def number(text: str) -> float:
    """A decimal number; `Malformed` for anything else."""
    if not _LENGTH.match(text):
        raise Malformed(f"'{text[:40]}' is not a number")
    return float(text)


def length(value: float, mm: float = 1.0) -> float:
    """A length of `value` units of `mm` each, in mm; `Malformed` beyond the size of any board.

    GEOS crashes the process on an infinite coordinate.
    """
    found = value * mm
    if not abs(found) <= FARTHEST_MM:
        raise Malformed(
            f"there is a length of {found:g} mm, where up to {FARTHEST_MM:g} mm is allowed"
        )
    return found
