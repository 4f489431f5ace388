"""The phase of one frame of fringes from its neighbourhood: the Fourier transform method.

The strongest peak of the frame's spectrum beyond the lowest frequencies is the carrier; what is near it, taken alone, is
``B exp(j phi) / 2`` (Takeda, Ina & Kobayashi, JOSA 72, 156 (1982)). Four steps of that phase are written in place of the frame.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from scenes.files.capture_frames import Shown, SingleShot
from scenes.support.errors import FileError

# Fringes across the image that a carrier must have, and how far above the spectrum's median it must be.
FEWEST_FRINGES, CLEAR = 4.0, 30.0
# Width of the filter, a Gaussian, as a share of the carrier's frequency: wider lets the offset in, narrower smooths heights.
WIDTH = 0.25


def expanded(
    frames: NDArray[Any], shown: Sequence[Shown], saturation_dn: float
) -> NDArray[np.float32]:
    """Frames (exposure, frame, row, col), float32, with four steps in place of each single shot.

    Raises `FileError` for a frame without a carrier.
    """
    made, at = [], 0
    for one in shown:
        if isinstance(one, SingleShot):
            made.append(np.stack([_steps(plane, one, saturation_dn) for plane in frames[:, at]]))
            at += 1
            continue
        count = len(one.frames())  # type: ignore[union-attr]
        made.append(frames[:, at : at + count].astype(np.float32))
        at += count
    return np.concatenate(made, axis=1)


def _steps(plane: NDArray[Any], shown: SingleShot, saturation_dn: float) -> NDArray[np.float32]:
    """Four steps (4, row, col), DN; saturated within a fringe of what is."""
    image = plane.astype(np.float64) if shown.axis == "column" else plane.T.astype(np.float64)
    rows, columns = image.shape
    # Mirrored borders, so that the right one does not meet the left one.
    pad = ((rows // 4,) * 2, (columns // 4,) * 2)
    wide = np.pad(image, pad, mode="reflect")
    spectrum = scipy.fft.fft2(wide - wide.mean())
    down, along = np.meshgrid(*(scipy.fft.fftfreq(n) for n in wide.shape), indexing="ij")
    window = np.hanning(rows)[:, None] * np.hanning(columns)
    power = np.abs(scipy.fft.fft2((image - image.mean()) * window))
    y, x = np.meshgrid(*(scipy.fft.fftfreq(n) for n in image.shape), indexing="ij")
    seen = (x * shown.direction * columns >= FEWEST_FRINGES) & (np.abs(x) >= np.abs(y))
    power = np.where(seen, power, 0.0)
    peak = np.unravel_index(int(power.argmax()), power.shape)
    if power[peak] < CLEAR * np.median(power[power > 0.0]):
        raise FileError(
            f"a single shot of {shown.period_px:g} px shows no carrier of {FEWEST_FRINGES:g} fringes or more along its "
            f"{shown.axis}s: check axis, direction and the order of files"
        )
    f, g = float(x[peak]), float(y[peak])
    width = WIDTH * float(np.hypot(f, g))
    near = np.exp(-0.5 * ((along - f) ** 2 + (down - g) ** 2) / width**2)
    inside = np.s_[pad[0][0] : pad[0][0] + rows, pad[1][0] : pad[1][0] + columns]
    phasor = 2.0 * scipy.fft.ifft2(spectrum * near)[inside]
    level = ndimage.gaussian_filter(image, 0.5 / np.hypot(f, g), mode="reflect")
    reach = int(np.ceil(1.0 / np.hypot(f, g)))
    whole = np.zeros(image.shape, bool)
    whole[reach:-reach, reach:-reach] = True
    # What a border fringe would be beyond the image is not known.
    steps = np.stack([level + np.where(whole, (phasor * 1j**k).real, 0.0) for k in range(4)])
    clipped = ndimage.maximum_filter(image, reach) >= saturation_dn
    steps = np.where(
        clipped,
        max(saturation_dn, float(steps.max())),
        np.minimum(steps, np.nextafter(saturation_dn, 0.0)),
    )
    return (steps if shown.axis == "column" else steps.swapaxes(1, 2)).astype(np.float32)
