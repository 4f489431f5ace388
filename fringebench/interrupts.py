"""Ctrl-C takes effect where it does no harm.

A `KeyboardInterrupt` raised while native code calls back into Python (Dr.Jit tracing a loop, Mitsuba importing its variant)
cannot pass through it: the process aborts, or the interrupt turns into a `SystemError`. So while a step runs the signal is
only recorded; it is raised when the step next reports progress, or ends.
"""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


class DeferredInterrupt:
    """Holds SIGINT until checked; a second signal raises at once."""

    def __init__(self) -> None:
        self.pending = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Record the signal."""
        if self.pending:
            raise KeyboardInterrupt
        self.pending = True

    def check(self) -> None:
        """Raise `KeyboardInterrupt` if a signal is pending."""
        if self.pending:
            self.pending = False
            raise KeyboardInterrupt


@contextmanager
def deferred_interrupt() -> Iterator[DeferredInterrupt]:
    """While the block runs, SIGINT waits for `DeferredInterrupt.check` or the end of the block.

    An exception raised after the signal is taken as its consequence: a child process may have received the signal too.
    Outside the main thread, or where a program has its own handler, nothing changes.
    """
    handler = signal.getsignal(signal.SIGINT)
    if isinstance(handler, DeferredInterrupt):  # a step within a step
        yield handler
        handler.check()
        return
    deferred = DeferredInterrupt()
    installed = (
        handler is signal.default_int_handler
        and threading.current_thread() is threading.main_thread()
    )
    if installed:
        signal.signal(signal.SIGINT, deferred)
    try:
        yield deferred
    except Exception:
        deferred.check()
        raise
    finally:
        if installed:
            signal.signal(signal.SIGINT, handler)
    deferred.check()
