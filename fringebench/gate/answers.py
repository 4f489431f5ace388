"""What a decoder answers, read from files that anything may have written, and checked."""

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from decode import Reconstruction
from fringebench.gate.worker import PARTS
from scenes.files import exr
from scenes.support.errors import OutsideDecoderError

Floats = NDArray[np.float64]
Shape = tuple[int, ...]

# Names that programs give a height channel, best first.
HEIGHT_CHANNELS = ("height_mm", "height", "Z", "z", "Y", "R")
SUFFIXES = (".exr", ".tif", ".tiff", ".npy")
MAGIC = {b"\x76\x2f\x31\x01": ".exr", b"II*\0": ".tif", b"MM\0*": ".tif", b"\x93NUMPY": ".npy"}
# A reconstruction file holds some 80 bytes a pixel; what is much larger is no answer.
BYTES_PER_PIXEL, BYTES_MORE = 400, 1 << 20


@dataclass(frozen=True)
class Answer:
    """What a decoder says of a stack, (row, col)."""

    height_mm: Floats
    """NaN where not valid."""
    sigma_mm: Floats | None
    """Its own standard deviations; None if it claims none."""


def nothing(shape: Shape) -> Answer:
    """The answer of a decoder that finds nothing valid."""
    return Answer(np.full(shape, np.nan), None)


def checked(parts: Any, shape: Shape) -> Answer:
    """A decoder's answer, checked: a `Reconstruction`, heights in mm (row, col), or a tuple of heights, mask and
    perhaps sigma.

    Raises `OutsideDecoderError` for another number of arrays, shape or kind of number, a mask that is not 0 or 1, a negative
    sigma.
    """
    arrays = parts if isinstance(parts, (list, tuple)) else [parts]
    if not 1 <= len(arrays) <= len(PARTS):
        raise OutsideDecoderError(
            f"the decoder returned {len(arrays)} things: expected heights, or heights and mask, or these and sigma"
        )
    for array, name in zip(arrays, PARTS, strict=False):
        if array.shape != shape or array.dtype.kind not in "fbiu":
            raise OutsideDecoderError(
                f"the decoder's {name} are {array.dtype} of shape {array.shape}: expected numbers of the frames' shape "
                f"{shape} (row, col)"
            )
    if arrays[0].dtype.kind != "f":
        raise OutsideDecoderError(
            f"the decoder's heights are {arrays[0].dtype}: give floating point millimetres, NaN where there is none"
        )
    height = arrays[0].astype(np.float64)
    height[~np.isfinite(height)] = np.nan
    if len(arrays) > 1:
        height[~_mask(arrays[1])] = np.nan
    return Answer(height, _sigma(arrays[2], height) if len(arrays) > 2 else None)


def _mask(array: NDArray[Any]) -> NDArray[np.bool_]:
    """A mask as booleans, if it is one."""
    wrong = array[~((array == 0) | (array == 1))]
    if wrong.size:
        raise OutsideDecoderError(
            f"the decoder's mask holds {wrong.flat[0]!s}: give booleans, or 1 where a height is valid and 0 elsewhere"
        )
    return np.asarray(array == 1)


def _sigma(array: NDArray[Any], height: Floats) -> Floats | None:
    """Claimed standard deviations; None where none is known. Infinity is a claim too."""
    if np.isnan(array).all():
        return None
    sigma = array.astype(np.float64)
    if (sigma[np.isfinite(height)] < 0.0).any():
        raise OutsideDecoderError(
            "the decoder's sigma is negative in places: give standard deviations in mm, NaN where they are not known"
        )
    return sigma


def read_output(folder: Path, stem: str, shape: Shape, program: str) -> Answer:
    """The answer in the one file that a program wrote, ``<stem>`` with or without a suffix; `OutsideDecoderError` if there is
    no such one.
    """
    bare = folder / stem
    if _is_plain(bare):
        bare.rename(bare.with_suffix(_suffix(bare)))
    written = [path for path in sorted(folder.glob(f"{stem}*")) if path.suffix in SUFFIXES]
    if len(written) != 1:
        raise OutsideDecoderError(
            f"'{program}' wrote {len(written)} of {{output}}{', {output}'.join(SUFFIXES)}: it must write one"
        )
    return checked(read_heights(written[0], shape), shape)


