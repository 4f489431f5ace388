"""Noise of light paths compared with the noise of the scene's sensor, in the phase of the finest fringe.

No real camera has the first; a simulation is good enough once it is well below the second.

Behind a lens a phasor adds up those of neighbours, noise and all. Pixels are independent, so variances add up with the
squares of the kernel's weights. A phasor has noise along itself and across it; only the latter turns it, but where a
neighbour's phase differs, its noise along becomes noise across. As a complex number of angle phi, noise d has
``E|d|^2 = along + across`` and ``E d^2 = (along - across + 2 i both) exp(2 i phi)``, `both` their covariance; these add up.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.blur.point_spread import blurred, spread_kernel
from render.chip_image import Image
from render.exposure_time import exposure_times_ms
from render.fringe_phasor import ANY_PHASE, FinestFringe, direction, finest_fringes, measuring_axis
from render.transport import Transport
from scenes.acquisition.fringe_fit import STRAY_FRACTION

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

# Above this the decoder rejects a pixel as dark: eight standard deviations of noise in its modulation.
MOST_SENSOR_NOISE_RAD = 1 / 8
# The change of height that slopes are taken over.
SLOPE_MM = 1e-3
# Where no exposure is free of saturation, pixels that miss the limit by this share of the decoder's slack count, too.
SATURATION_SLACK = 0.1


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """What the sensor adds to the phase that measures height, with the longest exposure that saturates no frame."""

    phase_rad: Floats
    """(row, col) standard deviation, of the projector that has the smallest; NaN where none can measure it."""
    projector: NDArray[np.intp]
    """(row, col) number of that projector."""
    fringe: tuple[int, ...]
    """Of each projector, the number of its measuring axis among `finest_fringes`."""


def sensor_noise(transport: Transport, lit: Mask | None = None) -> SensorNoise | None:
    """Noise of the scene's own sensor and exposures on this light; None for patterns without fringes.

    `lit` says which pixels each projector lights, (projector, row, col); only these it measures. None: all of them.

    Raises `RenderError` where the exposure time cannot be found.
    """
    return next(iter(sensor_noises(transport, (1.0,), lit)), None)


def sensor_noises(
    transport: Transport, slacks: Sequence[float], lit: Mask | None = None
) -> list[SensorNoise]:
    """`sensor_noise` with each slack: above 1 also for pixels that miss the decoder's limits by that factor; none without
    fringes."""
    fringes = finest_fringes(transport.scene.patterns, transport.bases)
    if not fringes:
        return []
    image = Image.of(transport, transport.scene.sensor)
    scene = transport.scene
    shown = [(p, row) for p, basis in enumerate(transport.bases) for row in basis.weights]
    times = exposure_times_ms(image, transport.labels, shown, scene.exposures, scene.sensor)
    axes = [fringe.axis for fringe in fringes]
    measuring = tuple(measuring_axis(transport.scene, axes, p) for p in range(len(transport.bases)))
    noises = np.stack(
        [
            _phase_noise(transport, image, p, fringes[f], times, slacks)
            for p, f in enumerate(measuring)
        ],
        axis=1,
    )
    found = []
    for slack, noise in zip(slacks, noises, strict=True):
        if lit is not None:
            noise[~lit] = np.inf
        best = np.argmin(noise, axis=0)
        smallest = np.take_along_axis(noise, best[None], axis=0)[0]
        smallest[~(smallest < slack * MOST_SENSOR_NOISE_RAD)] = np.nan
        found.append(SensorNoise(smallest, best, measuring))
    return found


def _phase_noise(
    transport: Transport,
    image: Image,
    projector: int,
    fringe: FinestFringe,
    times_ms: tuple[float, ...],
    slacks: Sequence[float],
) -> Floats:
    """(slack, row, col) standard deviation of one projector's phase, rad; infinite where it cannot be measured."""
    sensor = transport.scene.sensor
    basis = transport.bases[projector]
    weights = basis.weights[list(fringe.frames)]
    channels = image.light[projector, : len(basis.channels)]
    radiance = np.einsum("fc,c...->f...", weights.astype(np.float32), channels) + image.ambient
    result = np.full((len(slacks), *image.ambient.shape), np.inf)
    cosine, sine = fringe.phasor(channels, projector)
    modulation = np.hypot(cosine, sine)
    shows = modulation > 0.0
    if not shows.any():
        return result
    typical = np.median(modulation[shows])
    shows &= modulation >= STRAY_FRACTION / max(slacks) * typical
    cosine, sine, modulation = cosine[shows], sine[shows], modulation[shows]
    found = np.full((len(slacks), modulation.size), np.inf)
    radiance = radiance[:, shows].astype(np.float64)
    # d phase / d sample, times the modulation.
    along = (
        np.multiply.outer(fringe.solve[1], cosine) - np.multiply.outer(fringe.solve[0], sine)
    ) / modulation
    for number, time_ms in enumerate(sorted(times_ms)):
        mean = sensor.mean_dn(radiance, time_ms)
        gain = float(sensor.mean_dn(1.0, time_ms) - sensor.mean_dn(0.0, time_ms))
        variance = (along**2 * sensor.variance_dn2(mean, time_ms)).sum(axis=0)
        noise = np.sqrt(variance) / (gain * modulation)
        brightest = mean.max(axis=0)
        for own, slack in zip(found, slacks, strict=True):
            most = sensor.saturation_dn * (
                1.0 if number else 1.0 + SATURATION_SLACK * (slack - 1.0)
            )
            good = (brightest < most) & (modulation >= STRAY_FRACTION / slack * typical)
            own[good] = noise[good]
    result[:, shows] = found
    return result


