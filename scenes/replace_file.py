"""Write beside, then rename: a file is either the old one or the whole new one."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scenes.errors import FileError


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to, and rename it over `path` if the block succeeds.

    Whatever fails, the file that was at `path` is untouched and nothing is left beside it. Raises `FileError` when the
    folder is missing or cannot be written, or the disk is full.

    >>> with replacing("/tmp/answer.txt") as beside:
    ...     _ = beside.write_text("42")
    """
    target = Path(path)
    if target.is_dir():
        raise FileError(f"cannot write '{target}': it is a folder; give a file name")
    try:
        handle, name = tempfile.mkstemp(
            prefix=f".{target.name}.", suffix=target.suffix, dir=target.parent
        )
    except OSError as error:
        raise FileError(
            f"cannot write '{target}': {error.strerror or error}; choose a folder that exists and is writable"
        ) from error
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        # mkstemp makes private files; results are for sharing, so follow the user's umask.
        umask = os.umask(0)
        os.umask(umask)
        beside.chmod(0o666 & ~umask)
        with beside.open("rb") as written:
            os.fsync(written.fileno())
        beside.replace(target)
    except OSError as error:
        raise FileError(f"cannot write '{target}': {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)
