"""Is there memory for it? Asked before starting, because a machine that runs out kills instead of refusing."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.errors import TooLargeError

CGROUP = Path("/sys/fs/cgroup")
GIB = 2**30
# Version 1 of control groups says so many bytes for no limit, or nearly; version 2 says "max".
NO_LIMIT = 2**60


@contextmanager
def room_for(needed_bytes: int, what: str, remedy: str) -> Iterator[None]:
    """Do something that takes about `needed_bytes` more memory; `what` and `remedy` are for the message.

    Raises `TooLargeError` before the block if that is more than there is, and for a `MemoryError` in the block.
    """
    available = available_bytes()
    if available is not None and needed_bytes > available:
        raise TooLargeError(
            f"{what} needs about {told(needed_bytes)} of memory, {told(available)} are free: {remedy}"
        )
    try:
        yield
    except MemoryError as error:
        raise TooLargeError(
            f"{what} needs about {told(needed_bytes)} of memory, and more than there was: {remedy}"
        ) from error


def available_bytes() -> int | None:
    """Memory that this process may still take: the machine's, its container's or its own limit, whichever is least.

    None where the system does not say.
    """
    known = [n for n in (_machine(), _container(), _process()) if n is not None]
    return max(min(known), 0) if known else None


def _machine() -> int | None:
    """Free memory, what the system can free, and swap."""
    with suppress(OSError, ValueError, IndexError):
        lines = dict(
            line.split(":", 1) for line in Path("/proc/meminfo").read_text("ascii").splitlines()
        )
        return sum(int(lines[key].split()[0]) * 1024 for key in ("MemAvailable", "SwapFree"))
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _container() -> int | None:
    """What is left under a control group's limit, version 2 or 1; pages of files do not count, they can be dropped."""
    for limit, used, cache in (
        ("memory.max", "memory.current", "memory.stat"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "memory/memory.stat"),
    ):
        with suppress(OSError, ValueError, KeyError):
            total = int((CGROUP / limit).read_text("ascii"))
            if total > NO_LIMIT:
                return None  # what is used takes the system longer to say
            stat = dict(line.split() for line in (CGROUP / cache).read_text("ascii").splitlines())
            return total - int((CGROUP / used).read_text("ascii")) + int(stat["inactive_file"])
    return None


def _process() -> int | None:
    """What is left under ``ulimit -v``."""
    if sys.platform == "win32":
        return None
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return None
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    except OSError:
        return limit
    return limit - pages * resource.getpagesize()


def told(count: int) -> str:
    """Bytes in words."""
    return f"{count / GIB:.3g} GiB"
