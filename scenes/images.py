"""Reading a camera's image files as planes of digital numbers: PNG, TIFF, BMP, JPEG; 8 to 16 bit; one channel."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from scenes import mapped
from scenes.errors import FileError
from scenes.paths import is_file

ImageChannel = Literal["grey", "red", "green", "blue", "luma"]
SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")
# OpenCV's order of colour planes.
PLANES = {"blue": 0, "green": 1, "red": 2}
# Rec. 601, in OpenCV's order blue, green, red.
LUMA = np.array([0.114, 0.587, 0.299], dtype=np.float32)


def find(folder: Path, names: Sequence[str]) -> list[Path]:
    """Files of a folder in the order shown: each name is a file, or a glob whose matches follow in natural order.

    ``img2`` sorts before ``img10``. Raises `FileError` for a name that matches nothing, and for a file named twice.
    """
    found: list[Path] = []
    for name in names:
        # a literal name comes first: camera software likes brackets, which a glob would read as a set
        exact = folder / name
        try:
            matches = [exact] if is_file(exact) else sorted(folder.glob(name), key=_natural)
        except (OSError, ValueError, NotImplementedError) as error:
            raise FileError(
                f"files has {name!r}: {error}; give a name or a pattern relative to the manifest"
            ) from error
        matches = [path for path in matches if path.suffix.lower() in SUFFIXES]
        if not matches:
            raise FileError(
                f"'{exact}' is missing: no {', '.join(SUFFIXES)} file has that name or matches it as a pattern"
            )
        found += matches
    twice = {path.name for path in found if found.count(path) > 1}
    if twice:
        raise FileError(f"files named twice in '{folder}': {sorted(twice)}; list each frame once")
    return found


def read(paths: Sequence[Path], channel: ImageChannel = "grey") -> NDArray[Any]:
    """Planes (frame, row, col), uint8 or uint16, of files of one size and depth; EXIF rotation is not applied.

    `channel` picks one plane of colour files; ``luma`` weighs all three (Rec. 601), which hides a clipped channel.
    Raises `FileError` for an unreadable file, mixed sizes or depths, and a channel the file does not have, `TooLargeError`
    for more than memory and disk hold.
    """
    stack: NDArray[Any] | None = None
    for i, path in enumerate(paths):
        plane = _one(path, channel)
        if stack is None:
            stack = mapped.array(
                (len(paths), *plane.shape),
                plane.dtype,
                f"reading {len(paths)} images of {_described(plane)}",
                "import fewer frames or exposures at a time",
            )
        if plane.shape != stack.shape[1:] or plane.dtype != stack.dtype:
            raise FileError(
                f"'{path}' is {_described(plane)}, '{paths[0].name}' is {_described(stack[0])}: "
                "all frames must have one size and one depth"
            )
        stack[i] = plane
        mapped.let_go(stack)
    if stack is None:
        raise FileError("no image files are given: list the frames in the order shown")
    return stack


def _one(path: Path, channel: ImageChannel) -> NDArray[Any]:
    # imdecode, as imread prints its own complaints and cannot open every file name
    try:
        raw = np.fromfile(path, np.uint8)
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error.strerror or error}") from error
    try:
        image: NDArray[Any] | None = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED) if raw.size else None
    except cv2.error:
        image = None
    if image is None:
        raise FileError(f"'{path}' is no readable image: expected {', '.join(SUFFIXES)}")
    if image.dtype not in (np.uint8, np.uint16):
        raise FileError(f"'{path}' holds {image.dtype}: give 8- or 16-bit whole digital numbers")
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


def _natural(path: Path) -> list[tuple[int, str]]:
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]
