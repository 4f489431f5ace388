"""Files written and read a band of rows at a time are the files that the library writes and reads at once."""

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from scenes.files import exr, exr_rows
from scenes.support.errors import FileError
from tests.scenes.files.test_exr import CHANNELS, COLUMNS, RNG, ROWS, narrow, read_rows

__all__ = ["narrow"]
CODECS = [
    f"{name}_COMPRESSION"
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "HTJ2K32", "HTJ2K256")
]


def codec(name: str) -> dict[str, Any]:
    return {"compression": getattr(OpenEXR, name), "expTime": 0.25}


@pytest.mark.parametrize("rows", [1, 16, 33, 64, 65, ROWS])
@pytest.mark.parametrize("name", CODECS)
def test_file_equals_the_librarys_byte_for_byte(name: str, rows: int, tmp_path: Path) -> None:
    channels = {key: plane[:rows] for key, plane in CHANNELS.items()}
    exr.write(tmp_path / "once.exr", "thing", channels, {"note": "µ"}, codec(name))
    exr_rows.write(tmp_path / "bands.exr", "thing", channels, {"note": "µ"}, codec(name))
    assert (tmp_path / "bands.exr").read_bytes() == (tmp_path / "once.exr").read_bytes()


@pytest.mark.parametrize("name", [*CODECS, "DWAA_COMPRESSION", "ZSTD_COMPRESSION"])
def test_bands_equal_the_file_read_as_a_whole(name: str, tmp_path: Path) -> None:
    if not hasattr(OpenEXR, name):
        pytest.skip("a codec of later libraries")
    path = tmp_path / "a.exr"
    exr.write(path, "thing", CHANNELS, {"note": "µ"}, codec(name))
    whole, meta = exr.read(path, "thing")
    with exr_rows.reading(path, "thing") as bands:
        assert bands.meta == meta
        assert bands.size == (ROWS, COLUMNS)
        rows = [range(ROWS)[band] for band, _ in bands]
    assert [row for band in rows for row in band] == list(range(ROWS))
    # The last two have one chunk, and a length that we do not know.
    assert len(rows) > 1 or name in ("HTJ2K256_COMPRESSION", "ZSTD_COMPRESSION")
    for key, plane in read_rows(path).items():
        assert plane.dtype == whole[key].dtype
        assert plane.tobytes() == whole[key].tobytes()


@pytest.mark.parametrize(
    "changes",
    [
        {"lineOrder": OpenEXR.DECREASING_Y},
        {"dataWindow": ((5, -7), (4 + COLUMNS, ROWS - 8))},
        {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()},
    ],
    ids=["upwards", "window", "tiles"],
)
def test_other_programs_layouts_are_read(changes: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    header = exr.new_header("thing", {}) | changes
    OpenEXR.File(header, dict(CHANNELS)).write(str(path))
    for key, plane in read_rows(path).items():
        assert np.array_equal(plane, CHANNELS[key]), key


def test_planes_are_stored_as_the_type_asked_for(tmp_path: Path) -> None:
    counts = RNG.integers(0, 4096, (2 * ROWS, 2 * COLUMNS)).astype(np.uint16)
    planes = {
        "a": counts[::2, ::2],
        "b": counts[::-2, 1::2],
        "c": np.asfortranarray(counts[:ROWS, :COLUMNS]),
    }
    exr_rows.write(tmp_path / "a.exr", "thing", planes, {}, dtype=np.float32)
    for key, plane in read_rows(tmp_path / "a.exr").items():
        assert plane.dtype == np.float32
        assert np.array_equal(plane, planes[key])


def chunks_at(whole: bytes) -> int:
    """Where the table of chunks begins."""
    return exr_rows._layout(io.BytesIO(whole))[1]


def test_misplaced_chunks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    exr_rows.write(path, "thing", CHANNELS, {})
    whole = path.read_bytes()
    at = chunks_at(whole)
    first, second = struct.unpack_from("<2Q", whole, at)
    for begins in ((second, first), (first, first), (0, second), (first, 2**63), (first, at)):
        damaged = bytearray(whole)
        struct.pack_into("<2Q", damaged, at, *begins)
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"chunk [01] of 13"):
            read_rows(path)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, FileError])
def test_writing_that_fails_between_bands_keeps_the_old_file(
    error: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.exr"
    exr_rows.write(path, "thing", CHANNELS, {})
    old, encode, calls = path.read_bytes(), exr_rows._encoded, []

    def stop(*args: Any) -> io.BytesIO:
        calls.append(args)
        if len(calls) == 3:
            raise error
        return encode(*args)

    monkeypatch.setattr(exr_rows, "_encoded", stop)
    with pytest.raises(error):
        exr_rows.write(path, "thing", CHANNELS, {"new": True})
    assert len(calls) == 3
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]