def render_to_sensor_noise(transport: Transport, lit: NDArray[np.bool_]) -> Mapping[str, float]:
    """Root mean square of the light paths' noise over that of the sensor, by label, over pixels of `lit`, which says what
    each projector lights, (projector, row, col).

    Labels without a pixel that can be measured are left out, as is everything if the noise of light is not known.
    """
    noise = None if transport.noise_rad is None else sensor_noise(transport, lit)
    if noise is None:
        return {}
    assert transport.noise_rad is not None
    own = chosen(on_chip(transport), noise)
    known = np.isfinite(noise.phase_rad) & np.isfinite(own)
    ratios = {}
    for number, label in enumerate(transport.labels, 1):
        at = known & (transport.label == number)
        if at.any():
            square = np.mean(own[at] ** 2) / np.mean(noise.phase_rad[at] ** 2)
            ratios[label] = float(np.sqrt(square))
    return ratios


def chosen(images: NDArray[np.floating], noise: SensorNoise) -> Floats:
    """(row, col) of images (fringe, projector, row, col): of the projector and the axis that measure each pixel."""
    own = np.stack([images[fringe, p] for p, fringe in enumerate(noise.fringe)])
    picked: Floats = np.take_along_axis(own, noise.projector[None], axis=0)[0].astype(np.float64)
    return picked


def on_chip(transport: Transport) -> NDArray[np.float32]:
    """The transport's `noise_rad` behind the sensor's lens, (fringe, projector, row, col).

    Of old files, which know only the noise of the phase, noise along the phasor counts as much as noise across it.
    """
    assert transport.noise_rad is not None
    kernel = spread_kernel(transport.scene.sensor)
    if kernel is None:
        return transport.noise_rad
    result = np.empty_like(transport.noise_rad)
    for f, fringe in enumerate(finest_fringes(transport.scene.patterns, transport.bases)):
        for p, basis in enumerate(transport.bases):
            cosine, sine = fringe.phasor(transport.total[p, : len(basis.channels)], p)
            across = along = np.nan_to_num(transport.noise_rad[f, p] * np.hypot(cosine, sine))
            if transport.amplitude_noise is not None:
                along = np.nan_to_num(transport.amplitude_noise[f, p].astype(np.float64))
            both = np.zeros_like(along)
            if transport.noise_correlation is not None:
                both = transport.noise_correlation[f, p] * along * across
            phasor = cosine + 1j * sine
            result[f, p] = np.sqrt(phase_variance(phasor, across**2, along**2, both, kernel))
    return result


