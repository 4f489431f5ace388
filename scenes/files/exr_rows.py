"""The project's EXR files, read and written in bands of rows, for images larger than memory.

The library's `OpenEXR.File` reads and writes whole files only. But a scan-line file is a header, a table of where its
chunks begin, and the chunks, each with its first row and some rows of pixels (openexr.com, "OpenEXR File Layout"). So the
library encodes each band as a small file whose data window is the band, and the chunks are copied from there; reading goes
the other way. Every byte is the library's, and the file equals the one that it writes at once.

The library also has a reader and writer by scan line, `InputFile` and `OutputFile`. On 40 channels of 1800 x 1600 pixels
(PIZ, half) they took the same processor time (write 1.9 against 1.8 s, read 1.15 against 1.14 s) and similar memory (88 and
150 MB against 152 and 109 MB), and refused the same 31 of 40 damaged files. They are not used because they are deprecated
and, by their own docstrings, will be removed from the library.
"""

import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import IO, Any

import numpy as np
import OpenEXR
from numpy.typing import DTypeLike, NDArray

from scenes.files import exr
from scenes.files.exr import Channels
from scenes.support import mapped
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError
from scenes.support.memory import room_for
from scenes.support.paths import is_file, missing

# Memory of a band: several chunks for each core, at 48 float32 channels and 5472 columns.
BAND_BYTES = 2**28
# Rows of a chunk, by the codec's number in files. Files of other codecs are read as a whole.
CHUNK_ROWS = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32}
# Flags of the version field: tiled, deep, several parts.
OTHER_LAYOUTS = 0x200 | 0x800 | 0x1000


