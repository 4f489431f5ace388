"""Heights as a 16-bit gray image whose metadata states the scale."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, ScoreError

HIGHEST = 65535
IMAGE_DESCRIPTION = 270


@dataclass(frozen=True)
class HeightCode:
    """Heights as 16-bit numbers: ``height_mm = offset_mm + step_mm * number``; 0 means no height."""

    offset_mm: float
    step_mm: float

    def __str__(self) -> str:
        return f"height_mm = {self.offset_mm:.9g} + {self.step_mm:.9g} * number; 0: no height"

    @classmethod
    def of_range(cls, low_mm: float, high_mm: float) -> "HeightCode":
        """Numbers 1 to 65535 from `low_mm` to `high_mm`."""
        step = (high_mm - low_mm) / (HIGHEST - 1)
        return cls(low_mm - step, step)

    @classmethod
    def of(cls, height_mm: NDArray[Any]) -> "HeightCode":
        """The finest code whose step is 1, 2 or 5 times a power of ten and that holds all heights; `ScoreError` if
        none is finite.

        >>> HeightCode.of(np.array([0.0, 2.5]))
        HeightCode(offset_mm=-5e-05, step_mm=5e-05)
        """
        known = height_mm[np.isfinite(height_mm)].astype(np.float64)
        if not known.size:
            raise ScoreError("no pixel has a height, so there is no image to write")
        low, high = float(known.min()), float(known.max())
        power = math.floor(math.log10(max(high - low, 1e-3) / (HIGHEST - 1)))
        for factor in (1, 2, 5, 10, 20):
            # Parsed from its decimal text, so that a reader gets exactly 5e-05 too.
            step = float(f"{factor}e{power}")
            offset = float(f"{(math.floor(low / step) - 1) * step:.12g}")
            if (high - offset) / step <= HIGHEST:
                return cls(offset, step)
        raise AssertionError("20 times a tenth of the step needed is enough")

    def encode(self, height_mm: ArrayLike) -> NDArray[np.uint16]:
        """Heights in mm (row, col) as numbers; NaN and heights outside the range become 0; off by half a step at most.

        >>> HeightCode.of_range(0.0, 0.5).encode([[0.0, 0.5, float("nan"), 0.6]])
        array([[    1, 65535,     0,     0]], dtype=uint16)
        """
        number = (np.asarray(height_mm, np.float64) - self.offset_mm) / self.step_mm
        # NaN compares false.
        inside = (number > 0.5) & (number < HIGHEST + 0.5)
        return np.where(inside, np.rint(np.where(inside, number, 0.0)), 0.0).astype(np.uint16)


def write_height_image(
    path: str | Path, height_mm: NDArray[Any], code: HeightCode | None = None
) -> HeightCode:
    """Write heights as a 16-bit gray image.

    Parameters
    ----------
    path
        The file, ending in .png, .tif or .tiff.
    height_mm
        (row, col) heights, NaN where there is none.
    code
        Meaning of the numbers; None: the finest that holds all heights.

    Returns
    -------
    HeightCode
        Meaning of the numbers. The file states it as a sentence in PNG's ``Description`` or TIFF's
        ImageDescription, and as JSON in PNG's ``fringebench``.

    Raises
    ------
    FileError
        For another ending, or a file that cannot be written.
    ScoreError
        Without heights.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".png", ".tif", ".tiff"):
        raise FileError(f"'{path}': a height image is written as .png, .tif or .tiff")
    code = code or HeightCode.of(height_mm)
    image = Image.fromarray(code.encode(height_mm))
    with replacing(path) as temporary:
        if suffix == ".png":
            notes = PngInfo()
            notes.add_text("Description", str(code))
            notes.add_text("fringebench", json.dumps(vars(code)))
            image.save(temporary, "PNG", pnginfo=notes)
        else:
            image.save(
                temporary,
                "TIFF",
                compression="tiff_adobe_deflate",
                tiffinfo={IMAGE_DESCRIPTION: str(code)},
            )
    return code
