"""Progress of long steps: bars on a terminal, plain lines when piped, nothing where it is switched off."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    SpinnerColumn,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from fringebench.interrupts import deferred_interrupt

# Seconds between plain lines, and from the first step to the first line when the output is piped and lines were not
# requested.
PLAIN_S = 3.0
PIPED_S = 30.0

Show = Callable[[float, str], None]
"""Shows the share of a step that is done, from 0 to 1, and a text about it."""


class StepProgress:
    """Called with the share of a step that is done, from 0 to 1."""

    def __init__(self, show: Show, check: Callable[[], None]) -> None:
        self._show, self._check = show, check
        self._detail = ""

    def __call__(self, share: float) -> None:
        self._show(share, self._detail)
        self._check()

    def detail(self, text: str) -> None:
        """Text shown next to the share from the next call on: which part is being done."""
        self._detail = text


class Mode(StrEnum):
    """How progress is shown."""

    AUTO = "auto"
    """Bars on a terminal; when piped, lines for work that takes longer than half a minute."""
    PLAIN = "plain"
    """Lines every few seconds."""
    NONE = "none"


class Steps:
    """Shows each long step while it runs, and measures its time; shows nothing without a console.

    >>> steps = Steps()
    >>> with steps.step("add") as done:
    ...     for i in range(10):
    ...         done((i + 1) / 10)
    >>> list(steps.seconds)
    ['add']
    """

    def __init__(self, console: Console | None = None, mode: Mode = Mode.AUTO) -> None:
        self._console, self._mode = console, mode
        self._bars: Progress | None = None
        self._pace: _Pace | None = None
        self.seconds: dict[str, float] = {}
        """Time that each finished step took."""

    @contextmanager
    def step(self, name: str) -> Iterator[StepProgress]:
        """Show `name` while the block runs; the block may report its progress.

        Ctrl-C takes effect at the next report or at the end of the block (`fringebench.interrupts`).
        """
        start = time.perf_counter()
        with deferred_interrupt() as interrupt, self.shown(name) as show:
            yield StepProgress(show, interrupt.check)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    @contextmanager
    def shown(self, name: str, resumes: bool = False) -> Iterator[Show]:
        """Show `name` while the block runs, without deferring Ctrl-C.

        With `resumes` the first share reported was done by an earlier run, and says nothing about the speed of this one.
        """
        if self._console is None or self._mode is Mode.NONE:
            yield _silent
        elif self._mode is Mode.AUTO and self._console.is_terminal and self._console.color_system:
            with self._bar(self._console, name, resumes) as show:
                yield show
        else:
            # Many short steps are long work too: without a request, they share the wait for the first line.
            self._pace = self._pace or _Pace(time.monotonic() + PIPED_S)
            with _lines(self._console, name, resumes, self._mode is Mode.PLAIN, self._pace) as show:
                yield show

    @contextmanager
    def _bar(self, console: Console, name: str, resumes: bool) -> Iterator[Show]:
        outermost = self._bars is None
        if self._bars is None:
            # One display for nested steps: a terminal has room for one.
            self._bars = _progress_bars(console)
        shown = self._bars
        if outermost:
            shown.start()
        task = shown.add_task(name, total=None)
        started = not resumes

        def show(share: float, detail: str) -> None:
            nonlocal started
            text = f"{name}: {detail}" if detail else name
            if not started:
                shown.reset(task, total=1.0, completed=share)  # type: ignore[arg-type]
                started = True
            shown.update(task, description=text, completed=share, total=1.0)

        try:
            yield show
        finally:
            shown.remove_task(task)
            if outermost:
                shown.stop()
                self._bars = None


def _progress_bars(console: Console) -> Progress:
    """Bars that disappear when they are done."""
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        # A sample of a data set may take minutes.
        speed_estimate_period=600.0,
    )


@dataclass
class _Pace:
    """When the next plain line is due."""

    due_s: float


class _PlainLines:
    """Progress of one step as plain lines, every few seconds."""

    def __init__(self, console: Console, name: str, resumes: bool, pace: _Pace) -> None:
        self._console, self._name, self._pace = console, name, pace
        self._start = time.monotonic()
        self._first = None if resumes else 0.0

    def report(self, share: float, detail: str = "") -> None:
        """Print the share done and the time left, if a line is due."""
        now = time.monotonic()
        if self._first is None:
            self._first = share
        if now < self._pace.due_s or share <= self._first:
            return
        left_s = (now - self._start) * (1.0 - share) / (share - self._first)
        self.say(
            ", ".join(filter(None, (f"{100 * share:.0f} %", detail, f"about {left_s:.0f} s left")))
        )

    def say(self, text: str) -> None:
        """Print a line; the next report is due some seconds later."""
        self._pace.due_s = time.monotonic() + PLAIN_S
        self._console.print(f"{self._name}: {text}", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def _lines(
    console: Console, name: str, resumes: bool, requested: bool, pace: _Pace
) -> Iterator[Show]:
    """Lines from the start if they were requested, else only once the work takes long."""
    start = time.monotonic()
    lines = _PlainLines(console, name, resumes, _Pace(start + PLAIN_S) if requested else pace)
    if requested or start >= pace.due_s:
        lines.say("started")
    yield lines.report
    if requested:
        lines.say(f"done in {time.monotonic() - start:.1f} s")


def _silent(share: float, detail: str) -> None:
    pass
