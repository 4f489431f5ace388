"""Anybody's decoder as a function from `Stack` to heights: a Python callable, or a program that reads and writes files.

What is named by a string runs in processes of its own, under supervision: it can end, hang, fork or print without limit, and
the gate still gives its verdict.
"""

import json
import os
import pickle
import re
import shlex
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fringebench.exchange.capture_export import export
from fringebench.gate.answers import Answer, checked, nothing, read_npy, read_output
from fringebench.gate.supervised import Supervised
from fringebench.gate.worker import PARTS, error_in_words, parts_of
from scenes import Stack
from scenes.support.errors import DecodeError, OutsideDecoderError

CALLABLE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
TIMEOUT_S = 600.0
# The worker has the paths of this process, so that a test's decoder is found as the test found it.
BOOT = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop(1)); "
    "from fringebench.gate.worker import main; main(sys.argv[1], sys.argv[2], *map(int, sys.argv[3:]))"
)


class Decoder:
    """A decoder to be called with stacks; close it, or use it as a context manager."""

    def __call__(self, stack: Stack) -> Answer:
        """The decoder's answer; raises `OutsideDecoderError` where it gives none."""
        raise NotImplementedError

    def close(self) -> None:
        """End what runs."""

    def __enter__(self) -> "Decoder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def resolve(spec: str | Callable[[Stack], Any], timeout_s: float = TIMEOUT_S) -> Decoder:
    """A decoder from ``package.module:callable``, a command, or a callable itself; it has `timeout_s` for a stack.

    A callable takes a `Stack` and returns a `Reconstruction`; heights in mm (row, col), NaN where rejected; or a tuple
    of heights, a boolean mask, and perhaps sigma in mm. One that raises `DecodeError` has found nothing valid. Named by
    a string it runs in a process of its own; a callable object runs in this one.

    A command is run without a shell, with ``{stack}`` replaced by the path of a stack EXR or ``{manifest}`` by that of
    a manifest among numbered PNGs (see `export`), and ``{output}`` by a path without suffix: it must write the heights
    there as EXR, TIFF (float) or NPY, with the suffix ``.exr``, ``.tif`` or ``.npy`` or none.
    """
    if not isinstance(spec, str):
        return _InThisProcess(spec)
    if CALLABLE.fullmatch(spec):
        return _InWorker(spec, timeout_s)
    if "{output}" in spec and ("{stack}" in spec or "{manifest}" in spec):
        return _Command(spec, timeout_s)
    raise OutsideDecoderError(
        f"decoder '{spec}' is neither package.module:callable nor a command with {{stack}} (or {{manifest}}) and "
        "{output}, such as 'my-decoder {manifest} --out {output}.npy'"
    )


class _InThisProcess(Decoder):
    """A callable object."""

    def __init__(self, function: Callable[[Stack], Any]) -> None:
        self._function = function

    def __call__(self, stack: Stack) -> Answer:
        shape = stack.frames.shape[2:]
        try:
            return checked(parts_of(self._function(stack)), shape)
        except DecodeError:
            return nothing(shape)
        except (OutsideDecoderError, KeyboardInterrupt):
            raise
        except BaseException as error:  # A decoder under test may raise anything.
            raise OutsideDecoderError(f"the decoder {error_in_words(error)}") from error


class _InWorker(Decoder):
    """A callable named by module, in a worker process that lasts for all stacks."""

    def __init__(self, spec: str, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._spec = spec
        self._folder = tempfile.TemporaryDirectory(
            prefix="fringebench-", ignore_cleanup_errors=True
        )
        read_requests, self._requests = os.pipe()
        read_answers, write_answers = os.pipe()
        # As with pytest and python -m, a module in the working folder can be named.
        paths = [str(Path.cwd()), *(path for path in sys.path if path)]
        words = [sys.executable, "-c", BOOT, json.dumps(paths), spec, self._folder.name]
        self._program = Supervised(
            [*words, str(read_requests), str(write_answers)], (read_requests, write_answers)
        )
        self._program.name = spec
        os.close(read_requests)
        os.close(write_answers)
        self._answers = os.fdopen(read_answers, "rb", buffering=0)
        self._ready = False

    def __call__(self, stack: Stack) -> Answer:
        if not self._ready:
            self._reply("its import")
            self._ready = True
        shape = stack.frames.shape[2:]
        place = Path(self._folder.name)
        try:
            # A new file: what a decoder left in its place may be a pipe without a reader.
            (place / "stack").unlink(missing_ok=True)
            with (place / "stack").open("xb") as file:
                pickle.dump(stack, file, pickle.HIGHEST_PROTOCOL)
        except OSError as error:
            raise OutsideDecoderError(
                f"the decoder '{self._spec}' damaged the folder it works in: {error}"
            ) from error
        self._program.new_turn()
        # Where it has ended, reading its answer says how.
        with suppress(OSError):
            os.write(self._requests, b"decode\n")
        said = self._reply("the stack")
        if said.get("empty"):
            return nothing(shape)
        try:
            count = int(said["parts"])
            return checked(
                [read_npy(place / f"{name}.npy", shape) for name in PARTS[:count]], shape
            )
        except (KeyError, TypeError, ValueError, OverflowError, OSError) as error:
            raise OutsideDecoderError(
                f"the decoder '{self._spec}' damaged its own answer: {error}"
            ) from error

    def _reply(self, what: str) -> dict[str, Any]:
        """What the worker says; raises `OutsideDecoderError` for an error, and where it ended without a word."""
        line = self._program.read_line(self._answers, self._timeout_s)
        if line is None:
            how = self._program.ending(self._program.exit_status())
            raise OutsideDecoderError(
                f"decoder '{self._spec}': its process {how} during {what}, without an answer; "
                f"its last words: {self._program.last_line}"
            )
        try:
            said: Any = json.loads(line)
        except (ValueError, RecursionError):
            said = None
        if not isinstance(said, dict):
            raise OutsideDecoderError(f"decoder '{self._spec}' wrote into the gate's own pipe")
        if "error" in said and not said.get("empty"):
            raise OutsideDecoderError(str(said["error"]))
        return said

    def close(self) -> None:
        """End the worker, and all that it started."""
        os.close(self._requests)
        self._program.__exit__(None, None, None)
        self._answers.close()
        self._folder.cleanup()


class _Command(Decoder):
    """A program, started for each stack."""

    def __init__(self, command: str, timeout_s: float) -> None:
        self._command, self._timeout_s = command, timeout_s

    def __call__(self, stack: Stack) -> Answer:
        with tempfile.TemporaryDirectory(prefix="fringebench-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            places = {"{output}": str(folder / "heights")}
            if "{stack}" in self._command:
                places["{stack}"] = str(folder / "stack.exr")
                stack.write(places["{stack}"])
            if "{manifest}" in self._command:
                places["{manifest}"] = str(export(stack, folder / "frames"))
            words = shlex.split(self._command)
            for mark, path in places.items():
                words = [word.replace(mark, path) for word in words]
            with Supervised(words) as program:
                if status := program.wait(self._timeout_s):
                    how = program.ending(status)
                    raise OutsideDecoderError(f"'{words[0]}' {how}: {program.last_line}")
            return read_output(folder, "heights", stack.frames.shape[2:], words[0])
