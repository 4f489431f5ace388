"""Write beside, then rename: a file is either the old one or the whole new one."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.errors import FileError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# What is being written, and what a killed process left: hidden, and named so that nobody takes it for a result.
UNFINISHED = ".unfinished-"


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to, and rename it over `path` if the block succeeds.

    Whatever fails, the file that was at `path` is untouched and nothing is left beside it. A process that is killed
    leaves a hidden ``.unfinished-*``, which the next write into that folder takes away. Raises `FileError` when the
    folder is missing or cannot be written, the disk is full, or `path` is no ordinary file: renaming over /dev/null
    would take it away.

    >>> with replacing("/tmp/answer.txt") as beside:
    ...     _ = beside.write_text("42")
    """
    target, beside, held = _begun(path)
    try:
        yield beside
        with beside.open("rb") as written:
            os.fsync(written.fileno())
        beside.replace(target)
    except OSError as error:
        raise FileError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        beside.unlink(missing_ok=True)
        if held is not None:
            os.close(held)


def require_writable(*paths: str | Path | None) -> None:
    """Raise the `FileError` of a path that `replacing` cannot write: before the work, not after. None is no path."""
    for path in paths:
        if path is not None:
            _, beside, held = _begun(path)
            beside.unlink(missing_ok=True)
            if held is not None:
                os.close(held)


def _begun(path: str | Path) -> tuple[Path, Path, int | None]:
    """Where a file belongs, an empty one beside it, and what keeps that one locked."""
    try:
        # Behind a link lies the file that is meant; the link stays.
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise FileError(f"cannot write '{path}': it is a folder or a device; give a file name")
        _sweep(target.parent)
        return target, *_made(target)
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(
            f"cannot write '{path}': {reason}; choose a folder that exists and is writable"
        ) from error


def _made(target: Path) -> tuple[Path, int | None]:
    """An empty file beside the target, and what keeps it locked; None where files cannot be locked."""
    while True:
        # Of the same ending, which libraries go by. Not tempfile's: its files are private, and results are for
        # sharing, as the user's umask says.
        beside = target.with_name(f"{UNFINISHED}{secrets.token_hex(8)}{target.suffix}")
        held = os.open(beside, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        if fcntl is None:
            os.close(held)
            return beside, None
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if beside.exists():
                return beside, held
        except BlockingIOError:
            pass
        except OSError:
            os.close(held)
            return beside, None
        # Another process sweeps it away, in the instant before it was locked.
        os.close(held)


def _sweep(folder: Path) -> None:
    """Take away what killed processes left in a folder; what a living one is writing is locked, and stays."""
    if fcntl is None:
        return
    for path in folder.glob(f"{UNFINISHED}*"):
        with suppress(OSError):
            held = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink(missing_ok=True)
            finally:
                os.close(held)
