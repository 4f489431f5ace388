"""What a long step is doing and for how much longer: bars on a terminal, lines where asked for, else silence."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

from fringebench.interrupts import patient

# Seconds between plain lines.
PLAIN_S = 3.0

Show = Callable[[float, str], None]
"""Shows the share of a step that is done, from 0 to 1, and words about it."""


class Report:
    """Called with the share of a step that is done, from 0 to 1."""

    def __init__(self, show: Show, check: Callable[[], None]) -> None:
        self._show, self._check = show, check
        self._detail = ""

    def __call__(self, share: float) -> None:
        self._show(share, self._detail)
        self._check()

    def detail(self, text: str) -> None:
        """Words that stand beside the share from the next call on: which part is being done."""
        self._detail = text


class Mode(StrEnum):
    """How progress is shown."""

    AUTO = "auto"
    """Bars on a terminal, nothing when piped."""
    PLAIN = "plain"
    """Lines, also when piped."""
    NONE = "none"


class Steps:
    """Shows each long step while it runs.

    >>> with Steps().step("add") as done:
    ...     total = 0
    ...     for i in range(10):
    ...         total += i
    ...         done((i + 1) / 10)
    """

    def __init__(self, console: Console | None = None, mode: Mode = Mode.AUTO) -> None:
        self._console, self._mode = console, mode
        self._bars: Progress | None = None
        self.seconds: dict[str, float] = {}
        """What each step that ended has taken."""

    @contextmanager
    def step(self, name: str) -> Iterator[Report]:
        """Show `name` while the block runs; the block may report how far it is.

        Ctrl-C waits for the next report or the block's end (`fringebench.interrupts`).
        """
        start = time.perf_counter()
        with patient() as waiting, self._shown(name) as show:
            yield Report(show, waiting.check)
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    @contextmanager
    def _shown(self, name: str) -> Iterator[Show]:
        if self._console is None or self._mode is Mode.NONE:
            yield _silent
        elif self._mode is Mode.PLAIN:
            with _lines(self._console, name) as show:
                yield show
        elif self._console.is_terminal:
            with self._bar(self._console, name) as show:
                yield show
        else:
            yield _silent

    @contextmanager
    def _bar(self, console: Console, name: str) -> Iterator[Show]:
        outermost = self._bars is None
        if self._bars is None:
            # One display for steps within steps: a terminal has room for one.
            self._bars = bars(console)
        shown = self._bars
        if outermost:
            shown.start()
        task = shown.add_task(name, total=None)

        def show(share: float, detail: str) -> None:
            words = f"{name}: {detail}" if detail else name
            shown.update(task, description=words, completed=share, total=1.0)

        try:
            yield show
        finally:
            shown.remove_task(task)
            if outermost:
                shown.stop()
                self._bars = None


def bars(console: Console) -> Progress:
    """The look of every bar; gone when it is done."""
    return Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


class Lines:
    """Progress of one step as plain lines, every few seconds."""

    def __init__(self, console: Console, name: str, resumes: bool = False) -> None:
        self._console, self._name = console, name
        self._start = self._last = time.monotonic()
        # What an interrupted run had done before is no measure of this one's speed.
        self._first = None if resumes else 0.0

    def report(self, share: float, detail: str = "") -> None:
        """How far it is."""
        now = time.monotonic()
        if self._first is None:
            self._first = share
        if now - self._last < PLAIN_S or share <= self._first:
            return
        self._last = now
        left_s = (now - self._start) * (1.0 - share) / (share - self._first)
        self.say(
            ", ".join(filter(None, (f"{100 * share:.0f} %", detail, f"about {left_s:.0f} s left")))
        )

    def say(self, text: str) -> None:
        """Print a line."""
        self._console.print(f"{self._name}: {text}", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def _lines(console: Console, name: str) -> Iterator[Show]:
    lines = Lines(console, name)
    start = time.monotonic()
    lines.say("started")
    yield lines.report
    lines.say(f"done in {time.monotonic() - start:.1f} s")


def _silent(share: float, detail: str) -> None:
    pass
