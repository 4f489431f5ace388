"""One-part OpenEXR files with named channels and a self-describing header.

Layout shared by all of the project's files: scanlines, one channel per image, the header's string attribute
``fringebench`` a JSON object with at least ``format`` and ``version``. See docs/files.md.
"""

import io
import json
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenEXR
from numpy.typing import DTypeLike, NDArray
from pydantic import TypeAdapter

from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError
from scenes.support.memory import room_for
from scenes.support.paths import is_file, missing
from scenes.support.safe_parse import parse_json

VERSION = 1
ATTRIBUTE = "fringebench"
# Bytes of a half: the header does not say a channel's type.
SMALLEST_SAMPLE = 2

# Two threads that redirect the process's stderr at once would leave it redirected.
_ONE_THREAD = threading.Lock()

Channels = Mapping[str, NDArray[Any]]
Identity = Mapping[str, str]
"""Part of a scene -> digest of what the truth depends on (see `scenes.scene_identity`); empty: not known."""


def write(
    path: str | Path,
    kind: str,
    channels: Channels,
    meta: Mapping[str, Any],
    standard: Mapping[str, Any] | None = None,
) -> None:
    """Write an EXR file as a whole; `kind` is the format's name, which `read` checks.

    Channels are (row, col) of float16, float32 or uint32, all of one size; `meta` is JSON-serialisable; `standard`
    holds OpenEXR's own attributes such as ``expTime``, or another ``compression``. On `FileError` the previous file
    stays.
    """
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    shapes = {plane.shape for plane in planes.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
        raise FileError(
            f"cannot write '{path}': channels have shapes {sorted(shapes)}; an EXR file holds images (row, col) of "
            "one size, at least one pixel each"
        )
    with replacing(path) as temporary, library() as said:
        try:
            with _named(temporary, "wb") as name:
                OpenEXR.File(new_header(kind, meta, standard), planes).write(name)
        except (RuntimeError, ValueError, TypeError) as error:
            raise FileError(f"cannot write '{path}': {first_line(said, error)}") from error


def new_header(
    kind: str, meta: Mapping[str, Any], standard: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Header of a file of that kind."""
    return {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "software": "fringebench",
        ATTRIBUTE: json.dumps({"format": kind, "version": VERSION, **meta}, default=_plain),
        **(standard or {}),
    }


def _plain(value: Any) -> Any:
    """NumPy's numbers and arrays, common in users' scripts, in JSON's types."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON serializable")


def read(path: str | Path, kind: str) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Channels and meta of a file written by `write` with that kind.

    Raises `FileError` when the file is missing, truncated, not OpenEXR, not this project's, or of another kind or
    version.
    """
    source = Path(path)
    if not is_file(source):
        raise FileError(f"'{source}' {missing(source)}: give the path of a {kind} EXR file")
    channels, found = load(source)
    meta = expected(found, source, kind)
    shapes = {plane.shape for plane in channels.values()}
    if len(shapes) != 1 or len(next(iter(shapes))) != 2:
        raise FileError(f"'{source}' is damaged: its channels have shapes {sorted(shapes)}")
    return channels, meta


def expected(meta: dict[str, Any] | None, source: Path, kind: str) -> dict[str, Any]:
    """The meta of a file, if it is of that kind and this version; raises `FileError` if not."""
    if meta is None:
        raise FileError(
            f"'{source}' is an OpenEXR file but not one of fringebench's: expected a {kind} file"
        )
    if meta.get("format") != kind:
        raise FileError(
            f"'{source}' is a {meta.get('format')} file where a {kind} file is expected"
        )
    if meta.get("version") != VERSION:
        raise FileError(
            f"'{source}' has format version {meta.get('version')}, this program reads {VERSION}: "
            "write it again with this version, or read it with the one that wrote it"
        )
    return meta


def kind_of(path: str | Path) -> str:
    """Which of the project's formats a file is; raises `FileError` as `read` does."""
    source = Path(path)
    if not is_file(source):
        raise FileError(f"'{source}' {missing(source)}: give the path of an EXR file")
    _, meta = load(source, header_only=True)
    if meta is None:
        raise FileError(f"'{source}' is an OpenEXR file but not one of fringebench's")
    return str(meta.get("format"))


def load(
    source: Path, header_only: bool = False
) -> tuple[dict[str, NDArray[Any]], dict[str, Any] | None]:
    """Channels of any OpenEXR file, and its meta if it is one of this project's. Raises `FileError` if it is no EXR."""
    header, planes = _read(source, header_only=True)
    if not header_only:
        with room_for(
            _claimed_bytes(header),
            f"'{source}', by what its header says,",
            "read it on a larger machine; if it should be small, it is damaged",
        ):
            header, planes = _read(source, header_only=False)
    return planes, meta_of(header, source)


def meta_of(header: Mapping[str, Any], source: Path) -> dict[str, Any] | None:
    """What the project wrote into a file's header; None in others' files. Raises `FileError` if it is damaged."""
    try:
        text = header.get(ATTRIBUTE)
        meta = parse_json(text) if isinstance(text, str) else None
    except ValueError as error:
        raise FileError(f"'{source}': its fringebench header is damaged: {error}") from error
    if meta is not None and not isinstance(meta, dict):
        raise FileError(f"'{source}': its fringebench header is no JSON object")
    return meta


def identity_of(meta: Mapping[str, Any]) -> Identity:
    """The identity in a file's header; empty in files before version 0.3. `ValueError` for anything else."""
    return TypeAdapter(dict[str, str]).validate_python(meta.get("identity", {}))


def whole(plane: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """A channel as integers of that type; `ValueError` if it holds other numbers."""
    with np.errstate(invalid="ignore"):
        numbers = plane.astype(dtype)
    if not np.array_equal(numbers, plane):
        raise ValueError(f"a channel of whole numbers holds some that are no {np.dtype(dtype)}")
    return numbers


def opened(
    source: Any, named: Path, header_only: bool = False
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Header and channels of a file, given by its path or open; `named` is for the message.

    Raises `FileError` if it is no whole OpenEXR file.
    """
    with library() as said:
        try:
            file = OpenEXR.File(source, separate_channels=True, header_only=header_only)
            channels = {} if header_only else file.channels()
            return file.header(), {key: channel.pixels for key, channel in channels.items()}
        except (RuntimeError, ValueError, TypeError, OSError) as error:
            # The library's name for a file that was passed open, or in parts.
            cause = first_line(said, error).replace("<python_buffer>", str(named))
            raise FileError(
                f"'{named}' is truncated, damaged or no OpenEXR file: {cause}"
            ) from error


def _read(source: Path, header_only: bool) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    try:
        with _named(source, "rb") as name:
            return opened(name, source, header_only)
    except OSError as error:
        raise FileError(f"cannot read '{source}': {error.strerror or error}") from error


@contextmanager
def _named(path: Path, mode: Literal["rb", "wb"]) -> Iterator[Any]:
    """The file for the library: its name, or an open file where the name is no UTF-8, which the library refuses."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        with path.open(mode) as stream:
            yield stream
    else:
        yield str(path)


def _claimed_bytes(header: Mapping[str, Any]) -> int:
    """Memory that the image takes if the header is right; 0 if it does not say."""
    try:
        low, high = header["dataWindow"]
        width, height = (max(int(b) - int(a) + 1, 0) for a, b in zip(low, high, strict=True))
        return width * height * len(header["channels"]) * SMALLEST_SAMPLE
    except (KeyError, TypeError, ValueError):
        return 0


@contextmanager
def library() -> Iterator[Any]:
    """The OpenEXR library for one of our threads, with its worker threads on and its output captured.

    It prints errors to the process's stderr and warnings to `sys.stdout`, where they would corrupt JSON output; errors are
    reported once, by us. Output of other threads is passed on. Workers end with the block: in a forked child they would be
    missing, and its first read or write would wait for them forever.
    """
    with _ONE_THREAD, tempfile.TemporaryFile() as said:
        if sys.stderr:
            sys.stderr.flush()
        saved = os.dup(2)
        os.dup2(said.fileno(), 2)
        OpenEXR.set_global_thread_count(os.cpu_count() or 1)
        printed = io.StringIO()
        try:
            with redirect_stdout(printed):
                yield said
        finally:
            OpenEXR.set_global_thread_count(0)
            os.dup2(saved, 2)
            os.close(saved)
        said.seek(0)
        os.write(2, said.read())
        if text := printed.getvalue():  # printing nothing would still touch a full standard output
            print(text, end="")


def first_line(said: Any, error: Exception) -> str:
    said.seek(0)
    lines: list[str] = said.read().decode(errors="replace").strip().splitlines()
    return lines[0] if lines else str(error)
