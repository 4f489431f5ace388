"""Names that users, or files of theirs, give: asked for safely, and never leading out of a folder."""

import re
from pathlib import Path

# Letters, digits and what no file system or shell minds; the first is no dot, so that nothing is hidden or a parent.
STRANGE = re.compile(r"[^\w.+-]+")
LONGEST_NAME = 100


def is_file(path: Path) -> bool:
    """Whether there is such a file; no name is too long or too strange to ask."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; no name is too long or too strange to ask."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def missing(path: Path) -> str:
    """What is wrong with a path that `is_file` denies."""
    return "is a folder" if is_folder(path) else "does not exist"


def as_file_name(text: str) -> str:
    """A text as one file name: it stays in the folder it is joined to, whatever it says.

    >>> as_file_name("../../etc/cron d")
    'etc-cron-d'
    """
    plain = STRANGE.sub("-", text).strip("-.")[:LONGEST_NAME].rstrip("-.")
    return plain or "unnamed"
