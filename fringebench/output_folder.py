"""One run at a time in an output folder: a mixture of the files of two runs would be wrong."""

import json
import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock an existing folder until the block or the process ends.

    Raises `FileError` if another run holds the lock. Where the system has no locks (Windows, some network file systems)
    another run is not detected.
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


@contextmanager
def one_run(
    folder: Path, files: Collection[str] = ()
) -> Iterator[Callable[[str, Callable[[Path], None]], None]]:
    """Yield a function that writes a file of a given name into `folder`; a `KeyboardInterrupt` says which were written.

    If one of `files` exists already, nothing is written before the block has succeeded: a mixture of the files of two
    runs would be wrong. Raises `FileError` while another run writes there.
    """
    written: list[str] = []
    later: list[tuple[str, Callable[[Path], None]]] = []

    def put(name: str, write: Callable[[Path], None]) -> None:
        write(folder / name)
        written.append(name)

    try:
        with locked(folder):
            earlier = any((folder / name).exists() for name in files)
            yield (lambda name, write: later.append((name, write))) if earlier else put
            for name, write in later:
                put(name, write)
    except KeyboardInterrupt:
        kept = ", ".join(written) or "nothing new"
        raise KeyboardInterrupt(f"complete files in {folder}: {kept}") from None
    except FileError as error:
        if not later or not written:
            raise
        raise FileError(
            f"{error}; in '{folder}' {', '.join(written)} are of this run, the other files of an earlier one: run again"
        ) from error


def prepare(folder: str | Path) -> Path:
    """The output folder, created if it does not exist; `FileError` if that fails."""
    out = Path(folder)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(
            f"cannot create the folder '{out}': {error.strerror or error}; choose another with -o"
        ) from error
    return out


def write_json(value: Any, path: str | Path) -> None:
    """Write a value as a JSON file, replaced as a whole; NaN and infinity are a `ValueError`."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(value, indent=2, allow_nan=False) + "\n", "utf-8")
