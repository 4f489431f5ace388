"""A truth file gives back every map, or a `FileError`."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenes.files import exr
from scenes.files.truth_maps import Truth
from scenes.support.errors import FileError, ScoreError

PROJECTORS, ROWS, COLUMNS = 3, 9, 7


@pytest.fixture
def truth() -> Truth:
    rng = np.random.default_rng(0)

    def image(*lead: int, tail: tuple[int, ...] = ()) -> np.ndarray:
        values = rng.normal(0, 30, (*lead, ROWS, COLUMNS, *tail)).astype(np.float32)
        values[..., 0, :3] = np.nan
        return values

    return Truth(
        image(tail=(3,)),
        image(tail=(3,)),
        rng.integers(0, 65536, (ROWS, COLUMNS)).astype(np.uint16),
        ("base", "Pad-1", "ink_2"),
        rng.random((PROJECTORS, ROWS, COLUMNS)) < 0.5,
        image(PROJECTORS),
        image(PROJECTORS),
        image(PROJECTORS),
        'name = "x"\n',
        rng.integers(0, 2**20, (ROWS, COLUMNS)).astype(np.uint32),
        rng.integers(0, 3, (ROWS, COLUMNS)).astype(np.uint16),
        ("solder-paste", "gold"),
    )


def test_maps_survive_bit_by_bit(truth: Truth, tmp_path: Path) -> None:
    truth.write(tmp_path / "t.exr")
    back = Truth.read(tmp_path / "t.exr")
    maps = ("xyz_mm", "normal", "label", "lit_by", "columns_px", "rows_px", "direct_fractions")
    for field in (*maps, "pad", "material"):
        ours, theirs = getattr(truth, field), getattr(back, field)
        assert ours.dtype == theirs.dtype, field
        assert ours.shape == theirs.shape, field
        assert ours.tobytes() == np.ascontiguousarray(theirs).tobytes(), field
    assert (back.labels, back.scene) == (truth.labels, truth.scene)
    assert back.materials == truth.materials


def test_height_is_world_z_and_regions_follow_labels(truth: Truth) -> None:
    assert np.array_equal(truth.height_mm, truth.xyz_mm[..., 2], equal_nan=True)
    truth.label[:] = 0
    truth.label[2, 3] = 2
    assert np.argwhere(truth.region("Pad-1")).tolist() == [[2, 3]]
    assert not truth.region("base").any()
    with pytest.raises(ScoreError, match="no label 'Pad1': did you mean 'Pad-1'"):
        truth.region("Pad1")


@pytest.mark.parametrize("gone", ["xyz.Y", "N.Z", "label", "P2.lit", "P0.column", "P1.direct"])
def test_missing_map_is_a_file_error(truth: Truth, tmp_path: Path, gone: str) -> None:
    path = tmp_path / "t.exr"
    truth.write(path)
    channels, meta = exr.read(path, "truth")
    del channels[gone], meta["format"], meta["version"]
    exr.write(path, "truth", channels, meta)
    with pytest.raises(FileError, match=f"damaged.*{gone}"):
        Truth.read(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"projectors": 4},
        {"projectors": 0},
        {"projectors": "many"},
        {"projectors": None},
        {"labels": 7},
    ],
    ids=str,
)
def test_damaged_header_is_a_file_error(
    truth: Truth, tmp_path: Path, changes: dict[str, Any]
) -> None:
    path = tmp_path / "t.exr"
    truth.write(path)
    channels, meta = exr.read(path, "truth")
    del meta["format"], meta["version"]
    exr.write(path, "truth", channels, meta | changes)
    with pytest.raises(FileError, match="truth header or channels are damaged"):
        Truth.read(path)
