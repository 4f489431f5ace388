"""A sample as pictures that any program opens."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenes.acquisition.sensor import Sensor
from scenes.files.stack import Stack
from scenes.support.atomic_file import replacing


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


def modulation_step_dn(sensor: Sensor) -> float:
    """DN per number of ``modulation.png``: 16 bits reach to the sensor's end; to 256 DN if it does not round.

    A power of two, the same for all samples of a sensor.
    """
    return float(2.0 ** ((sensor.bits or 8) - 16))


def modulation_picture(
    modulation_dn: NDArray[np.floating], exposure: NDArray[np.integer], stack: Stack
) -> NDArray[np.uint16]:
    """Modulation (row, col) of the exposures with these numbers as at the shortest, within half a step; 0 where it is not known,
    65535 for that or more.

    At one exposure, so that surfaces compare: where the exposure changes, DN jump.
    """
    share = min(stack.exposure_ms) / np.append(stack.exposure_ms, np.nan)
    shown_dn = modulation_dn * share[np.minimum(exposure, len(stack.exposure_ms))]
    number = np.nan_to_num(shown_dn, nan=0.0) / modulation_step_dn(stack.sensor)
    picture: NDArray[np.uint16] = np.rint(np.clip(number, 0.0, 65535.0)).astype(np.uint16)
    return picture


def write_png(image: NDArray[np.unsignedinteger], path: Path) -> None:
    """Write a grey picture (row, col) of 8 or 16 bits, or a colour one (row, col, 3) of 8, atomically."""
    with replacing(path) as staged:
        Image.fromarray(image).save(staged, format="PNG")


def write_tiff(height_mm: NDArray[np.floating], path: Path) -> None:
    """Write heights (row, col) as float32, NaN where there is none, atomically."""
    with replacing(path) as staged:
        Image.fromarray(height_mm.astype(np.float32)).save(
            staged, format="TIFF", compression="tiff_adobe_deflate"
        )


def read_png(path: Path) -> NDArray[Any]:
    """A picture (row, col) or (row, col, 3) of a sample, of 8 or 16 bits."""
    with Image.open(path) as image:
        return np.asarray(image)
