"""Reading a camera's image files as planes of digital numbers: PNG, TIFF, BMP, JPEG; 8 to 16 bit; one channel."""

import io
import os
import re
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenes.support import mapped
from scenes.support.errors import FileError
from scenes.support.paths import is_file

ImageChannel = Literal["grey", "red", "green", "blue", "luma"]
SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")
# OpenCV's order of colour planes.
PLANES = {"blue": 0, "green": 1, "red": 2}
# Rec. 601, in OpenCV's order blue, green, red.
LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)


def find(folder: Path, names: Sequence[str], suffixes: Sequence[str] = SUFFIXES) -> list[Path]:
    """Files in the order shown: each name is a file, or a glob whose matches are sorted in natural order.

    Names are relative to `folder`, which they may leave (``../img*.png``); ``img2`` sorts before ``img10``. Raises `FileError` for a name that matches nothing, and
    for a file named twice.
    """
    found: list[Path] = []
    for name in names:
        # A literal name comes first: camera software uses brackets, which a glob would read as a set.
        exact = folder / name
        try:
            matches = [exact] if is_file(exact) else sorted(folder.glob(name), key=_natural)
        except (OSError, ValueError, NotImplementedError) as error:
            raise FileError(
                f"files has {name!r}: {error}; give a name or a pattern relative to the manifest"
            ) from error
        matches = [path for path in matches if path.suffix.lower() in suffixes]
        if not matches:
            raise FileError(
                f"'{exact}' is missing: no {', '.join(suffixes)} file has that name or matches it as a pattern"
            )
        found += matches
    # One file by two names, such as "../scan/img1.png", is one frame; links to it are frames of their own.
    places = Counter(os.path.abspath(path) for path in found)  # noqa: PTH100
    twice = {Path(place).name for place, count in places.items() if count > 1}
    if twice:
        raise FileError(f"files listed twice in '{folder}': {sorted(twice)}; list each frame once")
    return found


class Plane(NamedTuple):
    """One plane of an image file."""

    path: Path
    channel: ImageChannel = "grey"
    """Plane of a colour file; ``luma`` is a weighted sum of all three (Rec. 601), which hides a clipped channel."""


def read(planes: Sequence[Plane]) -> NDArray[Any]:
    """Digital numbers (frame, row, col), uint8 or uint16, of image files of one size and depth; EXIF rotation is not
    applied.
    """
    stack: NDArray[Any] | None = None
    path, image = Path(), None
    for i, (wanted, channel) in enumerate(planes):
        if image is None or wanted != path:
            path, image = wanted, _image(wanted)
        plane = _plane(image, path, channel)
        if stack is None:
            stack = mapped.array(
                (len(planes), *plane.shape),
                plane.dtype,
                f"reading {len(planes)} frames of {_described(plane)}",
                "import fewer frames or exposures at a time",
            )
        if plane.shape != stack.shape[1:] or plane.dtype != stack.dtype:
            raise FileError(
                f"'{path}' is {_described(plane)}, '{planes[0].path.name}' is {_described(stack[0])}: "
                "all frames must have one size and one depth"
            )
        stack[i] = plane
        mapped.release_pages(stack)
    if stack is None:
        raise FileError("no image files are given: list the frames in the order shown")
    return stack


def _image(path: Path) -> NDArray[Any]:
    # imdecode, because imread prints errors itself and cannot open every file name.
    try:
        raw = np.fromfile(path, np.uint8)
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error.strerror or error}") from error
    try:
        image: NDArray[Any] | None = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
    except cv2.error:
        image = None
    if path.suffix.lower() in (".tif", ".tiff"):
        with suppress(OSError, ValueError), Image.open(io.BytesIO(raw.tobytes())) as pages:
            count = getattr(pages, "n_frames", 1)
            if count > 1:
                raise FileError(
                    f"'{path}' has {count} pages: write each frame to a file of its own"
                )
    if image is None:
        raise FileError(f"'{path}' is no readable image: expected {', '.join(SUFFIXES)}")
    if image.dtype not in (np.uint8, np.uint16):
        raise FileError(f"'{path}' holds {image.dtype}: give 8- or 16-bit whole digital numbers")
    return image


def _plane(image: NDArray[Any], path: Path, channel: ImageChannel) -> NDArray[Any]:
    if image.ndim == 2:
        if channel not in ("grey", "luma"):
            raise FileError(f"'{path}' is grey, but channel is '{channel}': set channel = 'grey'")
        return image
    colours: NDArray[Any] = image[..., :3]
    if channel == "grey":
        if (colours == colours[..., :1]).all():
            return np.ascontiguousarray(colours[..., 0])
        raise FileError(
            f"'{path}' is in colour: set channel to red, green, blue or luma, whichever sees the projector's light"
        )
    if channel == "luma":
        luma: NDArray[Any] = np.rint(colours.astype(np.float32) @ LUMA).astype(image.dtype)
        return luma
    return np.ascontiguousarray(colours[..., PLANES[channel]])


def _described(plane: NDArray[Any]) -> str:
    return f"{plane.shape[1]} x {plane.shape[0]} pixels of {plane.dtype.itemsize * 8} bits"


def _natural(path: Path) -> list[list[tuple[int, str]]]:
    """Sorting key: numbers in the names of folders and files by their value."""
    names = [re.split(r"(\d+)", name) for name in path.parts]
    return [[(int(p), "") if p.isdecimal() else (-1, p) for p in parts] for parts in names]
