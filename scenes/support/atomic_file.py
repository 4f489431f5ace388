"""Write to a temporary file, then rename it: a file is either the old one or the complete new one."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.support.errors import FileError

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

# Prefix of files being written, or left by a killed process: hidden, and not to be mistaken for a result.
UNFINISHED = ".unfinished-"


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Write a file as a whole: a temporary file with the same ending is renamed over `path` if the block succeeds.

    On any error the previous file at `path` is unchanged and the temporary one is removed. A process that is killed
    leaves a hidden ``.unfinished-*``, which the next write into that folder removes. Raises `FileError` if the folder
    is missing or not writable, the disk is full, or `path` is not an ordinary file (renaming over /dev/null would
    replace it).

    >>> with replacing("/tmp/answer.txt") as temporary:
    ...     _ = temporary.write_text("42")
    """
    target, temporary, lock = _prepared(path)
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(target)
    except OSError as error:
        raise FileError(f"cannot write '{path}': {error.strerror or error}") from error
    finally:
        temporary.unlink(missing_ok=True)
        if lock is not None:
            os.close(lock)


def require_writable(*paths: str | Path | None) -> None:
    """Raise the `FileError` that `replacing` would raise, before the work is done; None is skipped."""
    for path in paths:
        if path is not None:
            _, temporary, lock = _prepared(path)
            temporary.unlink(missing_ok=True)
            if lock is not None:
                os.close(lock)


def _prepared(path: str | Path) -> tuple[Path, Path, int | None]:
    """The file meant by a path, an empty temporary one in its folder, and the descriptor that locks the latter."""
    try:
        # A link stays; the file it points to is replaced.
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise FileError(f"cannot write '{path}': it is a folder or a device; give a file name")
        _sweep(target.parent)
        return target, *_temporary(target)
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(
            f"cannot write '{path}': {reason}; choose a folder that exists and is writable"
        ) from error


def _temporary(target: Path) -> tuple[Path, int | None]:
    """An empty file in the target's folder, and the descriptor that locks it; None where files cannot be locked."""
    while True:
        # The same ending, because libraries choose the format by it. Not made by tempfile: its files are private,
        # while results get the permissions of the user's umask.
        temporary = target.with_name(f"{UNFINISHED}{secrets.token_hex(8)}{target.suffix}")
        lock = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666)
        if fcntl is None:
            os.close(lock)
            return temporary, None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if temporary.exists():
                return temporary, lock
        except BlockingIOError:
            pass
        except OSError:
            os.close(lock)
            return temporary, None
        # Another process removed it in the instant before it was locked: try again.
        os.close(lock)


def _sweep(folder: Path) -> None:
    """Remove what killed processes left in a folder; files that a running one is writing are locked and stay."""
    if fcntl is None:
        return
    for path in folder.glob(f"{UNFINISHED}*"):
        with suppress(OSError):
            lock = os.open(path, os.O_RDONLY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink(missing_ok=True)
            finally:
                os.close(lock)
