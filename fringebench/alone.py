"""One run at a time in an output folder: the files of two would be mixed, each whole and together wrong."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scenes.errors import FileError


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Hold an existing folder until the block ends, or the process, however it does.

    Raises `FileError` if another run holds it. Where the system has no locks (Windows, some network file systems) two
    runs are not told apart.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    try:
        held = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise FileError(
            f"cannot use the folder '{folder}': {error.strerror or error}; choose another with -o"
        ) from error
    try:
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileError(
                f"another run is writing to '{folder}': wait for it, or choose another folder with -o"
            ) from None
        except OSError:
            pass
        yield
    finally:
        os.close(held)
