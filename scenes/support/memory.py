"""Free memory, checked before work starts: a machine that runs out kills the process instead of refusing."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from scenes.support.errors import TooLargeError

CGROUP = Path("/sys/fs/cgroup")
GIB = 2**30
# Control groups of version 1 give about this many bytes for "no limit"; version 2 says "max".
NO_LIMIT = 2**60
# Address space of the libraries with one thread, and of each processor's threads, with a margin of a third: the process that
# traces and decodes a small scene had 0.98 GB on one processor and 1.26 GB on two (NumPy, SciPy and OpenCV each bring an
# OpenBLAS; Dr.Jit brings LLVM). Below it they end the process by a signal.
LIBRARIES_BYTES, PROCESSOR_BYTES = int(0.9 * GIB), int(0.35 * GIB)


def require_address_space() -> None:
    """Raise `TooLargeError` where ``ulimit -v`` leaves no room for the libraries; called before they are loaded."""
    limit = _address_limit()
    processors = cores()
    needed = LIBRARIES_BYTES + PROCESSOR_BYTES * processors
    if limit is not None and limit < needed:
        raise TooLargeError(
            f"this process may use {gib(limit)} of address space (ulimit -v), and the libraries need {gib(needed)} on "
            f"{processors} processors: raise the limit to {-(-needed // 1024)} kB, or use fewer processors (taskset)"
        )


def cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@contextmanager
def room_for(needed_bytes: int, what: str, remedy: str) -> Iterator[None]:
    """Run a block that needs about `needed_bytes` more memory; `what` and `remedy` are for the message.

    Raises `TooLargeError` before the block if that is more than is free, and for a `MemoryError` in the block.
    """
    available = available_bytes()
    if available is not None and needed_bytes > available:
        raise TooLargeError(
            f"{what} needs about {gib(needed_bytes)} of memory, {gib(available)} are free: {remedy}"
        )
    try:
        yield
    except MemoryError as error:
        raise TooLargeError(
            f"{what} needs about {gib(needed_bytes)} of memory, more than is free: {remedy}"
        ) from error


def available_bytes() -> int | None:
    """Memory that this process may still use: the minimum of the machine's, its container's and its own limit.

    None where the system does not say.
    """
    known = [n for n in (_machine(), _container(), _process()) if n is not None]
    return max(min(known), 0) if known else None


def _machine() -> int | None:
    """Free memory, including what the system can free, and swap."""
    with suppress(OSError, ValueError, IndexError):
        lines = dict(
            line.split(":", 1) for line in Path("/proc/meminfo").read_text("ascii").splitlines()
        )
        return sum(int(lines[key].split()[0]) * 1024 for key in ("MemAvailable", "SwapFree"))
    with suppress(AttributeError, ValueError, OSError):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def _container() -> int | None:
    """What is left under a control group's limit, version 2 or 1; cached pages of files count as free."""
    for limit, used, cache in (
        ("memory.max", "memory.current", "memory.stat"),
        ("memory/memory.limit_in_bytes", "memory/memory.usage_in_bytes", "memory/memory.stat"),
    ):
        with suppress(OSError, ValueError, KeyError):
            total = int((CGROUP / limit).read_text("ascii"))
            if total > NO_LIMIT:
                return None  # Reading the usage would only take time.
            stat = dict(line.split() for line in (CGROUP / cache).read_text("ascii").splitlines())
            return total - int((CGROUP / used).read_text("ascii")) + int(stat["inactive_file"])
    return None


def _process() -> int | None:
    """What is left under ``ulimit -v``."""
    limit = _address_limit()
    if limit is None:
        return None
    try:
        pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    except OSError:
        return limit
    return limit - pages * os.sysconf("SC_PAGE_SIZE")


def _address_limit() -> int | None:
    """``ulimit -v`` in bytes; None for no limit."""
    if sys.platform == "win32":
        return None
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit


def gib(count: int) -> str:
    """Bytes in GiB, for messages."""
    return f"{count / GIB:.3g} GiB"
