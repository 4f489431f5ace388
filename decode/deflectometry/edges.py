"""Edges of a mirror, where a pixel's light comes from a part of its area: by how much it then looks elsewhere.

Where only a part of a pixel's area shows the screen, the measured phase is that of this part's centre
(`decode.validity.uneven_light`). The blur is not known well enough to correct that, but to predict its size.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.reason import Reason
from decode.validity.uneven_light import SOBEL, SQUARE_PX2, relative_slope
from scenes.acquisition.sensor import Emva, Sensor

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Pixels from an edge at which a lens's blur is looked for.
BORDER_PX = 5
# A straight edge through the centre of a pixel leaves it half of its light, whatever the blur.
HALF = 0.5
# Standard deviations of a gradient that are noise.
SURE = 2.0
# Reasons of pixels that see no image of the screen.
BESIDE = (Reason.NO_IMAGE, Reason.SHADOW, Reason.DARK)


def near_edges(reason: NDArray[np.uint8]) -> Mask:
    """Valid pixels (row, col) that a lens's blur may mix with pixels that see no image of the screen."""
    beside = np.isin(reason, BESIDE).astype(np.uint8)
    side = 2 * BORDER_PX + 1
    return np.asarray(
        (cv2.dilate(beside, np.ones((side, side), np.uint8)) > 0) & (reason == Reason.OK)
    )


def mostly_outside(light: Floats, near: Mask) -> Mask:
    """Pixels near edges whose centre is off the mirror: they have less than half of the light (row, col) of those around."""
    lit = np.nan_to_num(light)
    return near & (lit < HALF * ndimage.maximum_filter(lit, 2 * BORDER_PX + 1))


def shift_px(light: Floats, noise: Floats, near: Mask, sensor: Sensor) -> Floats:
    """Right and down, (2, row, col) px: from a pixel's centre to that of its area that shows the screen.

    `light` is the modulation and `noise` its relative standard deviation, both (row, col). 0 away from edges.
    """
    slope = relative_slope(np.nan_to_num(light))
    with np.errstate(divide="ignore", invalid="ignore"):
        sure = 1.0 - (SURE * SOBEL * noise / np.hypot(*slope)) ** 2
    shift = blur_px2(sensor) * slope * np.sqrt(np.maximum(sure, 0.0))
    return np.where(near, np.nan_to_num(shift), 0.0)


def blur_px2(sensor: Sensor) -> float:
    """Variance per axis of a pixel's weights: its square, its lens's aberrations, and diffraction.

    Diffraction sends ``2 a / (pi^3 x^2)`` of the light of a line to a distance x (the cusp of its transfer function at 0, Goodman,
    Introduction to Fourier Optics, eq. 6-31), ``a = wavelength x f-number``, whose variance grows without end; it counts up to
    `BORDER_PX`.
    """
    if not isinstance(sensor, Emva):
        return SQUARE_PX2
    airy_px = sensor.wavelength_nm * 1e-3 * sensor.f_number / sensor.pixel_um
    diffraction = 4.0 / np.pi**3 * airy_px * BORDER_PX if sensor.psf == "diffraction" else 0.0
    return float(SQUARE_PX2 + (sensor.psf_sigma_um / sensor.pixel_um) ** 2 + diffraction)


def change_px(coordinate_px: Floats) -> Floats:
    """Change of a coordinate (row, col) per pixel to the right and down, (2, row, col), over the neighbours that are not NaN."""
    change = np.zeros((2, *coordinate_px.shape))
    for axis, result in ((1, change[0]), (0, change[1])):
        step = np.diff(coordinate_px, axis=axis)
        pad = [(0, 0), (0, 0)]
        sides = []
        for pad[axis] in ((0, 1), (1, 0)):
            sides.append(np.pad(step, pad, constant_values=np.nan))
        known = np.isfinite(sides)
        result[:] = np.where(known, sides, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return change
