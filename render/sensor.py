"""Radiance becomes digital numbers: the stages of an image sensor, pure and in order.

EMVA Standard 1288, release 4.0, linear model: photons -> electrons (quantum efficiency, PRNU, dark current, shot noise)
-> full well -> read noise and DSNU -> gain and black level -> rounding and clipping. The simple sensor has the last two
and Gaussian noise.

Noise is keyed by (seed, exposure, frame): a frame's noise is the same whether it is taken alone or with others, in
whatever order and on however many threads; and by pixel order within the frame, so blocks of a frame in order equal
the whole frame.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.sensor import Emva, Sensor, SimpleSensor

Floats = NDArray[np.float64]

# What a stream of random numbers is for: no two purposes share one.
_FIXED_PATTERN, _SHOT, _READ = range(3)


@dataclass(frozen=True)
class Noise:
    """The random streams of one frame of one exposure; drawing from them advances them."""

    shot: np.random.Generator
    read: np.random.Generator

    @classmethod
    def of(cls, seed: int, exposure: int, frame: int) -> "Noise":
        """The streams of that frame, from their start."""
        return cls(_stream(seed, _SHOT, exposure, frame), _stream(seed, _READ, exposure, frame))


@dataclass(frozen=True)
class FixedPattern:
    """What differs from pixel to pixel and stays: relative responsivity (mean 1) and offset in electrons (mean 0)."""

    responsivity: NDArray[np.float32]
    offset_e: NDArray[np.float32]

    def __getitem__(self, pixels: slice) -> "FixedPattern":
        return FixedPattern(self.responsivity[pixels], self.offset_e[pixels])


def fixed_pattern(sensor: Sensor, seed: int, pixels: int) -> FixedPattern | None:
    """The chip of that seed: PRNU and DSNU of so many pixels in row order, or None where the sensor has neither."""
    if isinstance(sensor, SimpleSensor) or not (sensor.prnu or sensor.dsnu_e):
        return None
    rng = _stream(seed, _FIXED_PATTERN)
    responsivity = 1.0 + sensor.prnu * rng.standard_normal(pixels, dtype=np.float32)
    offset = sensor.dsnu_e * rng.standard_normal(pixels, dtype=np.float32)
    return FixedPattern(
        np.maximum(responsivity, 0.0, dtype=np.float32), offset.astype(np.float32, copy=False)
    )


def digital_numbers(
    radiance: Floats,
    exposure_ms: float,
    sensor: Sensor,
    noise: Noise | None = None,
    pattern: FixedPattern | None = None,
) -> NDArray[Any]:
    """Digital numbers (same shape, the sensor's dtype) of radiance in W/(m^2 sr); without `noise`, their means.

    `pattern` must have the shape of `radiance`.
    """
    if isinstance(sensor, SimpleSensor):
        dn = sensor.mean_dn(radiance, exposure_ms)
        if noise and sensor.sigma_dn:
            dn += sensor.sigma_dn * noise.read.standard_normal(dn.shape, dtype=np.float32)
        return digitised(dn, sensor)
    electrons = mean_electrons(radiance, exposure_ms, sensor, pattern)
    if noise:
        electrons = with_shot_noise(electrons, sensor, noise.shot)
    electrons = np.minimum(electrons, sensor.full_well_e)
    if noise:
        electrons = with_read_noise(electrons, sensor, noise.read)
    if pattern:
        electrons = electrons + pattern.offset_e
    return digitised(sensor.black_level_dn + sensor.gain_dn_per_e * electrons, sensor)


def mean_electrons(
    radiance: Floats, exposure_ms: float, sensor: Emva, pattern: FixedPattern | None = None
) -> Floats:
    """Mean electrons of light (photons times quantum efficiency, PRNU applied) and of dark current (EMVA eqs. 3-5)."""
    if pattern:
        radiance = radiance * pattern.responsivity
    return sensor.mean_electrons(radiance, exposure_ms)


def with_shot_noise(mean_e: Floats, sensor: Emva, rng: np.random.Generator) -> Floats:
    """Electrons drawn from Poisson's law, exactly (no normal approximation: it saves little).

    Means far above the full well are first lowered to one that still fills it: below ``F + 12 sqrt(F) + 100`` lies the
    full well F by d > 100 with ``exp(-d^2 / (2 mean)) < exp(-50)`` (Chernoff), so no draw ever tells the difference.
    """
    well = sensor.full_well_e
    ceiling = well + 12.0 * np.sqrt(well) + 100.0
    # A path tracer's rounding may leave a black pixel a hair below zero, which has no Poisson law.
    return rng.poisson(np.clip(mean_e, 0.0, ceiling)).astype(np.float64)


def with_read_noise(electrons: Floats, sensor: Emva, rng: np.random.Generator) -> Floats:
    """Electrons plus the Gaussian noise of the read-out, which comes after the full well."""
    if not sensor.read_noise_e:
        return electrons
    return electrons + sensor.read_noise_e * rng.standard_normal(electrons.shape, dtype=np.float32)


def digitised(dn: Floats, sensor: Sensor) -> NDArray[Any]:
    """Digital numbers rounded and clipped to the converter's range, or as they are where it has 0 bits."""
    if sensor.bits:
        np.clip(np.rint(dn, out=dn), 0.0, sensor.full_scale_dn, out=dn)
    return dn.astype(sensor.dtype)


def _stream(seed: int, *key: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64DXSM(np.random.SeedSequence(seed, spawn_key=key)))
