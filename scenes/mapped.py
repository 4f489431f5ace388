"""Arrays that may be larger than memory: beyond a size, in a file without a name.

The system writes such pages to the disk when memory runs short, and reads them again when they are touched. The file goes
with the array, however the process ends.
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

from scenes import memory
from scenes.errors import TooLargeError

# Up to here an array lies in memory, and less where little of it is free.
HELD = 2**30
SHARE = 4
_ZEROS = bytes(2**24)


def array(shape: Sequence[int], dtype: DTypeLike, what: str, remedy: str) -> NDArray[Any]:
    """An array of any values; `what` it is for and the `remedy` are for the message.

    Beyond `HELD` bytes, or a `SHARE`-th of free memory, it is mapped from a file in the folder of temporary files (TMPDIR
    names another; /var/tmp where that one lies in memory itself). Raises `TooLargeError` where neither has room.

    >>> array((2, 3), "f4", "an example", "make it smaller").shape
    (2, 3)
    """
    needed = math.prod(shape) * np.dtype(dtype).itemsize
    available = memory.available_bytes()
    held = HELD if available is None else min(HELD, available // SHARE)
    folder = _folder()
    disk = free_disk_bytes(folder)
    if needed > held and disk < needed and available is not None and available < needed:
        raise TooLargeError(
            f"{what} needs about {memory.told(needed)} of memory or disk, {memory.told(available)} of memory and "
            f"{memory.told(disk)} of '{folder}' are free: {remedy}, or let TMPDIR name a folder on a larger disk"
        )
    try:
        if needed <= held or disk < needed:
            return np.empty(shape, dtype)
        with tempfile.TemporaryFile(dir=folder) as file:
            _reserve(file, needed)
            pages = mmap.mmap(file.fileno(), needed)
    except (MemoryError, OSError, ValueError, OverflowError) as error:
        raise TooLargeError(
            f"{what} needs about {memory.told(needed)} of memory, or of disk in '{folder}', and there is no room "
            f"({error}): {remedy}"
        ) from error
    return np.frombuffer(pages, dtype).reshape(shape)


def let_go(array: NDArray[Any]) -> None:
    """Take an array's file out of this process's memory until it is touched again; one in memory stays there.

    The system would, when it needs room; but what it counts as this process's is less, and soon.
    """
    owner: Any = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    pages = owner.obj if isinstance(owner, memoryview) else owner
    if isinstance(pages, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        pages.madvise(mmap.MADV_DONTNEED)


def free_disk_bytes(folder: Path) -> int:
    """What may still be written there; 0 if nothing."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _folder() -> Path:
    """Where large temporary files go: onto a disk, unless the user says otherwise."""
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
    """Take the disk's room now: a page that finds none later ends the process."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(file.fileno(), 0, size)
        return
    for start in range(0, size, len(_ZEROS)):
        file.write(_ZEROS[: size - start])
    file.flush()
