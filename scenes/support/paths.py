"""Paths and names from users and their files: checked without exceptions, and never leading out of a folder."""

import re
from pathlib import Path

# All but letters, digits and characters that every file system and shell accepts.
UNSAFE = re.compile(r"[^\w.+-]+")
MAX_NAME_LENGTH = 100


def is_file(path: Path) -> bool:
    """Whether there is such a file; False instead of an exception for an invalid path."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def is_folder(path: Path) -> bool:
    """Whether there is such a folder; False instead of an exception for an invalid path."""
    try:
        return path.is_dir()
    except (OSError, ValueError):
        return False


def missing(path: Path) -> str:
    """What is wrong with a path for which `is_file` is False, for messages."""
    return "is a folder" if is_folder(path) else "does not exist"


def as_file_name(text: str) -> str:
    """A text made into one safe file name, neither hidden nor leading out of its folder.

    >>> as_file_name("../../etc/cron d")
    'etc-cron-d'
    """
    # A leading dot would make it hidden or a parent folder.
    plain = UNSAFE.sub("-", text).strip("-.")[:MAX_NAME_LENGTH].rstrip("-.")
    return plain or "unnamed"
