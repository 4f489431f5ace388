"""Speckle of lasers and narrow LEDs: a grain on the chip that multiplies the projector's light and displaces it.

Coherent light that a rough surface scatters interferes in the lens's Airy disc. On the chip the sum fluctuates with a
contrast C, which the source gives (`speckle_contrast`: 1 for a polarised laser, ``1 / sqrt(M)`` for M independent patterns),
and with the lens's correlation ``(2 J1(v) / v)^2``, ``v = pi r / (wavelength x f-number)``: its spectrum is the lens's
transfer function. A pixel averages it over its square.

All frames share one pattern, so that it cancels in a fringe's phase. What remains is that the light of a point appears
displaced, by ``C wavelength / (2 pi sin u)``, with ``sin u = 1 / (2 f-number)`` on the chip: R. G. Dorsch, G. Haeusler, J. M.
Herrmann, Laser triangulation: fundamental uncertainty in distance measurement, Applied Optics 33 (1994).

Stated, not derived: the contrast follows a gamma distribution (J. W. Goodman, Speckle Phenomena in Optics, section 3.3); the
displacement is Gaussian, as correlated as the contrast, independent of it; indirect light has as much as direct light.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import gammaincinv, ndtr

from render.blur.point_spread import diffraction_transfer, lens_cutoff
from render.chip_image import Image
from render.sensor_stages import Stream, random_stream
from scenes.acquisition.sensor import Emva
from scenes.scene import Scene
from scenes.support import mapped
from scenes.support.errors import RenderError

Floats = NDArray[np.float64]

# Cutoff in cycles per pixel beyond which every pixel has many grains, and its mean is independent of its neighbours'.
FINEST = 8.0


def speckled(image: Image, scene: Scene, seed: int) -> Image:
    """Light on the chip with the speckle of every projector that has some.

    Raises
    ------
    RenderError
        For a sensor without a lens.
    """
    sensor = scene.sensor
    if not isinstance(sensor, Emva):
        raise RenderError(
            "speckle_contrast needs a lens: the 'simple' sensor has none; set sensor.kind to emva1288, or "
            "speckle_contrast to 0"
        )
    what = "light with speckle"
    light = mapped.array(image.light.shape, np.float32, what, "lower camera.resolution")
    for p, projector in enumerate(scene.projectors):
        light[p] = image.light[p]
        if not projector.speckle_contrast:
            continue
        rng = random_stream(seed, Stream.SPECKLE, p)
        gain, down, right = speckle(sensor, projector.speckle_contrast, image.shape, rng)
        for channel in light[p]:
            dy, dx = (
                np.gradient(channel, axis=axis) if channel.shape[axis] > 1 else 0.0
                for axis in (0, 1)
            )
            channel[:] = gain * (channel + down * dy + right * dx)
    slope = image.slope and speckled(image.slope, scene, seed)
    return replace(image, light=light, slope=slope)


def speckle(
    sensor: Emva, contrast: float, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Gain, mean 1, and displacement in pixels down and to the right, each (row, col), of one pattern on the chip."""
    cutoff = lens_cutoff(sensor, sensor.pixel_um)
    spectrum = speckle_spectrum(sensor, shape)
    kept = float(np.sqrt(spectrum.mean()))
    waves = fft.rfft2(rng.standard_normal((3, *shape)))
    waves *= np.sqrt(spectrum[:, : waves.shape[-1]]) / max(kept, 1e-12)
    fields = fft.irfft2(waves, shape)
    patterns = 1.0 / max(contrast * kept, 1e-6) ** 2
    gain = gammaincinv(patterns, ndtr(fields[0])) / patterns
    displaced = contrast * kept / (np.pi * cutoff) * fields[1:]
    return gain, displaced[0], displaced[1]


def speckle_spectrum(sensor: Emva, shape: tuple[int, int]) -> Floats:
    """Power of a pattern of contrast 1 averaged over pixels, at the waves of an image's transform; its mean is the variance.

    The transfer of a circular pupil with the cutoff c has the integral ``pi c^2 / 4``. Waves beyond half a cycle per pixel
    appear as slower ones.
    """
    cutoff = lens_cutoff(sensor, sensor.pixel_um)
    density = 4.0 / (np.pi * cutoff**2)
    if cutoff > FINEST:
        return np.full(shape, density)
    down, across = (np.fft.fftfreq(n) for n in shape)
    power = np.zeros(shape)
    orders = np.arange(-int(np.ceil(cutoff)), int(np.ceil(cutoff)) + 1)
    for i in orders:
        for j in orders:
            y, x = (down + i)[:, None], across + j
            squares = np.sinc(y) ** 2 * np.sinc(x) ** 2
            power += squares * diffraction_transfer(np.hypot(y, x), cutoff)
    # Grains wider than the image are fewer than the number of its waves suggests.
    return density * power / max(float(density * power.mean()), 1.0)
