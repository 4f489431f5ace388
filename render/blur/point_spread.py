"""The camera's point-spread function: diffraction and a Gaussian, on images of whole pixels.

A traced image L is radiance averaged over each pixel's square, so the pixel's own aperture is in it already. The lens
should blur the light before that average, but convolutions commute: it is applied to L itself. Between pixel centres L is
unknown and interpolated by Keys' cubic, whose transfer is flat where the pixel grid resolves, so that interpolation adds no
blur to speak of (linear interpolation would count an aperture more).

What varies inside a pixel is lost in its average, and no blur between pixels brings it back. The response to a sharp edge
is therefore off by up to 3.5 % of the edge in the two pixels next to it, depending on where in its pixel the edge is, and
less at f/11 and slower. Another kernel would gain little: the best that any reaches, by linear programming over the places
of the edge, is 2.2 % at f/2.8, 2.5 % at f/8, 1.8 % at f/11, 0.9 % at f/16, where this one has 3.2, 3.2, 2.2 and 1.1 %. Light
traced at n times the resolution (`subpixels` of `render.expose`) is off by less than 1 % at n = 2 from f/8, at n = 4 from
f/2.8.
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from render.blur.image_borders import Complex, continued, margins_of
from scenes.acquisition.sensor import Emva, Sensor
from scenes.support import mapped

Floats = NDArray[np.float64]

# Pixels that the kernel reaches along each axis. Beyond, diffraction at f/8 sends 0.1 % of the light.
REACH = 256
# Cycles per pixel up to which the transfer is integrated: far into the interpolation's stopband.
FINEST = 4.0
# Of images with so many pixels at most, factors of the transform are kept: planning render noise blurs some fifty times.
MOST_KEPT = 1 << 20
# Sensors so small or lenses so slow that arithmetic would overflow blur everything alike.
TINY = 1e-9


def spread_kernel(sensor: Sensor, subpixels: int = 1) -> Floats | None:
    """One quadrant of the kernel that blurs an image with `subpixels` pixels along a sensor pixel's side; None: no
    blur.

    Weights (row offset, column offset), from 0 to `REACH`; those of the whole kernel sum to 1. It is the transform of
    ``OTF(|f|) exp(-2 pi^2 s^2 |f|^2) K(f_x) K(f_y)``: OTF is that of a circular pupil (Goodman, Introduction to Fourier
    Optics, eq. 6-31), s the Gaussian's standard deviation, K the transfer of Keys' interpolation. Lobes below zero, at
    most 0.4 % (the cubic's, at fast lenses), are cut off: light is not negative.
    """
    if not isinstance(sensor, Emva) or not sensor.blurs:
        return None
    pitch_um = sensor.pixel_um / subpixels
    cutoff = lens_cutoff(sensor, pitch_um) if sensor.psf == "diffraction" else np.inf
    sigma_px = min(sensor.psf_sigma_um / pitch_um, 1.0 / TINY)
    # A Gaussian's transfer is below 1e-12 beyond 1.2 cycles per standard deviation.
    finest = min(cutoff, FINEST, 1.2 / max(sigma_px, TINY))
    count = int(np.ceil(2 * REACH * finest)) + 1
    f = np.arange(count) / (2.0 * REACH)
    along = keys_transfer(f) * np.exp(-2.0 * (np.pi * sigma_px * f) ** 2)
    transfer = along[:, None] * along * diffraction_transfer(np.hypot(f[:, None], f), cutoff)
    cosine = np.cos(np.pi / REACH * np.outer(np.arange(REACH + 1), np.arange(count)))
    cosine[:, 0] /= 2.0
    kernel = np.maximum(_between(cosine, transfer, cosine), 0.0)
    both = _both_sides(REACH + 1)
    quadrant: Floats = kernel / (np.multiply.outer(both, both) * kernel).sum()
    return quadrant


def lens_cutoff(sensor: Emva, pitch_um: float) -> float:
    """Highest frequency that the lens transmits, in cycles per `pitch_um`; kept where arithmetic stays finite."""
    airy_um = max(sensor.wavelength_nm * 1e-3 * sensor.f_number, TINY)
    return min(max(pitch_um / airy_um, TINY), 1.0 / TINY)


def diffraction_transfer(frequency: Floats, cutoff: float) -> Floats:
    """Modulation that a circular pupil leaves at a frequency, in the units of `cutoff` = 1 / (wavelength x f-number)."""
    s = np.minimum(frequency / cutoff, 1.0)
    return np.asarray(2.0 / np.pi * (np.arccos(s) - s * np.sqrt(1.0 - s * s)))


def keys_transfer(frequency: Floats) -> Floats:
    """Transfer of Keys' cubic interpolation (a = -1/2) at cycles per sample.

    R. G. Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. ASSP 29 (1981).
    """
    w2 = (2.0 * np.pi * np.where(frequency > 0.0, frequency, 1.0)) ** 2
    one, two, four = (np.sinc(k * frequency) for k in (1, 2, 4))
    value = 12.0 / w2 * (one**2 - two) - 4.0 / w2 * (3.0 * two**2 - 2.0 * two - four)
    return np.where(frequency > 0.0, value, 1.0)


def blurred(
    images: NDArray[np.float32], kernel: Floats, fringes: Sequence[Complex] = (), subpixels: int = 1
) -> NDArray[np.float32]:
    """Images (..., row, col) convolved with the kernel of `spread_kernel`; a new array of the same shape.

    At its borders an image is continued by its mirror image, so that the sum over it, the photons, stays what it was. Of images
    (projector, channel, row, col), `fringes` are the `fringe_terms` of each projector; they continue with their phase instead
    (`render.blur.image_borders`): light that leaves is not what enters. `subpixels` are those of `spread_kernel`.
    """
    rows, columns = images.shape[-2:]
    what = f"blurred light of {columns} x {rows} pixels"
    result = mapped.array(
        images.shape, np.float32, what, "lower camera.resolution, or set sensor.psf to none"
    )
    transfer = _transfer(images.shape[-2:], kernel)
    alone = set(np.ndindex(images.shape[:-2]))
    down, across = margins_of(rows, columns, subpixels)
    for p, terms in enumerate(fringes):
        used = np.flatnonzero(np.any(terms != 0.0, axis=0))
        if not used.size:
            continue
        inside = slice(down, down + rows), slice(across, across + columns)
        wider = _transfer((rows + 2 * down, columns + 2 * across), kernel)
        wider_images = continued(images[p, used], terms[:, used], (down, across))
        for channel, wide in zip(used, wider_images, strict=True):
            result[p, channel] = _multiplied(wide, wider)[inside]
            alone.remove((p, int(channel)))
    for index in alone:
        result[index] = _multiplied(images[index], transfer)
    return result


def _transfer(shape: tuple[int, ...], kernel: Floats) -> Floats:
    """Factors of an image's cosine transform: its symmetry is the mirror, and the kernel is symmetric, too."""
    make = _made_transfer if shape[0] * shape[1] <= MOST_KEPT else _made_transfer.__wrapped__
    return make(shape, kernel.shape, kernel.tobytes())


@lru_cache(maxsize=6)
def _made_transfer(shape: tuple[int, ...], reach: tuple[int, ...], kernel: bytes) -> Floats:
    down, across = (_waves(n, reach[0]) for n in shape)
    return _between(down, np.frombuffer(kernel).reshape(reach), across)


def _multiplied(image: NDArray[np.float32], transfer: Floats) -> Floats:
    if not image.any():
        return np.zeros(image.shape)
    waves = fft.dctn(image.astype(np.float64), overwrite_x=True)
    waves *= transfer
    blurred: Floats = fft.idctn(waves, overwrite_x=True)
    return blurred


def binned(images: NDArray[np.float32], subpixels: int) -> NDArray[np.float32]:
    """Images (..., row, col) averaged over squares of that many pixels a side."""
    rows, columns = (n // subpixels for n in images.shape[-2:])
    squares = images.reshape(*images.shape[:-2], rows, subpixels, columns, subpixels)
    mean: NDArray[np.float32] = squares.mean(axis=(-3, -1), dtype=np.float32)
    return mean


def _between(left: Floats, middle: Floats, right: Floats) -> Floats:
    """``left @ middle @ right.T`` to the same bits for any number of threads, which BLAS does not promise."""
    product: Floats = np.einsum("il,jl->ij", np.einsum("ik,kl->il", left, middle), right)
    return product


def _waves(size: int, reach: int) -> Floats:
    """Transfer of a pair of unit weights at each offset, (wave of the cosine transform, offset)."""
    waves: Floats = np.cos(np.pi / size * np.outer(np.arange(size), np.arange(reach)))
    return waves * _both_sides(reach)


def _both_sides(reach: int) -> Floats:
    """How often each offset from 0 occurs in a symmetric kernel."""
    return np.where(np.arange(reach) > 0, 2.0, 1.0)
