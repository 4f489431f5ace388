"""Image files of cameras: what cannot be one frame is refused."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import scenes
from scenes.files import images
from scenes.support.errors import DecodeError, FileError


def test_tiff_of_two_pages_is_refused(tmp_path: Path) -> None:
    page = np.arange(12, dtype=np.uint16).reshape(3, 4)
    one, two = tmp_path / "one.tif", tmp_path / "two.tif"
    assert cv2.imwrite(str(one), page)
    assert cv2.imwritemulti(str(two), [page, page + 1])
    plane = images.Plane(one, "grey")
    assert (images.read([plane])[0] == page).all()
    with pytest.raises(FileError, match="has 2 pages"):
        images.read([plane._replace(path=two)])
    # A file is what it holds, whatever its name.
    one.write_bytes(cv2.imencode(".bmp", page.astype(np.uint8))[1].tobytes())
    assert (images.read([plane])[0] == page).all()


def test_more_exposures_than_an_index_of_8_bits_are_refused() -> None:
    shown = scenes.PhaseShift(steps=3, periods_px=(16.0,)).frames()
    frames = np.zeros((256, 3, 2, 2), np.uint8)
    with pytest.raises(DecodeError, match="256 exposures are given: a stack holds up to 255"):
        scenes.Stack(frames, shown, tuple(range(1, 257)), scenes.SimpleSensor())
    scenes.Stack(frames[1:], shown, tuple(range(1, 256)), scenes.SimpleSensor())
