"""Arrays that may be larger than memory: beyond a size they are mapped from a temporary file without a name.

The system writes such pages to the disk when memory runs short, and reads them again when they are accessed. The file is
removed with the array, however the process ends.
"""

import math
import mmap
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from scenes.support import memory
from scenes.support.errors import TooLargeError

# Larger arrays are mapped from a file; so are those above a quarter of the free memory.
MAX_IN_MEMORY_BYTES = 2**30
MAX_FREE_FRACTION = 0.25
_ZEROS = bytes(2**24)


def array(shape: Sequence[int], dtype: DTypeLike, what: str, remedy: str) -> NDArray[Any]:
    """An uninitialised array, in memory or mapped from a temporary file if it is large; `what` and `remedy` are for the
    message.

    The file is in the folder of temporary files; TMPDIR names another. /var/tmp is used where that folder is kept in
    memory itself.

    >>> array((2, 3), "f4", "an example", "make it smaller").shape
    (2, 3)
    """
    needed = math.prod(shape) * np.dtype(dtype).itemsize
    available = memory.available_bytes()
    limit = MAX_IN_MEMORY_BYTES
    if available is not None:
        limit = min(limit, int(available * MAX_FREE_FRACTION))
    folder = _folder()
    disk = free_disk_bytes(folder)
    if needed > limit and disk < needed and available is not None and available < needed:
        raise TooLargeError(
            f"{what} needs about {memory.gib(needed)} of memory or disk, {memory.gib(available)} of memory and "
            f"{memory.gib(disk)} of '{folder}' are free: {remedy}, or let TMPDIR name a folder on a larger disk"
        )
    try:
        if needed <= limit or disk < needed:
            return np.empty(shape, dtype)
        with tempfile.TemporaryFile(dir=folder) as file:
            _reserve(file, needed)
            pages = mmap.mmap(file.fileno(), needed)
    except (MemoryError, OSError, ValueError, OverflowError) as error:
        raise TooLargeError(
            f"{what} needs about {memory.gib(needed)} of memory, or of disk in '{folder}', and there is no room "
            f"({error}): {remedy}"
        ) from error
    return np.frombuffer(pages, dtype).reshape(shape)


def release_pages(array: NDArray[Any]) -> None:
    """Drop the memory pages of an array mapped from a file, until it is accessed again; others are unchanged.

    The system does so when it needs room; doing it early keeps the process's resident memory small.
    """
    owner: Any = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    pages = owner.obj if isinstance(owner, memoryview) else owner
    if isinstance(pages, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        pages.madvise(mmap.MADV_DONTNEED)


def free_disk_bytes(folder: Path) -> int:
    """Free bytes on a folder's disk; 0 if unknown."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _folder() -> Path:
    """Folder of large temporary files: on a disk, unless the user names another."""
    usual = Path(tempfile.gettempdir())
    lasting = Path("/var/tmp")
    if os.environ.get("TMPDIR") or not _in_memory(usual) or not os.access(lasting, os.W_OK):
        return usual
    return usual if _in_memory(lasting) else lasting


def _in_memory(folder: Path) -> bool:
    """Whether a folder's file system keeps its files in memory, as /tmp does on many systems."""
    with suppress(OSError, IndexError):
        mounts = Path("/proc/self/mountinfo").read_text("utf-8", "surrogateescape").splitlines()
        device = folder.stat().st_dev
        for line in mounts:
            where, _, what = line.partition(" - ")
            if where.split()[2] == f"{os.major(device)}:{os.minor(device)}":
                return what.split()[0] in ("tmpfs", "ramfs")
    return False


def _reserve(file: IO[bytes], size: int) -> None:
    """Reserve the disk's room now: a page that finds none later ends the process."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    for start in range(0, size, len(_ZEROS)):
        file.write(_ZEROS[: size - start])
    file.flush()
