"""Runs one command and kills everything it started, when it ends or when the caller does.

A program of its own, started by `fringebench.gate.supervised`: ``python warden.py <status file> <bytes> <command> <words...>``. Uses
only the standard library, so that it starts within some 20 ms. Writes ``started <process id>``, then ``ended <exit status>``
or ``failed <reason>`` to the status file. The command may allocate so many bytes (0: without a limit).
"""

import ctypes
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType

# Linux: orphans of our descendants become our children, so that none is lost by a double fork.
PR_SET_CHILD_SUBREAPER = 36
# Linux: a signal for us when our parent dies.
PR_SET_PDEATHSIG = 1
PROC = Path("/proc")


class Stopped(Exception):
    """The caller asked for the end."""


def _stop(_signal: int, _frame: FrameType | None) -> None:
    raise Stopped


def main(status_file: str, memory_bytes: int, command: list[str]) -> None:
    """Run the command to its end, then kill what is left of it."""
    signal.signal(signal.SIGTERM, _stop)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
        _limit_memory(memory_bytes)
    status = Path(status_file)
    said = ""
    child: subprocess.Popen[bytes] | None = None
    try:
        # The pipes that the caller opened for the command are inherited; ours are closed, so that the end is seen.
        child = subprocess.Popen(command, start_new_session=True, close_fds=False)
        os.closerange(3, 1024)
        said = f"started {child.pid}\n"
        status.write_text(said)
        said += f"ended {child.wait()}\n"
    except OSError as error:
        said += f"failed {error.strerror or error}\n"
    except Stopped:
        said += "stopped\n"
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    _kill_all(child)
    status.write_text(said)


def _limit_memory(memory_bytes: int) -> None:
    """Without memory the command fails before the machine does, and is what the system ends first."""
    import resource

    with suppress(OSError):
        (PROC / "self" / "oom_score_adj").write_text("1000")
    with suppress(OSError, ValueError):
        if memory_bytes:
            resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, memory_bytes))


def _kill_all(child: "subprocess.Popen[bytes] | None") -> None:
    """Kill the command's session, and on Linux every descendant, until none is left."""
    for _ in range(200):
        if child is not None:
            with suppress(OSError):
                os.killpg(child.pid, signal.SIGKILL)
        left = _descendants(os.getpid())
        for pid in left:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
        with suppress(OSError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        if not left:
            return
        time.sleep(0.01)


def _descendants(root: int) -> list[int]:
    """Processes that descend from `root`, from ``/proc``; none where there is no such folder."""
    children: dict[int, list[int]] = {}
    for entry in PROC.iterdir() if PROC.is_dir() else ():
        if entry.name.isdigit():
            with suppress(OSError, ValueError, IndexError):
                # The name in parentheses may hold anything; state and parent follow the last one.
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                children.setdefault(parent, []).append(int(entry.name))
    found, new = [], [root]
    while new:
        new = [pid for parent in new for pid in children.get(parent, ())]
        found += new
    return found


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
