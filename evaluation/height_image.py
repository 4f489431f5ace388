"""Heights as a 16-bit gray image whose metadata says what a digital number means."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from scenes.errors import FileError, ScoreError
from scenes.replace_file import replacing

# 0 is "no height"; 1 to 65535 are heights.
LEVELS = 65534
IMAGE_DESCRIPTION = 270


@dataclass(frozen=True)
class Scale:
    """``height_mm = offset_mm + mm_per_dn * (DN - 1)``; DN 0: no height."""

    offset_mm: float
    mm_per_dn: float

    def __str__(self) -> str:
        return (
            f"height_mm = {self.offset_mm:.9g} + {self.mm_per_dn:.9g} * (DN - 1); DN 0: no height"
        )

    @classmethod
    def of(cls, height_mm: NDArray[Any]) -> "Scale":
        """The finest step of 1, 2 or 5 times a power of ten that reaches from lowest to highest; `ScoreError` if none is finite.

        >>> Scale.of(np.array([0.0, 2.5]))
        Scale(offset_mm=0.0, mm_per_dn=5e-05)
        """
        known = height_mm[np.isfinite(height_mm)].astype(np.float64)
        if not known.size:
            raise ScoreError("no pixel has a height, so there is no image to write")
        low, high = float(known.min()), float(known.max())
        power = math.floor(math.log10(max(high - low, 1e-3) / LEVELS))
        for factor in (1, 2, 5, 10, 20):
            # From the decimal's own text, so that 5e-05 is what a reader gets too.
            step = float(f"{factor}e{power}")
            offset = float(f"{math.floor(low / step) * step:.12g}")
            if (high - offset) / step <= LEVELS:
                return cls(offset, step)
        raise AssertionError("20 times a tenth of the step needed is enough")


def write_height_image(path: str | Path, height_mm: NDArray[Any]) -> Scale:
    """Write heights (row, col), NaN where there is none, as .png, .tif or .tiff; returns the scale, which the file states.

    The scale stands as a sentence in PNG's ``Description`` or TIFF's ImageDescription, and as JSON in PNG's
    ``fringebench``. Raises `FileError` for another ending or a file that cannot be written, `ScoreError` without heights.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".png", ".tif", ".tiff"):
        raise FileError(f"'{path}': a height image is written as .png, .tif or .tiff")
    scale = Scale.of(height_mm)
    with np.errstate(invalid="ignore"):
        level = np.rint((height_mm.astype(np.float64) - scale.offset_mm) / scale.mm_per_dn) + 1.0
    image = Image.fromarray(np.where(np.isfinite(level), level, 0.0).astype(np.uint16))
    with replacing(path) as beside:
        if suffix == ".png":
            notes = PngInfo()
            notes.add_text("Description", str(scale))
            notes.add_text("fringebench", json.dumps(vars(scale)))
            image.save(beside, "PNG", pnginfo=notes)
        else:
            image.save(
                beside,
                "TIFF",
                compression="tiff_adobe_deflate",
                tiffinfo={IMAGE_DESCRIPTION: str(scale)},
            )
    return scale
