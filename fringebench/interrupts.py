"""Ctrl-C is heard where it does no harm.

A `KeyboardInterrupt` that is raised while native code calls back into Python (Dr.Jit tracing a loop, Mitsuba importing its
variant) cannot pass through it: the process aborts, or the interrupt turns into a `SystemError`. So while a step runs the
signal is only noted, and raised when the step next says how far it is, or ends.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class Patience:
    """A signal handler that waits; asked twice, it does not."""

    def __init__(self) -> None:
        self.asked = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Note the signal."""
        if self.asked:
            raise KeyboardInterrupt
        self.asked = True

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if asked to."""
        if self.asked:
            self.asked = False
            raise KeyboardInterrupt


@contextmanager
def patient() -> Iterator[Patience]:
    """While the block runs SIGINT waits for `Patience.check`, or the block's end.

    What fails after the signal, a child process that got it too, say, is taken for its consequence. In another thread than
    the main one, or where a program has a handler of its own, nothing changes.
    """
    handler = signal.getsignal(signal.SIGINT)
    if isinstance(handler, Patience):  # a step within a step
        yield handler
        handler.check()
        return
    waiting = Patience()
    ours = (
        handler is signal.default_int_handler
        and threading.current_thread() is threading.main_thread()
    )
    if ours:
        signal.signal(signal.SIGINT, waiting)
    try:
        yield waiting
    except Exception:
        waiting.check()
        raise
    finally:
        if ours:
            signal.signal(signal.SIGINT, handler)
    waiting.check()
