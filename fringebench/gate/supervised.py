"""A program under supervision: limited in time and output, and nothing it started outlives it."""

import os
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from scenes.support import memory
from scenes.support.errors import OutsideDecoderError

WARDEN = Path(__file__).with_name("warden.py")
# More output than this for one stack is an error of the program; its last bytes are kept for messages.
OUTPUT_LIMIT_BYTES = 64 << 20
TAIL_BYTES = 4096
# What a program may allocate above the free memory: libraries reserve for their threads what they never touch.
UNTOUCHED_BYTES = 2 << 30
# A warden that is asked to stop needs milliseconds; one that a decoder has stopped never answers.
WARDEN_S = 5.0
POLL_S = 0.05


class Supervised:
    """A running program. Use it as a context manager: at the end every process it started is killed."""

    def __init__(self, command: Sequence[str], pass_fds: Sequence[int] = ()) -> None:
        self.name = command[0]
        self._folder = tempfile.TemporaryDirectory(prefix="fringebench-warden-")
        self._status = Path(self._folder.name) / "status"
        # -I -S: neither the user's paths nor site packages, which take most of Python's start.
        limit = (memory.available_bytes() or -UNTOUCHED_BYTES) + UNTOUCHED_BYTES
        words = [sys.executable, "-I", "-S", str(WARDEN), str(self._status), str(limit), *command]
        self._warden = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            pass_fds=tuple(pass_fds),
        )
        self._tail = b""
        self._bytes = 0
        assert self._warden.stdout is not None
        self._reader = threading.Thread(
            target=self._drain, args=(self._warden.stdout,), daemon=True
        )
        self._reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()
        self._folder.cleanup()

    @property
    def last_line(self) -> str:
        """The last line that the program printed."""
        lines = self._tail.decode(errors="replace").strip().splitlines()
        return lines[-1].strip()[:400] if lines else "it printed nothing"

    def new_turn(self) -> None:
        """Start to count output from zero."""
        self._bytes = 0

    def check(self, deadline: float, limit_s: float) -> None:
        """Raise `OutsideDecoderError` when the program has taken too long (monotonic seconds) or printed too much."""
        if self._bytes > OUTPUT_LIMIT_BYTES:
            raise OutsideDecoderError(
                f"'{self.name}' printed more than {OUTPUT_LIMIT_BYTES >> 20} MB: print less, or nothing"
            )
        if time.monotonic() > deadline:
            raise OutsideDecoderError(
                f"'{self.name}' took longer than {limit_s:g} s: allow more with --timeout"
            )

    def read_line(self, source: IO[bytes], limit_s: float) -> bytes | None:
        """The next line from a pipe the program writes to; None when every writer has ended."""
        deadline = time.monotonic() + limit_s
        line = bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(source, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                self.check(deadline, limit_s)
                ended = self._warden.poll() is not None
                if selector.select(POLL_S):
                    read = os.read(source.fileno(), TAIL_BYTES)
                    if not read:
                        return None
                    line += read
                    if len(line) > 4 * TAIL_BYTES:
                        raise OutsideDecoderError(f"'{self.name}' wrote into the gate's own pipe")
                elif ended:
                    return None
        return bytes(line)

    def ending(self, status: int) -> str:
        """How it ended, in words."""
        return f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"

    def wait(self, limit_s: float) -> int:
        """Wait for the end; returns the exit status (negative: a signal). `OutsideDecoderError` if it cannot start, takes too
        long or prints too much.
        """
        deadline = time.monotonic() + limit_s
        while self._warden.poll() is None:
            self.check(deadline, limit_s)
            with suppress(subprocess.TimeoutExpired):
                self._warden.wait(POLL_S)
        self._reader.join(WARDEN_S)
        self.check(deadline + limit_s, limit_s)
        return self.exit_status()

    def exit_status(self) -> int:
        """How the program ended, once it has."""
        with suppress(subprocess.TimeoutExpired):
            self._warden.wait(WARDEN_S)
        said = self._said()
        if "failed" in said:
            raise OutsideDecoderError(
                f"'{self.name}' cannot be run: {said['failed']}; check the path of the command"
            )
        if "ended" not in said:
            raise OutsideDecoderError(
                f"'{self.name}' killed or stopped the process that supervises it"
            )
        return int(said["ended"])

    def stop(self) -> None:
        """Kill the program and all that it started."""
        for attempt in (signal.SIGTERM, signal.SIGKILL):
            if self._warden.poll() is None:
                self._warden.send_signal(attempt)
                with suppress(subprocess.TimeoutExpired):
                    self._warden.wait(WARDEN_S)
        # Where the warden itself was killed, its command's session is left.
        said = self._said()
        if "started" in said and not said.keys() & {"ended", "stopped"}:
            with suppress(OSError, ValueError):
                os.killpg(int(said["started"]), signal.SIGKILL)
        self._reader.join(WARDEN_S)
        if self._warden.stdout is not None and not self._reader.is_alive():
            self._warden.stdout.close()

    def _said(self) -> dict[str, str]:
        """What the warden wrote."""
        try:
            lines = self._status.read_text("utf-8").splitlines()
        except OSError:
            return {}
        return {word: rest for word, _, rest in (line.partition(" ") for line in lines)}

    def _drain(self, source: IO[bytes]) -> None:
        """Read all output, keep its end."""
        with suppress(OSError, ValueError):
            while read := os.read(source.fileno(), 1 << 16):
                self._bytes += len(read)
                self._tail = (self._tail + read)[-TAIL_BYTES:]
