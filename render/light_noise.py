"""Noise of light paths compared with the noise of the scene's sensor, in the phase of the finest fringe.

No real camera has the first; a simulation is good enough once it is well below the second.

Behind a lens a phasor adds up those of neighbours, noise and all. Pixels are independent, so variances add up with the
squares of the kernel's weights. A phasor has noise along itself and across it; only the latter turns it, but where a
neighbour's phase differs, its noise along becomes noise across. As a complex number of angle phi, noise d has
``E|d|^2 = along + across`` and ``E d^2 = (along - across + 2 i both) exp(2 i phi)``, `both` their covariance; these add up.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.blur.point_spread import blurred, spread_kernel
from render.chip_image import Image
from render.exposure_time import exposure_times_ms
from render.fringe_phasor import ANY_PHASE, FinestFringe, direction, finest_fringes, measuring_axis
from render.transport import Transport
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.scene import Scene
from scenes.support.errors import RenderError

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]

# Above this the decoder rejects a pixel as dark: eight standard deviations of noise in its modulation.
MOST_SENSOR_NOISE_RAD = 1 / 8
# The change of height that slopes are taken over.
SLOPE_MM = 1e-3
# Height per radian of phase is known from one pixel in so many, along rows and columns.
SPARSE = 8
# Where no exposure is free of saturation, pixels that miss the limit by this share of the decoder's slack count, too.
SATURATION_SLACK = 0.1


@dataclass(frozen=True, eq=False)
class SensorNoise:
    """What the sensor adds to the height, with the longest exposure that saturates no frame.

    The height is the mean of the projectors that can measure it, each weighted by 1 / variance, as decoding takes it.
    """

    height_mm: Floats
    """(row, col) standard deviation; NaN where no projector measures. Of screens, which measure slopes, of the phase, rad."""
    mm_per_rad: Floats
    """(projector, row, col) what the phase of each adds to the height; 0 where it does not measure."""
    fringe: tuple[int, ...]
    """Of each projector, the number of its measuring axis among `finest_fringes`."""

    def variance_mm2(self, phase_rad2: NDArray[np.floating]) -> Floats:
        """(row, col) variance of the height from those of phases, (fringe, projector, row, col); NaN where one is unknown."""
        own = np.stack([phase_rad2[fringe, p] for p, fringe in enumerate(self.fringe)])
        counts = self.mm_per_rad != 0.0
        own = np.where(counts, own, 0.0).astype(np.float64)
        return np.asarray(np.where(counts.any(axis=0), (self.mm_per_rad**2 * own).sum(0), np.nan))


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
    each_mm = np.stack([_flat_mm_per_rad(scene, p, fringes[f]) for p, f in enumerate(measuring)])
    found = []
    for slack, noise in zip(slacks, noises, strict=True):
        measures = (noise < slack * MOST_SENSOR_NOISE_RAD) & np.isfinite(each_mm)
        if lit is not None:
            measures &= lit
        precision = np.zeros_like(noise)
        precision[measures] = 1.0 / np.square(noise[measures] * each_mm[measures])
        whole = precision.sum(axis=0)
        some = whole > 0.0
        height = np.full(whole.shape, np.nan)
        height[some] = 1.0 / np.sqrt(whole[some])
        share = np.divide(precision, whole, out=np.zeros_like(precision), where=some)
        found.append(SensorNoise(height, np.where(measures, each_mm, 0.0) * share, measuring))
    return found


def _flat_mm_per_rad(scene: Scene, projector: int, fringe: FinestFringe) -> Floats:
    """`_mm_per_rad` in the middle of the working volume, where it changes so slowly that a few pixels know it."""
    camera = scene.camera.projection()
    pixel = camera.pixel_centres()[::SPARSE, ::SPARSE]
    point = camera.points_at(float(np.mean(scene.height_range_mm)), pixel)
    found = _mm_per_rad(scene, projector, fringe, point, pixel)
    whole = found.repeat(SPARSE, axis=0).repeat(SPARSE, axis=1)
    return whole[: camera.height, : camera.width]


def _mm_per_rad(
    scene: Scene, projector: int, fringe: FinestFringe, point_mm: Floats, pixel: Floats
) -> Floats:
    """(row, col) change of height that turns one projector's phase by 1 rad, at points (row, col, 3) that pixels (row, col, 2)
    see.

    1 with screens, which measure slopes; infinite where height does not move the fringes.
    """
    if scene.screens:
        return np.ones(point_mm.shape[:2])
    point = point_mm.reshape(-1, 3)
    camera, light = scene.camera.projection(), scene.projectors[projector].projection()
    _, ray = camera.rays(pixel.reshape(-1, 2))
    # Where the pixel's ray is a little higher.
    higher = point + SLOPE_MM / ray[:, 2:] * ray
    moved = light.project(higher)[0] - light.project(point)[0]
    px = np.abs(moved[:, ("column", "row").index(fringe.axis)]).reshape(point_mm.shape[:2])
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(SLOPE_MM * fringe.period_px / (2.0 * np.pi * px))


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
    """Root mean square of the light paths' noise over that of the sensor, in height, by label, over pixels of `lit`, which
    says what each projector lights, (projector, row, col).

    Labels without a pixel that can be measured are left out, as is everything if the noise of light is not known.
    """
    noise = None if transport.noise_rad is None else sensor_noise(transport, lit)
    if noise is None:
        return {}
    own = noise.variance_mm2(on_chip(transport) ** 2)
    known = np.isfinite(noise.height_mm) & np.isfinite(own)
    ratios = {}
    for number, label in enumerate(transport.labels, 1):
        at = known & (transport.label == number)
        if at.any():
            ratios[label] = float(np.sqrt(np.mean(own[at]) / np.mean(noise.height_mm[at] ** 2)))
    return ratios


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
    transport: Transport, xyz_mm: NDArray[np.float32], lit: Mask
) -> NDArray[np.float32] | None:
    """Standard deviation of height from light paths alone, mm (row, col), of the projectors that measure a pixel.

    Where none can, it is that of the projector that modulates it most. `xyz_mm` are the points that pixels see, (row, col, 3),
    and `lit` says which each projector lights, (projector, row, col), as `scenes.Truth` has both. None if the noise is not
    known, and with a screen, which measures slopes.
    """
    scene = transport.scene
    fringes = finest_fringes(scene.patterns, transport.bases)
    if transport.noise_rad is None or not fringes or scene.screens:
        return None
    axes = [fringe.axis for fringe in fringes]
    measuring = [measuring_axis(scene, axes, p) for p in range(len(transport.bases))]
    own, point = on_chip(transport), xyz_mm.astype(np.float64)
    pixel = scene.camera.projection().pixel_centres()
    heights, power = [], []
    for p, (f, basis) in enumerate(zip(measuring, transport.bases, strict=True)):
        heights.append(own[f, p] * _mm_per_rad(scene, p, fringes[f], point, pixel))
        channels = transport.total[p, : len(basis.channels)]
        power.append((fringes[f].phasor(channels, p) ** 2).sum(axis=0))
    best = np.argmax(power, axis=0)[None]
    picked: Floats = np.take_along_axis(np.stack(heights), best, axis=0)[0]
    if len(heights) > 1:
        # Light too dark for an exposure time is measured by none.
        with suppress(RenderError):
            noise = sensor_noise(transport, lit)
            assert noise is not None
            mean = np.sqrt(noise.variance_mm2(own**2))
            picked = np.where(np.isfinite(mean), mean, picked)
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


def weights(phasor: Complex, chip: Complex, mm_per_rad: Floats, kernel: Floats | None) -> Floats:
    """How much each pixel's variances across and along its phasors add to the sum of height variances, mm^2 / power.

    (2, projector, row, col). `phasor`, likewise without its first axis, are those of each projector's light, `chip` behind the
    lens; `mm_per_rad` is what a phase adds to a height that counts, 0 elsewhere. The kernel is None without a lens.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.where(mm_per_rad > 0.0, (mm_per_rad / np.abs(chip)) ** 2, 0.0)
    if kernel is None:
        return np.stack([own, np.zeros_like(own)])
    turned = own * direction(chip).conj() ** 2
    both, real, imaginary = _squared(np.stack([own, turned.real, turned.imag]), kernel)
    lean = (direction(phasor) ** 2 * (real + 1j * imaginary)).real
    return np.asarray(np.maximum([both + lean, both - lean], 0.0) / 2.0, np.float64)


def _squared(images: Floats, kernel: Floats) -> Floats:
    """Images blurred with the squares of the kernel's weights."""
    return blurred(images.astype(np.float32), kernel**2).astype(np.float64)
