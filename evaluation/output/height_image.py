"""Heights as a 16-bit gray image whose metadata states the scale."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError, ScoreError

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
        """The finest scale whose step is 1, 2 or 5 times a power of ten and that holds all heights; `ScoreError` if
        none is finite.

        >>> Scale.of(np.array([0.0, 2.5]))
        Scale(offset_mm=0.0, mm_per_dn=5e-05)
        """
        known = height_mm[np.isfinite(height_mm)].astype(np.float64)
        if not known.size:
            raise ScoreError("no pixel has a height, so there is no image to write")
        low, high = float(known.min()), float(known.max())
        power = math.floor(math.log10(max(high - low, 1e-3) / LEVELS))
        for factor in (1, 2, 5, 10, 20):
            # Parsed from its decimal text, so that a reader gets exactly 5e-05 too.
            step = float(f"{factor}e{power}")
            offset = float(f"{math.floor(low / step) * step:.12g}")
            if (high - offset) / step <= LEVELS:
                return cls(offset, step)
        raise AssertionError("20 times a tenth of the step needed is enough")


def write_height_image(path: str | Path, height_mm: NDArray[Any]) -> Scale:
    """Write heights as a 16-bit gray image.

    Parameters
    ----------
    path
        The file, ending in .png, .tif or .tiff.
    height_mm
        (row, col) heights, NaN where there is none.

    Returns
    -------
    Scale
        Meaning of the digital numbers. The file states it as a sentence in PNG's ``Description`` or TIFF's
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
    scale = Scale.of(height_mm)
    with np.errstate(invalid="ignore"):
        level = np.rint((height_mm.astype(np.float64) - scale.offset_mm) / scale.mm_per_dn) + 1.0
    image = Image.fromarray(np.where(np.isfinite(level), level, 0.0).astype(np.uint16))
    with replacing(path) as temporary:
        if suffix == ".png":
            notes = PngInfo()
            notes.add_text("Description", str(scale))
            notes.add_text("fringebench", json.dumps(vars(scale)))
            image.save(temporary, "PNG", pnginfo=notes)
        else:
            image.save(
                temporary,
                "TIFF",
                compression="tiff_adobe_deflate",
                tiffinfo={IMAGE_DESCRIPTION: str(scale)},
            )
    return scale