def write(
    path: str | Path,
    kind: str,
    channels: Channels,
    meta: Mapping[str, Any],
    standard: Mapping[str, Any] | None = None,
    dtype: DTypeLike | None = None,
) -> None:
    """Write channels (row, col) of one size in bands, to the same bytes as `exr.write`.

    `dtype` is the stored type, float16, float32 or uint32; None: the channels' own. Raises `FileError` when the file cannot
    be written; the previous file at `path` then stays.
    """
    header = exr.new_header(kind, meta, standard)
    chunk_rows = CHUNK_ROWS[int(header["compression"])]
    rows, columns = next(iter(channels.values())).shape
    header["displayWindow"] = ((0, 0), (columns - 1, rows - 1))
    pixel_bytes = sum(np.dtype(dtype or plane.dtype).itemsize for plane in channels.values())
    begins = np.zeros(-(-rows // chunk_rows), "<u8")
    chunk = window = end = 0
    with replacing(path) as temporary, temporary.open("r+b") as file:
        for band in _bands(rows, columns * pixel_bytes, chunk_rows):
            header["dataWindow"] = ((0, band.start), (columns - 1, band.stop - 1))
            small = _encoded(path, header, channels, band, dtype)
            window, end = _layout(small)
            if not chunk:
                file.write(small.getbuffer()[:end])
                file.write(begins.tobytes())
            count = -(-(band.stop - band.start) // chunk_rows)
            theirs = np.frombuffer(small.getbuffer(), "<u8", count, end)
            start = end + theirs.nbytes
            begins[chunk : chunk + count] = theirs + (file.tell() - start)
            file.write(small.getbuffer()[start:])
            chunk += count
            # Free it before the next one is encoded.
            del small, theirs
            for plane in channels.values():
                mapped.release_pages(plane)
        file.seek(window)
        file.write(struct.pack("<4i", 0, 0, columns - 1, rows - 1))
        file.seek(end)
        file.write(begins.tobytes())


def _bands(rows: int, row_bytes: int, chunk_rows: int) -> Iterator[slice]:
    """All rows, from top to bottom, in bands of whole chunks, a multiple of the number of cores."""
    chunks, cores = max(BAND_BYTES // max(row_bytes * chunk_rows, 1), 1), os.cpu_count() or 1
    step = chunk_rows * (chunks if chunks < cores else chunks - chunks % cores)
    for top in range(0, rows, step):
        yield slice(top, min(top + step, rows))


def _encoded(
    path: str | Path,
    header: Mapping[str, Any],
    channels: Channels,
    band: slice,
    dtype: DTypeLike | None,
) -> BytesIO:
    """A file of those rows only."""
    small = BytesIO()
    planes = {name: np.ascontiguousarray(plane[band], dtype) for name, plane in channels.items()}
    with exr.library() as said:
        try:
            OpenEXR.File(dict(header), planes).write(small)
        except (RuntimeError, ValueError, TypeError) as error:
            raise FileError(f"cannot write '{path}': {exr.first_line(said, error)}") from error
    return small


@dataclass(frozen=True)
class _Layout:
    """Offsets in a scan-line file."""

    file: IO[bytes]
    head: bytes
    """Everything before the table of chunks."""
    origin: tuple[int, int]
    """First column and row of the data window."""
    window: int
    """Offset of the data window in `head`."""
    chunk_rows: int
    chunks: NDArray[np.int64]
    """Offset and length of each chunk in bytes, (chunk, 2)."""

    def small(self, band: slice, columns: int) -> BytesIO:
        """A file of that band only."""
        (x, y), rows = self.origin, self.chunk_rows
        head = bytearray(self.head)
        bounds = (x, y + band.start, x + columns - 1, y + band.stop - 1)
        struct.pack_into("<4i", head, self.window, *bounds)
        chunks = self.chunks[band.start // rows : -(-band.stop // rows)]
        begins = len(head) + 8 * len(chunks) + np.cumsum(chunks[:, 1]) - chunks[:, 1]
        small = BytesIO()
        small.write(head)
        small.write(begins.astype("<u8").tobytes())
        for begin, length in chunks.tolist():
            self.file.seek(begin)
            small.write(self.file.read(length))
        small.seek(0)
        return small


@dataclass(frozen=True)
class Bands:
    """An open file of the project, to be read from top to bottom."""

    meta: dict[str, Any]
    size: tuple[int, int]
    """Rows, columns."""
    names: tuple[str, ...]
    """Names of its channels."""
    _source: Path
    _layout: _Layout | None = None
    """None: the file is read as a whole."""

    def __iter__(self) -> Iterator[tuple[slice, dict[str, NDArray[Any]]]]:
        """Rows and their channels; raises `FileError` where the file is damaged."""
        rows, columns = self.size
        if self._layout is None:
            yield slice(0, rows), self._checked(slice(0, rows), exr.load(self._source)[0])
            return
        for band in _bands(rows, 4 * columns * len(self.names), self._layout.chunk_rows):
            with room_for(
                (band.stop - band.start) * columns * len(self.names) * exr.SMALLEST_SAMPLE,
                f"'{self._source}', by what its header says,",
                "read it on a larger machine; if it should be small, it is damaged",
            ):
                _, channels = exr.opened(self._layout.small(band, columns), self._source)
            yield band, self._checked(band, channels)

    def _checked(self, band: slice, channels: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        shapes = {plane.shape for plane in channels.values()}
        if shapes != {(band.stop - band.start, self.size[1])} or set(channels) != set(self.names):
            raise FileError(
                f"'{self._source}' is damaged: its channels have shapes {sorted(shapes)}"
            )
        return channels


@contextmanager
def reading(path: str | Path, kind: str) -> Iterator[Bands]:
    """Open a file written by `write` or `exr.write`; raises `FileError` as `exr.read` does, before or while bands are read."""
    source = Path(path)
    if not is_file(source):
        raise FileError(f"'{source}' {missing(source)}: give the path of a {kind} EXR file")
    try:
        file = source.open("rb")
    except OSError as error:
        raise FileError(f"cannot read '{source}': {error.strerror or error}") from error
    with file:
        header, _ = exr.opened(file, source, header_only=True)
        meta = exr.expected(exr.meta_of(header, source), source, kind)
        try:
            bands = _bands_of(file, source, header, meta)
        except (KeyError, TypeError, ValueError, struct.error, OSError) as error:
            raise FileError(f"'{source}' is truncated or damaged: {error}") from error
        yield bands


def _bands_of(
    file: IO[bytes], source: Path, header: Mapping[str, Any], meta: dict[str, Any]
) -> Bands:
    (x, y), (right, bottom) = (map(int, corner) for corner in header["dataWindow"])
    rows, columns = bottom - y + 1, right - x + 1
    if rows < 1 or columns < 1:
        raise ValueError(f"it has {columns} columns and {rows} rows")
    names = tuple(channel.name for channel in header["channels"])
    chunk_rows = CHUNK_ROWS.get(int(header["compression"]))
    file.seek(4)
    (flags,) = struct.unpack("<I", file.read(4))
    if flags & OTHER_LAYOUTS or chunk_rows is None:
        return Bands(meta, (rows, columns), names, source)
    window, end = _layout(file)
    chunks = _chunks(file, y, rows, chunk_rows)
    file.seek(0)
    layout = _Layout(file, file.read(end), (x, y), window, chunk_rows, chunks)
    return Bands(meta, (rows, columns), names, source, layout)


def _layout(file: IO[bytes]) -> tuple[int, int]:
    """Offsets of the data window and of the header's end; `ValueError` if there is none."""
    window = None
    file.seek(8)
    while name := _word(file):
        _word(file)
        (size,) = struct.unpack("<i", file.read(4))
        if size < 0:
            raise ValueError("its header is damaged")
        if name == b"dataWindow":
            window = file.tell()
        file.seek(size, 1)
    if window is None:
        raise ValueError("its header has no data window")
    return window, file.tell()


def _word(file: IO[bytes]) -> bytes:
    word = b""
    while (byte := file.read(1)) != b"\0":
        word += byte
        # The maximum length of the library's names.
        if not byte or len(word) > 255:
            raise ValueError("its header is cut off")
    return word


def _chunks(file: IO[bytes], first: int, rows: int, chunk_rows: int) -> NDArray[np.int64]:
    """Offset and length of each chunk, from a file read up to its table; `ValueError` if one is missing."""
    count, start = -(-rows // chunk_rows), file.tell()
    end = file.seek(0, 2)
    if start + 8 * count > end:
        raise ValueError(f"it ends within its table of {count} chunks")
    file.seek(start)
    begins = np.frombuffer(file.read(8 * count), "<u8")
    chunks = np.empty((count, 2), np.int64)
    for i, begin in enumerate(begins.tolist()):
        if not start + 8 * count <= begin <= end - 8:
            raise ValueError(f"chunk {i} of {count} is missing")
        file.seek(begin)
        row, size = struct.unpack("<2i", file.read(8))
        if row != first + i * chunk_rows or not 0 <= size <= end - begin - 8:
            raise ValueError(f"chunk {i} of {count} is not where it should be, or cut off")
        chunks[i] = begin, 8 + size
    return chunks
