"""Anybody's decoder as a function from `Stack` to heights: a Python callable, or a program that reads and writes files."""

import importlib
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from decode import Reconstruction
from fringebench.export import export
from scenes import Stack, exr
from scenes.errors import DecodeError, DecoderError, FileError

Floats = NDArray[np.float64]

CALLABLE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
# Names that programs give a height channel, best first.
HEIGHT_CHANNELS = ("height_mm", "height", "Z", "z", "Y", "R")
SUFFIXES = (".exr", ".tif", ".tiff", ".npy")
MAGIC = {b"\x76\x2f\x31\x01": ".exr", b"II*\0": ".tif", b"MM\0*": ".tif", b"\x93NUMPY": ".npy"}
TIMEOUT_S = 600.0


@dataclass(frozen=True)
class Answer:
    """What a decoder says of a stack, (row, col)."""

    height_mm: Floats
    """NaN where not valid."""
    sigma_mm: Floats | None
    """Its own standard deviations, if it claims any."""

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where it gives a height."""
        return np.isfinite(self.height_mm)


Decoder = Callable[[Stack], Answer]


def resolve(spec: str | Callable[[Stack], Any], timeout_s: float = TIMEOUT_S) -> Decoder:
    """A decoder from ``package.module:callable``, from a command, or from a callable itself.

    A callable takes a `Stack` and returns a `Reconstruction`; heights in mm (row, col), NaN where rejected; or a tuple of
    heights, a boolean mask, and perhaps sigma in mm. One that raises `DecodeError` has found nothing valid.

    A command is run without a shell, with ``{stack}`` replaced by a stack EXR's path or ``{manifest}`` by that of a manifest
    among numbered PNGs (see `export`), and ``{output}`` by a path without suffix: it must write the heights there as
    EXR, TIFF (float) or NPY, with the suffix ``.exr``, ``.tif`` or ``.npy`` or none.

    Raises `DecoderError` for a spec that is neither or cannot be found; the decoder itself, for an answer that is no height
    map, a failed command, or whatever the callable raises.
    """
    if not isinstance(spec, str):
        return lambda stack: _called(spec, stack)
    if CALLABLE.fullmatch(spec):
        function = _imported(spec)
        return lambda stack: _called(function, stack)
    if "{output}" in spec and ("{stack}" in spec or "{manifest}" in spec):
        return lambda stack: _run(spec, stack, timeout_s)
    raise DecoderError(
        f"decoder '{spec}' is neither package.module:callable nor a command with {{stack}} (or {{manifest}}) and "
        "{output}, such as 'my-decoder {manifest} --out {output}.npy'"
    )


def _imported(spec: str) -> Callable[[Stack], Any]:
    module_name, attribute = spec.split(":")
    # As with pytest and python -m, what lies in the working folder can be named.
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        found: Any = importlib.import_module(module_name)
        for name in attribute.split("."):
            found = getattr(found, name)
    except Exception as error:  # somebody else's module may raise anything
        raise DecoderError(
            f"decoder '{spec}' cannot be imported: {type(error).__name__}: {error}"
        ) from error
    if not callable(found):
        raise DecoderError(f"decoder '{spec}' is a {type(found).__name__}: it must be callable")
    return found  # type: ignore[no-any-return]


def _called(function: Callable[[Stack], Any], stack: Stack) -> Answer:
    shape = stack.frames.shape[2:]
    try:
        return _answer(function(stack), shape)
    except DecodeError:
        return Answer(np.full(shape, np.nan), None)
    except DecoderError:
        raise
    except Exception as error:  # a decoder under test may raise anything
        raise DecoderError(f"the decoder raised {type(error).__name__}: {error}") from error


def _run(command: str, stack: Stack, timeout_s: float) -> Answer:
    with tempfile.TemporaryDirectory(prefix="fringebench-") as name:
        folder = Path(name)
        output = folder / "heights"
        places = {"{output}": str(output)}
        if "{stack}" in command:
            places["{stack}"] = str(folder / "stack.exr")
            stack.write(places["{stack}"])
        if "{manifest}" in command:
            places["{manifest}"] = str(export(stack, folder / "frames"))
        words = shlex.split(command)
        for mark, path in places.items():
            words = [word.replace(mark, path) for word in words]
        try:
            done = subprocess.run(words, capture_output=True, timeout=timeout_s, check=False)
        except subprocess.TimeoutExpired:
            raise DecoderError(
                f"'{words[0]}' took longer than {timeout_s:g} s: give it more with --timeout"
            ) from None
        except OSError as error:
            raise DecoderError(
                f"'{words[0]}' cannot be run: {error.strerror or error}; check the command's path"
            ) from error
        if done.returncode:
            said = (done.stderr or done.stdout).decode(errors="replace").strip().splitlines()
            raise DecoderError(
                f"'{words[0]}' ended with status {done.returncode}: {said[-1] if said else 'it said nothing'}"
            )
        if output.is_file():
            output = output.rename(output.with_suffix(_suffix(output)))
        written = [path for path in sorted(folder.glob("heights*")) if path.suffix in SUFFIXES]
        if len(written) != 1:
            raise DecoderError(
                f"'{words[0]}' wrote {len(written)} of {{output}}{', {output}'.join(SUFFIXES)}: it must write one"
            )
        return _answer(read_heights(written[0]), stack.frames.shape[2:])


def _suffix(path: Path) -> str:
    """The ending that a file's first bytes ask for; none where they are no image's."""
    with path.open("rb") as file:
        start = file.read(max(map(len, MAGIC)))
    return next((suffix for magic, suffix in MAGIC.items() if start.startswith(magic)), "")


def read_heights(path: Path) -> Any:
    """Heights, and mask and sigma where the file has them, from EXR, TIFF or NPY. Raises `DecoderError`."""
    try:
        if path.suffix == ".npy":
            planes = np.load(path, allow_pickle=False)
            return tuple(planes) if planes.ndim == 3 else planes
        if path.suffix == ".exr":
            return _from_exr(path)
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    except (FileError, ValueError, OSError, cv2.error) as error:
        raise DecoderError(f"the decoder's file '{path.name}' cannot be read: {error}") from error
    if image is None:
        raise DecoderError(f"the decoder's file '{path.name}' is no readable TIFF")
    return image


def _from_exr(path: Path) -> Any:
    channels, meta = exr.load(path)
    if meta is not None and meta.get("format") == "reconstruction":
        return Reconstruction.read(path)
    name = next((n for n in HEIGHT_CHANNELS if n in channels), None)
    if name is None and len(channels) == 1:
        name = next(iter(channels))
    if name is None:
        raise DecoderError(
            f"the decoder's EXR has channels {sorted(channels)}: name the heights 'height_mm' (and 'valid', 'sigma_mm')"
        )
    height = channels[name]
    valid = channels.get("valid", np.ones(height.shape)) > 0.5
    return (height, valid, channels["sigma_mm"]) if "sigma_mm" in channels else (height, valid)


def _answer(given: Any, shape: tuple[int, ...]) -> Answer:
    """Whatever a decoder returned, checked."""
    if isinstance(given, Reconstruction):
        given = (given.height_mm, given.valid, given.sigma_mm)
    parts = given if isinstance(given, tuple) else (given,)
    if not 1 <= len(parts) <= 3:
        raise DecoderError(
            f"the decoder returned {len(parts)} things: expected heights, or heights and mask, or with sigma"
        )
    arrays = [np.asarray(part) for part in parts]
    for array, name in zip(arrays, ("heights", "mask", "sigma"), strict=False):
        if array.shape != shape or array.dtype.kind not in "fbiu":
            raise DecoderError(
                f"the decoder's {name} are {array.dtype} of shape {array.shape}: expected numbers of the frames' shape "
                f"{shape} (row, col)"
            )
    if arrays[0].dtype.kind != "f":
        raise DecoderError(
            f"the decoder's heights are {arrays[0].dtype}: give floating point millimetres, NaN where there is none"
        )
    height = arrays[0].astype(np.float64)
    height[~np.isfinite(height)] = np.nan
    if len(arrays) > 1:
        height[~arrays[1].astype(bool)] = np.nan
    sigma = None
    if len(arrays) > 2 and np.isfinite(arrays[2]).any():
        sigma = arrays[2].astype(np.float64)
    return Answer(height, sigma)
