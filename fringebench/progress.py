"""Progress on a terminal; silence when piped."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console


class Steps:
    """Names each long step while it runs, on the given console if that is a terminal."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console if console and console.is_terminal else None

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Show `name` while the block runs."""
        if self._console is None:
            yield
            return
        with self._console.status(f"{name} ..."):
            yield
