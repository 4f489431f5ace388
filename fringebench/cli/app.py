"""The command line. Exit status: 0 done, 1 a gate failed, 2 bad input or use, 70 an error in fringebench itself."""

import io
import os
import sys
import traceback
import warnings
from contextlib import suppress
from itertools import pairwise
from typing import Annotated, Any

import typer
from typer import rich_utils
from typer.core import TyperGroup

from fringebench.cli.commands import (
    captures,
    datasets,
    gate,
    hdr,
    inspection,
    method_grid,
    rigs,
    runs,
    stages,
    viewing,
)
from fringebench.cli.hints import options_of, with_options

# Status a shell expects of a command that Ctrl-C ended, and of one whose reader closed the pipe (| head).
INTERRUPTED, BROKEN_PIPE = 130, 141
# "Internal software error" (sysexits.h): neither a gate's verdict nor the user's mistake.
INTERNAL_ERROR = 70


class _Commands(TyperGroup):
    """Commands with statuses of ours: typer would end an interrupted command with 1, the status of a failed gate."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            kept = f"; {stopped}" if str(stopped) else "; no file is left half written"
            sys.stderr.write(f"fringebench: interrupted{kept}\n")
            raise typer.Exit(INTERRUPTED) from None
        except BrokenPipeError:
            _discard_output()
            raise typer.Exit(BROKEN_PIPE) from None
        except Exception as error:
            command = self.get_command(ctx, ctx.invoked_subcommand or "")
            if command is None or not error.args or not _is_ours(error):
                raise
            error.args = (with_options(str(error), options_of(command.params)),)
            raise


app = typer.Typer(
    name="fringebench",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        sys.stdout.write(f"fringebench {version('fringebench')}\n")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Render structured-light scenes, decode them, and score the heights against the rendered mesh."""


for part in (runs, stages, hdr, method_grid, gate, datasets, inspection, captures, rigs, viewing):
    app.add_typer(part.app)


def main() -> None:
    """Run the command line; an error that a user can fix is one message and status 2."""
    warnings.showwarning = _warn
    if os.environ.get("NO_COLOR"):
        # Rich would still print bold and dim text in typer's help.
        rich_utils.COLOR_SYSTEM = None
    sys.exit(_status())


def _status() -> Any:
    """Run a command; return its exit status once all its output is written."""
    # A program that was started without standard streams (`>&-`) has None here.
    sys.stdout = sys.stdout or io.StringIO()
    sys.stderr = sys.stderr or io.StringIO()
    for stream in (sys.stdout, sys.stderr):
        # A terminal that cannot show µ, or a file name that is not UTF-8, must not lose the answer.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        status: Any = 0
        try:
            _require_output()
            app()
        except SystemExit as leaving:
            status = leaving.code
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        sys.stderr.write("fringebench: interrupted\n")
        return INTERRUPTED
    except MemoryError:
        sys.stderr.write(
            "fringebench: out of memory; use fewer pixels, frames or exposures, or a larger machine\n"
        )
    except BrokenPipeError:
        _discard_output()
        return status or BROKEN_PIPE
    except OSError as error:
        what = (
            "standard output cannot be written"
            if error.filename is None
            else f"'{error.filename}' cannot be written or read"
        )
        sys.stderr.write(f"fringebench: {what}: {error.strerror or error}\n")
        _discard_output()
    except Exception as error:
        if _is_ours(error):
            sys.stderr.write(f"fringebench: {error}\n")
            return 2
        traceback.print_exc()
        sys.stderr.write(
            "fringebench: this is an error in fringebench, not in your input: please report it\n"
        )
        return INTERNAL_ERROR
    return 2


def _require_output() -> None:
    """Refuse an output of no characters: as a path it is the current folder, and mostly a shell's variable that was not set."""
    words = sys.argv[1:]
    if "--output=" in words or any(
        option in ("-o", "--output") and not value for option, value in pairwise(words)
    ):
        sys.stderr.write("fringebench: the output (-o) is empty: give a file or a folder\n")
        raise SystemExit(2)


def _is_ours(error: Exception) -> bool:
    """Whether it is an error that a user can fix; without loading the rooms, for which `--help` must not wait."""
    errors = sys.modules.get("scenes.support.errors")
    return errors is not None and isinstance(error, errors.FringebenchError)


def _discard_output() -> None:
    """Send unwritten output to the null device: Python would complain about it at exit."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _warn(message: Warning | str, category: type[Warning], *where: Any, **line: Any) -> None:
    """Show our warnings in one line, as errors are; others as Python shows them."""
    from scenes.support.errors import FringebenchWarning

    text = (
        f"fringebench: {message}\n"
        if issubclass(category, FringebenchWarning)
        else warnings.formatwarning(message, category, *where[:2])
    )
    sys.stderr.write(text)


if __name__ == "__main__":
    main()