def read_heights(path: Path, shape: Shape) -> Any:
    """Heights, and mask and sigma where the file has them, from EXR, TIFF or NPY, not yet checked."""
    limit = _limit_bytes(shape)
    if not _is_plain(path):
        raise OutsideDecoderError(
            f"the decoder's '{path.name}' is a link, a pipe, a device or a folder: write a plain file"
        )
    if path.stat().st_size > limit:
        raise OutsideDecoderError(
            f"the decoder's file '{path.name}' has {path.stat().st_size} bytes: {limit} are allowed for {shape} (row, col)"
        )
    try:
        if path.suffix == ".npy":
            planes = read_npy(path, shape)
            return tuple(planes) if planes.ndim == 3 else planes
        if path.suffix == ".exr":
            return _from_exr(path)
        image = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    except OutsideDecoderError:
        raise
    except Exception as error:  # A damaged file may raise anything.
        raise OutsideDecoderError(
            f"the decoder's file '{path.name}' cannot be read: {error}"
        ) from error
    if image is None:
        raise OutsideDecoderError(f"the decoder's file '{path.name}' is no readable TIFF")
    return image


def read_npy(path: Path, frame: Shape) -> NDArray[Any]:
    """A plain array from a file whose header and size agree and suit frames of that shape; `OutsideDecoderError` for any other."""
    # What a running decoder may exchange meanwhile: neither a link is followed, nor a pipe waited for.
    descriptor = os.open(
        path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    )
    with os.fdopen(descriptor, "rb") as file:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OutsideDecoderError(f"the decoder's '{path.name}' is not a plain file")
        try:
            version = npy.read_magic(file)
            read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            shape, fortran, dtype = read(file)
        except (ValueError, EOFError) as error:
            raise OutsideDecoderError(
                f"the decoder's file '{path.name}' is empty, damaged or no NPY file: {error}"
            ) from error
        data = file.read(_limit_bytes(frame))
    if dtype.hasobject or dtype.kind not in "fbiu":
        raise OutsideDecoderError(
            f"the decoder's file '{path.name}' holds {dtype}: save numbers, not a pickle"
        )
    count = int(np.prod(shape, dtype=object))
    if len(data) != count * dtype.itemsize:
        raise OutsideDecoderError(
            f"the decoder's file '{path.name}' claims shape {shape} of {dtype}, which is {count * dtype.itemsize} bytes, and "
            f"holds {len(data)}"
        )
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def _limit_bytes(shape: Shape) -> int:
    """The largest file that an answer for frames of that shape may be."""
    return BYTES_MORE + BYTES_PER_PIXEL * int(np.prod(shape))


def _from_exr(path: Path) -> Any:
    """Heights, and mask and sigma where they are, from an EXR file of ours or of others."""
    channels, meta = exr.load(path)
    if meta is not None and meta.get("format") == "reconstruction":
        rec = Reconstruction.read(path)
        return rec.height_mm, rec.valid, rec.total_sigma_mm
    name = next((n for n in HEIGHT_CHANNELS if n in channels), None)
    if name is None and len(channels) == 1:
        name = next(iter(channels))
    if name is None:
        raise OutsideDecoderError(
            f"the decoder's EXR has channels {sorted(channels)}: name the heights 'height_mm' (and 'valid', 'sigma_mm')"
        )
    height = channels[name]
    valid = channels.get("valid", np.ones(height.shape))
    return (height, valid, channels["sigma_mm"]) if "sigma_mm" in channels else (height, valid)


def _is_plain(path: Path) -> bool:
    """Whether it is a regular file and no link."""
    try:
        return stat.S_ISREG(path.lstat().st_mode)
    except OSError:
        return False


def _suffix(path: Path) -> str:
    """The suffix that the first bytes of a file call for; none where they are no image's."""
    with path.open("rb") as file:
        start = file.read(max(map(len, MAGIC)))
    return next((suffix for magic, suffix in MAGIC.items() if start.startswith(magic)), "")
