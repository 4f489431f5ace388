"""The process in which a decoder of Python runs: takes stacks, answers with plain arrays in files.

Started by `fringebench.gate.decoders`. A decoder can end, fork or damage this process; the gate, its cases and their truth are
in another. Each answer is a file ``<part>.npy`` for heights, mask and sigma, announced by a line of JSON.
"""

import importlib
import json
import os
import pickle
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

PARTS = ("heights", "mask", "sigma")
# What a fork of this process ends with when a decoder returns in it too.
FORKED = 77


def main(spec: str, folder: str, requests: int, answers: int) -> None:
    """Serve one decoder until the requests end."""
    home, place = os.getpid(), Path(folder)

    def say(**tree: Any) -> None:
        if os.getpid() != home:
            os._exit(FORKED)
        os.write(answers, (json.dumps(tree) + "\n").encode())

    try:
        function = imported(spec)
    except BaseException as error:
        say(error=f"decoder '{spec}' cannot be imported: {error_in_words(error)}")
        return
    say(ready=True)
    with os.fdopen(requests, "rb") as queue:
        while queue.readline():
            with (place / "stack").open("rb") as file:
                stack = pickle.load(file)
            try:
                say(**_answered(function, stack, place))
            except BaseException as error:
                traceback.print_exc()
                say(error=f"the decoder {error_in_words(error)}", empty=_is_empty(error))


def imported(spec: str) -> Callable[[Any], Any]:
    """The callable that ``package.module:name`` names."""
    module_name, attribute = spec.split(":")
    found: Any = importlib.import_module(module_name)
    for name in attribute.split("."):
        found = getattr(found, name)
    if not callable(found):
        raise TypeError(f"it is a {type(found).__name__}: it must be callable")
    return found  # type: ignore[no-any-return]


def _answered(function: Callable[[Any], Any], stack: Any, place: Path) -> dict[str, Any]:
    parts = parts_of(function(stack))
    for name, part in zip(PARTS, parts, strict=False):
        np.save(place / f"{name}.npy", part, allow_pickle=False)
    return {"parts": len(parts)}


def parts_of(given: Any) -> list["np.ndarray[Any, np.dtype[Any]]"]:
    """Heights, and mask and sigma if given, as plain arrays; raises `TypeError` for anything else."""
    if all(hasattr(given, name) for name in ("height_mm", "valid", "sigma_mm")):
        # Of all causes, where a decoder predicts more than the sensor's noise.
        sigma = getattr(given, "total_sigma_mm", given.sigma_mm)
        given = (given.height_mm, given.valid, sigma)
    parts = given if isinstance(given, tuple) else (given,)
    if not 1 <= len(parts) <= len(PARTS):
        raise TypeError(
            f"returned {len(parts)} things: expected heights, or heights and mask, or these and sigma"
        )
    arrays = []
    for name, part in zip(PARTS, parts, strict=False):
        if isinstance(part, np.ma.MaskedArray):
            raise TypeError(
                f"returned {name} as a masked array: return a plain one, numpy.ma.filled(..., numpy.nan)"
            )
        array = np.asarray(part)
        if array.dtype.kind not in "fbiu":
            raise TypeError(
                f"returned {name} as {array.dtype} of shape {array.shape}: expected numbers"
            )
        arrays.append(array)
    return arrays


def error_in_words(error: BaseException) -> str:
    """What went wrong."""
    if isinstance(error, SystemExit):
        return f"called sys.exit({error.code!r:.400})"
    if isinstance(error, TypeError) and str(error).startswith("returned "):
        return str(error)
    try:
        said = str(error)
    except Exception:
        said = "an error whose text cannot be made"
    return f"raised {type(error).__name__}: {said[:400]}"


def _is_empty(error: BaseException) -> bool:
    """Whether a decoder says that nothing can be decoded, which is an answer."""
    from scenes.support.errors import DecodeError

    return isinstance(error, DecodeError)