def height_noise_mm(
    transport: Transport, xyz_mm: NDArray[np.float32]
) -> NDArray[np.float32] | None:
    """Standard deviation of height from light paths alone, mm (row, col), of the projector that modulates a pixel most.

    `xyz_mm` are the points that pixels see, (row, col, 3), as `scenes.Truth` has them. None if the noise is not known, and with
    a screen, which measures slopes.
    """
    scene = transport.scene
    fringes = finest_fringes(scene.patterns, transport.bases)
    if transport.noise_rad is None or not fringes or scene.screens:
        return None
    noise = on_chip(transport)
    camera = scene.camera.projection()
    point = xyz_mm.reshape(-1, 3).astype(np.float64)
    _, direction = camera.rays(camera.pixel_centres().reshape(-1, 2))
    # Where the pixel's ray is a little higher.
    higher = point + SLOPE_MM / direction[:, 2:] * direction
    axes = [fringe.axis for fringe in fringes]
    heights, power = [], []
    for p, basis in enumerate(transport.bases):
        chosen_axis = measuring_axis(scene, axes, p)
        fringe = fringes[chosen_axis]
        projector = scene.projectors[p].projection()
        moved = projector.project(higher)[0] - projector.project(point)[0]
        px_per_mm = moved[:, ("column", "row").index(fringe.axis)].reshape(xyz_mm.shape[:2])
        px_per_mm /= SLOPE_MM
        with np.errstate(divide="ignore", invalid="ignore"):
            heights.append(
                noise[chosen_axis, p] * fringe.period_px / (2.0 * np.pi * np.abs(px_per_mm))
            )
        channels = transport.total[p, : len(basis.channels)]
        power.append((fringe.phasor(channels, p) ** 2).sum(axis=0))
    best = np.argmax(power, axis=0)[None]
    picked: NDArray[np.float32] = np.take_along_axis(np.stack(heights), best, axis=0)[0]
    return picked.astype(np.float32)


def through(phasor: Complex, kernel: Floats) -> Complex:
    """Phasors (row, col) behind a lens with the kernel of `spread_kernel`."""
    parts = np.stack([phasor.real, phasor.imag]).astype(np.float32)
    real, imaginary = blurred(parts[None], kernel, [np.array([[1.0, 1.0j]])])[0]
    return np.asarray(real + 1j * imaginary, np.complex128)


def phase_variance(
    phasor: Complex, across: Floats, along: Floats, both: Floats, kernel: Floats
) -> Floats:
    """Variance of the phase behind the lens, rad^2 (row, col), of phasors with these variances and covariance before it."""
    chip = through(phasor, kernel)
    own = (along - across + 2j * both) * direction(phasor) ** 2
    whole, real, imaginary = _squared(np.stack([along + across, own.real, own.imag]), kernel)
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = (direction(chip).conj() ** 2 * (real + 1j * imaginary)).real
        variance: Floats = (whole - turned) / (2.0 * np.abs(chip) ** 2)
    return np.clip(variance, 0.0, ANY_PHASE)


def weights(phasor: Complex, chip: Complex, counted: Mask, kernel: Floats | None) -> Floats:
    """How much each pixel's variances across and along its phasors add to the sum of phase variances of the `counted` pixels.

    (2, projector, row, col), in 1 / power. `phasor` and `counted`, (projector, row, col), are of light that each projector
    measures by, `chip` (row, col) the phasors behind the lens; the kernel is None without one.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.where(counted, 1.0 / np.abs(chip) ** 2, 0.0)
    if kernel is None:
        return np.stack([own, np.zeros_like(own)])
    turned = own * direction(chip).conj() ** 2
    both, real, imaginary = _squared(np.stack([own, turned.real, turned.imag]), kernel)
    lean = (direction(phasor) ** 2 * (real + 1j * imaginary)).real
    return np.maximum([both + lean, both - lean], 0.0) / 2.0


def _squared(images: Floats, kernel: Floats) -> Floats:
    """Images blurred with the squares of the kernel's weights."""
    return blurred(images.astype(np.float32), kernel**2).astype(np.float64)
