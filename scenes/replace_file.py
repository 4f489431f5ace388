"""Write beside, then rename: a file is either the old one or the whole new one."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scenes.errors import FileError


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to, and rename it over `path` if the block succeeds.

    Whatever fails, the file that was at `path` is untouched and nothing is left beside it. Raises `FileError` when the
    folder is missing or cannot be written, the disk is full, or `path` is no ordinary file: renaming over /dev/null
    would take it away.

    >>> with replacing("/tmp/answer.txt") as beside:
    ...     _ = beside.write_text("42")
    """
    try:
        # Behind a link lies the file that is meant; the link stays.
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise FileError(f"cannot write '{path}': it is a folder or a device; give a file name")
        # Of the same ending, which libraries go by. Not tempfile's: its files are private, and results are for
        # sharing, as the user's umask says.
        beside = target.with_name(f".{secrets.token_hex(8)}{target.suffix}")
        os.close(os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(
            f"cannot write '{path}': {reason}; choose a folder that exists and is writable"
        ) from error
    try:
        yield beside
        with beside.open("rb") as written:
            os.fsync(written.fileno())
        beside.replace(target)
    except OSError as error:
        raise FileError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)
