"""A device's relative illumination as measured: an image file or an array, named by its path and content."""

import hashlib
import io
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field, model_validator
from scipy.ndimage import map_coordinates

from scenes.support.errors import FileError
from scenes.support.frozen import Frozen
from scenes.support.paths import is_file, missing

Floats = NDArray[np.float64]
IMAGES = (".png", ".tif", ".tiff", ".bmp")
MAX_SIDE = 8192
MAX_BYTES = 8 * MAX_SIDE**2 + 4096
# Brightest over darkest: far beyond any lens, and exact in float32.
MAX_RATIO = 1e6


class IlluminationMap(Frozen):
    """A map of light over a device's whole image: a flat field, without its dark image.

    Any size: a sample is the light at the centre of its cell, between which it is linear. Only ratios count: it is divided by its
    value in the image centre.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> file = pathlib.Path(tempfile.mkdtemp()) / "flat.npy"
    >>> np.save(file, [[2.0, 4.0, 1.0]])
    >>> IlluminationMap(path=file).values().tolist()
    [[0.5, 1.0, 0.25]]
    """

    path: Path
    """A `.npy` array (row, col) of real numbers, or a grey PNG, TIFF or BMP whose numbers are linear in light. Relative
    paths are resolved against the scene file's folder."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    """Of the file. Absent: as the file is when the scene is loaded. Light is traced and exposed with this content alone, so a
    stack's scene states which it was."""

    @model_validator(mode="after")
    def _is_known(self) -> Self:
        if self.sha256 is None:
            try:
                content = _content(self.path)
                _values(content, self.path)
            except FileError as error:
                raise ValueError(str(error)) from None
            # The model is frozen for its users.
            object.__setattr__(self, "sha256", hashlib.sha256(content).hexdigest())
            self.model_fields_set.add("sha256")
        return self

    def values(self) -> Floats:
        """Illumination over the image centre's.

        Returns
        -------
        ndarray of float64, (row, col)
            Ratio, 0 or more.

        Raises
        ------
        FileError
            The file is missing, is no map, or is not the one that the scene was loaded with.
        """
        content = _content(self.path)
        found = hashlib.sha256(content).hexdigest()
        if found != self.sha256:
            raise FileError(
                f"illumination map '{self.path}' has changed: its sha256 is {found}, the scene's is {self.sha256}; restore "
                "the file, or remove sha256 from the scene to use the file as it is"
            )
        values = _values(content, self.path)
        centre = interpolated(values, np.array([0.5]), np.array([0.5]))
        return np.asarray(values / centre)


def interpolated(values: Floats, across: Floats, down: Floats) -> Floats:
    """A map at places (...) from 0 to 1 across and down the image: linear between the centres of its cells, constant beyond."""
    rows, columns = values.shape
    places = np.broadcast_arrays(down * rows - 0.5, across * columns - 0.5)
    result: Floats = map_coordinates(values, places, order=1, mode="nearest")
    return result


def _content(path: Path) -> bytes:
    if not is_file(path):
        raise FileError(
            f"illumination map '{path}' {missing(path)}: give a .npy array or a grey {', '.join(IMAGES)} image"
        )
    try:
        if path.stat().st_size > MAX_BYTES:
            raise FileError(
                f"illumination map '{path}' has {path.stat().st_size} bytes: give one of at most {MAX_SIDE} x {MAX_SIDE}"
            )
        return path.read_bytes()
    except OSError as error:
        raise FileError(f"illumination map '{path}' cannot be read: {error.strerror}") from error


def _values(content: bytes, path: Path) -> Floats:
    """Its numbers (row, col), checked."""
    try:
        read = _array(content) if path.suffix.lower() == ".npy" else _image(content)
    except (OSError, ValueError, EOFError, SyntaxError, Image.DecompressionBombError) as error:
        raise FileError(
            f"illumination map '{path}' cannot be read ({error}): give a .npy array of real numbers (row, col) or a grey "
            f"{', '.join(IMAGES)} image, at most {MAX_SIDE} a side"
        ) from error
    values = np.asarray(read, dtype=np.float64)
    low, high = float(values.min()), float(values.max())
    if not (np.isfinite(values).all() and low > 0.0 and high / low <= MAX_RATIO):
        raise FileError(
            f"illumination map '{path}' has values from {low:g} to {high:g}: all must be finite, above 0 and within a "
            f"factor of {MAX_RATIO:g}"
        )
    return values


def _array(content: bytes) -> NDArray[Any]:
    # The header is read first, so that a false shape takes no memory.
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0  # fmt: skip
    shape, _, dtype = header(stream)
    _require_size(shape)
    if dtype.kind not in "uif":
        raise ValueError(f"its numbers are {dtype}")
    return np.asarray(np.load(io.BytesIO(content), allow_pickle=False))


def _image(content: bytes) -> NDArray[Any]:
    with Image.open(io.BytesIO(content), formats=("PNG", "TIFF", "BMP")) as image:
        _require_size(image.size)
        if image.mode not in ("L", "I", "F") and not image.mode.startswith("I;16"):
            raise ValueError(f"its mode is {image.mode}, not grey")
        return np.asarray(image)


def _require_size(shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or not all(1 <= side <= MAX_SIDE for side in shape):
        raise ValueError(f"its shape is {shape}")
