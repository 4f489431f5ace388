"""A sample as pictures that any program opens: the grey picture of a 2-D camera, and measured heights in 16 bits."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from scenes.files.stack import Stack
from scenes.support.atomic_file import replacing

HIGHEST = 65535


@dataclass(frozen=True)
class HeightCode:
    """Heights as 16-bit numbers: ``height_mm = offset_mm + step_mm * number``; 0 means no height."""

    offset_mm: float
    step_mm: float

    @classmethod
    def of_range(cls, low_mm: float, high_mm: float) -> "HeightCode":
        """Numbers 1 to 65535 from `low_mm` to `high_mm`."""
        step = (high_mm - low_mm) / (HIGHEST - 1)
        return cls(low_mm - step, step)

    def encode(self, height_mm: ArrayLike) -> NDArray[np.uint16]:
        """Heights in mm (row, col) as numbers; NaN and heights outside the range become 0; off by half a step at most.

        >>> HeightCode.of_range(0.0, 0.5).encode([[0.0, 0.5, float("nan"), 0.6]])
        array([[    1, 65535,     0,     0]], dtype=uint16)
        """
        number = (np.asarray(height_mm, np.float64) - self.offset_mm) / self.step_mm
        # NaN compares false.
        inside = (number > 0.5) & (number < HIGHEST + 0.5)
        return np.where(inside, np.rint(np.where(inside, number, 0.0)), 0.0).astype(np.uint16)

    def decode(self, number: ArrayLike) -> NDArray[np.float64]:
        """(row, col) heights in mm of what `encode` gave; NaN for 0."""
        found = np.asarray(number, np.float64)
        height: NDArray[np.float64] = np.where(
            found > 0, self.offset_mm + self.step_mm * found, np.nan
        )
        return height

    def to_dict(self) -> dict[str, Any]:
        """As in ``labels.json``."""
        return asdict(self) | {"no_height": 0}


def camera_picture(stack: Stack) -> NDArray[np.uint8]:
    """Picture (row, col) of a 2-D camera under the projectors' mean light: 0 is black level, 255 saturation, sRGB curve
    between.

    The frames of the median exposure are averaged, so that fringes cancel.
    """
    mean = stack.frames[len(stack.exposure_ms) // 2].mean(axis=0, dtype=np.float64)
    black = float(stack.sensor.black_level_dn)
    white = stack.saturation_dn if np.isfinite(stack.saturation_dn) else float(mean.max())
    return srgb((mean - black) / max(white - black, 1e-12))


def srgb(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Linear light on the sRGB curve in 8 bits; 1 and more is 255.

    >>> srgb(np.array([0.0, 0.2, 1.5]))
    array([  0, 124, 255], dtype=uint8)
    """
    linear = np.clip(linear, 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    picture: NDArray[np.uint8] = np.rint(255.0 * curve).astype(np.uint8)
    return picture


def write_png(image: NDArray[np.uint8] | NDArray[np.uint16], path: Path) -> None:
    """Write a grey picture (row, col) of 8 or 16 bits, or a colour one (row, col, 3) of 8, atomically."""
    with replacing(path) as staged:
        Image.fromarray(image).save(staged, format="PNG")
