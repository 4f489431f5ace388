"""Files written and read a band of rows at a time are the files that the library writes and reads at once."""

import io
import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from scenes import exr, exr_bands
from scenes.errors import FileError
from tests.scenes.test_exr import full_disk

RNG = np.random.default_rng(5)
# Counts with noise on a fringe, radiance, labels: every channel type, and chunks that compress well and badly.
ROWS, COLUMNS = 203, 61
FRINGE = 800 + 700 * np.cos(np.arange(COLUMNS) / 9)
CHANNELS: dict[str, np.ndarray] = {
    "single": RNG.normal(size=(ROWS, COLUMNS)).astype(np.float32),
    "half": RNG.poisson(np.broadcast_to(FRINGE, (ROWS, COLUMNS))).astype(np.float16),
    "whole": np.repeat(np.arange(ROWS, dtype=np.uint32)[:, None] // 50, COLUMNS, axis=1),
}
CODECS = [
    f"{name}_COMPRESSION"
    for name in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "HTJ2K32", "HTJ2K256")
]


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands of a chunk or two."""
    monkeypatch.setattr(exr_bands, "BAND_BYTES", 64 * COLUMNS * 10)


def codec(name: str) -> dict[str, Any]:
    return {"compression": getattr(OpenEXR, name), "expTime": 0.25}


def read(path: Path) -> dict[str, np.ndarray]:
    with exr_bands.reading(path, "thing") as bands:
        parts = [channels for _, channels in bands]
    return {name: np.concatenate([part[name] for part in parts]) for name in bands.names}


@pytest.mark.parametrize("rows", [1, 16, 33, 64, 65, ROWS])
@pytest.mark.parametrize("name", CODECS)
def test_every_byte_is_the_librarys(name: str, rows: int, tmp_path: Path) -> None:
    channels = {key: plane[:rows] for key, plane in CHANNELS.items()}
    exr.write(tmp_path / "once.exr", "thing", channels, {"note": "µ"}, codec(name))
    exr_bands.write(tmp_path / "bands.exr", "thing", channels, {"note": "µ"}, codec(name))
    assert (tmp_path / "bands.exr").read_bytes() == (tmp_path / "once.exr").read_bytes()


@pytest.mark.parametrize("name", [*CODECS, "DWAA_COMPRESSION", "ZSTD_COMPRESSION"])
def test_bands_read_what_is_read_at_once(name: str, tmp_path: Path) -> None:
    if not hasattr(OpenEXR, name):
        pytest.skip("a codec of later libraries")
    path = tmp_path / "a.exr"
    exr.write(path, "thing", CHANNELS, {"note": "µ"}, codec(name))
    whole, meta = exr.read(path, "thing")
    with exr_bands.reading(path, "thing") as bands:
        assert bands.meta == meta
        assert bands.size == (ROWS, COLUMNS)
        rows = [range(ROWS)[band] for band, _ in bands]
    assert [row for band in rows for row in band] == list(range(ROWS))
    # The last two have one chunk, and a length that we do not know.
    assert len(rows) > 1 or name in ("HTJ2K256_COMPRESSION", "ZSTD_COMPRESSION")
    for key, plane in read(path).items():
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
    for key, plane in read(path).items():
        assert np.array_equal(plane, CHANNELS[key]), key


def test_planes_of_other_types_and_layouts_are_stored_as_asked(tmp_path: Path) -> None:
    counts = RNG.integers(0, 4096, (2 * ROWS, 2 * COLUMNS)).astype(np.uint16)
    planes = {
        "a": counts[::2, ::2],
        "b": counts[::-2, 1::2],
        "c": np.asfortranarray(counts[:ROWS, :COLUMNS]),
    }
    exr_bands.write(tmp_path / "a.exr", "thing", planes, {}, dtype=np.float32)
    for key, plane in read(tmp_path / "a.exr").items():
        assert plane.dtype == np.float32
        assert np.array_equal(plane, planes[key])


def test_every_truncation_is_noticed_and_nothing_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.exr"
    exr_bands.write(path, "thing", CHANNELS, {})
    whole = path.read_bytes()
    for length in sorted({*range(0, 1000, 13), *range(1000, len(whole), 977), len(whole) - 1}):
        path.write_bytes(whole[:length])
        with pytest.raises(FileError, match=r"truncated,? (or )?damaged"):
            read(path)
    assert capfd.readouterr() == ("", "")


def test_flipped_bytes_never_do_worse_than_a_file_error(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    exr_bands.write(path, "thing", CHANNELS, {})
    whole = path.read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(150):
        damaged = bytearray(whole)
        # Mostly in the header and the table of chunks, where one byte can mean anything.
        for at in rng.integers(0, 800 if rng.random() < 0.8 else len(whole), rng.integers(1, 5)):
            damaged[at] = rng.integers(256)
        path.write_bytes(damaged)
        try:
            read(path)
        except FileError:
            refused += 1
    assert refused > 50


def chunks_at(whole: bytes) -> int:
    """Where the table of chunks begins."""
    return exr_bands._layout(io.BytesIO(whole))[1]


def test_chunks_that_are_not_where_the_table_says_are_told(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    exr_bands.write(path, "thing", CHANNELS, {})
    whole = path.read_bytes()
    at = chunks_at(whole)
    first, second = struct.unpack_from("<2Q", whole, at)
    for begins in ((second, first), (first, first), (0, second), (first, 2**63), (first, at)):
        damaged = bytearray(whole)
        struct.pack_into("<2Q", damaged, at, *begins)
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"chunk [01] of 13"):
            read(path)


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, FileError])
def test_writing_that_stops_between_bands_leaves_the_old_file(
    error: type[BaseException], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.exr"
    exr_bands.write(path, "thing", CHANNELS, {})
    old, encode, calls = path.read_bytes(), exr_bands._encoded, []

    def stop(*args: Any) -> io.BytesIO:
        calls.append(args)
        if len(calls) == 3:
            raise error
        return encode(*args)

    monkeypatch.setattr(exr_bands, "_encoded", stop)
    with pytest.raises(error):
        exr_bands.write(path, "thing", CHANNELS, {"new": True})
    assert len(calls) == 3
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("limit", [0, 100, 20_000])
def test_a_full_disk_keeps_the_old_file(limit: int, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    exr_bands.write(path, "thing", CHANNELS, {})
    old = path.read_bytes()
    assert len(old) > 20_000
    with full_disk(limit), pytest.raises(FileError, match="cannot write"):
        exr_bands.write(path, "thing", CHANNELS, {})
    assert path.read_bytes() == old
    assert list(tmp_path.iterdir()) == [path]
