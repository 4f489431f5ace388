"""The stages of an image sensor, from radiance to digital numbers: pure functions, in order.

EMVA Standard 1288, release 4.0, linear model: photons -> electrons (quantum efficiency, PRNU, dark current, shot noise)
-> full well -> non-linearity -> read, row and column noise and DSNU -> gain and black level -> rounding and clipping.
The simple sensor has Gaussian noise, rounding and clipping only.

The key of a frame's noise is (seed, exposure, frame): it is the same whether the frame is taken alone or with others, in
any order, on any number of threads. Within a frame noise follows pixel order, so that blocks taken in order equal the
whole frame.
"""

from dataclasses import dataclass
from enum import IntEnum, unique
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.sensor import Emva, Sensor, SimpleSensor

Floats = NDArray[np.float64]


@unique
class Stream(IntEnum):
    """Keys of the streams of random numbers: one per purpose."""

    FIXED_PATTERN = 0
    SHOT = 1
    READ = 2
    LINES = 3
    DEFECTS = 4
    FIXED_LINES = 5
    MOMENT = 6
    SPECKLE = 7


@dataclass(frozen=True)
class Noise:
    """Random streams of one frame of one exposure; drawing advances them."""

    shot: np.random.Generator
    read: np.random.Generator

    @classmethod
    def of(cls, seed: int, exposure: int, frame: int) -> "Noise":
        """The frame's streams at their start."""
        return cls(
            random_stream(seed, Stream.SHOT, exposure, frame),
            random_stream(seed, Stream.READ, exposure, frame),
        )


@dataclass(frozen=True)
class FixedPattern:
    """What differs between pixels, (pixel,), and is the same in every frame."""

    responsivity: NDArray[np.float32]
    """Relative, mean 1; 0 for dead pixels."""
    offset_e: NDArray[np.float32]
    """Mean 0."""
    dark_e_per_s: NDArray[np.float32] | None = None
    """Of hot pixels, on top of the sensor's."""

    def __getitem__(self, pixels: slice) -> "FixedPattern":
        dark = None if self.dark_e_per_s is None else self.dark_e_per_s[pixels]
        return FixedPattern(self.responsivity[pixels], self.offset_e[pixels], dark)


@dataclass(frozen=True)
class LineNoise:
    """Offsets in electrons that the pixels of a row or a column share in one frame."""

    row_e: Floats
    column_e: Floats

    @classmethod
    def of(
        cls, sensor: Sensor, seed: int, exposure: int, frame: int, shape: tuple[int, int]
    ) -> "LineNoise | None":
        """Of an image (rows, columns); None if the sensor has no such noise."""
        if isinstance(sensor, SimpleSensor) or not (sensor.row_noise_e or sensor.column_noise_e):
            return None
        rng = random_stream(seed, Stream.LINES, exposure, frame)
        row, column = (rng.standard_normal(n) for n in shape)
        return cls(sensor.row_noise_e * row, sensor.column_noise_e * column)

    def __getitem__(self, pixels: slice) -> Floats:
        """Of some pixels in row order."""
        row, column = np.divmod(np.arange(pixels.start, pixels.stop), len(self.column_e))
        return np.asarray(self.row_e[row] + self.column_e[column])


def fixed_pattern(sensor: Sensor, seed: int, shape: tuple[int, int]) -> FixedPattern | None:
    """What differs between the pixels of one chip of (rows, columns), in row order; None if nothing does.

    `seed` selects the chip.
    """
    if isinstance(sensor, SimpleSensor) or not (
        sensor.prnu
        or sensor.dsnu_e
        or sensor.dsnu_row_e
        or sensor.dsnu_column_e
        or sensor.hot_pixels
        or sensor.dead_pixels
    ):
        return None
    pixels = shape[0] * shape[1]
    rng = random_stream(seed, Stream.FIXED_PATTERN)
    responsivity = 1.0 + sensor.prnu * rng.standard_normal(pixels, dtype=np.float32)
    offset = sensor.dsnu_e * rng.standard_normal(pixels, dtype=np.float32)
    if sensor.dsnu_row_e or sensor.dsnu_column_e:
        rng = random_stream(seed, Stream.FIXED_LINES)
        row, column = (rng.standard_normal(n) for n in shape)
        lines = sensor.dsnu_row_e * row[:, None] + sensor.dsnu_column_e * column
        offset = offset + lines.ravel()
    dark = None
    rng = random_stream(seed, Stream.DEFECTS)
    if sensor.dead_pixels:
        responsivity[rng.random(pixels) < sensor.dead_pixels] = 0.0
    if sensor.hot_pixels:
        hot = rng.random(pixels) < sensor.hot_pixels
        dark = (hot * rng.exponential(sensor.hot_current_e_per_s, pixels)).astype(np.float32)
    return FixedPattern(
        np.maximum(responsivity, 0.0, dtype=np.float32), offset.astype(np.float32, copy=False), dark
    )


def digital_numbers(
    radiance: Floats,
    exposure_ms: float,
    sensor: Sensor,
    noise: Noise | None = None,
    pattern: FixedPattern | None = None,
    lines_e: Floats | None = None,
) -> NDArray[Any]:
    """Convert radiance in W/(m^2 sr) to DN; without `noise` each is its mean. `pattern` and `lines_e` (electrons) are
    of the same shape.
    """
    if isinstance(sensor, SimpleSensor):
        dn = sensor.mean_dn(radiance, exposure_ms)
        if noise and sensor.sigma_dn:
            dn += sensor.sigma_dn * noise.read.standard_normal(dn.shape, dtype=np.float32)
        return digitised(dn, sensor)
    electrons = mean_electrons(radiance, exposure_ms, sensor, pattern)
    if noise:
        electrons = with_shot_noise(electrons, sensor, noise.shot)
    electrons = sensor.read_charge(np.minimum(electrons, sensor.full_well_e))
    if noise:
        electrons = with_read_noise(electrons, sensor, noise.read)
    if pattern:
        electrons = electrons + pattern.offset_e
    if lines_e is not None:
        electrons = electrons + lines_e
    return digitised(sensor.black_level_dn + sensor.gain_dn_per_e * electrons, sensor)


def mean_electrons(
    radiance: Floats, exposure_ms: float, sensor: Emva, pattern: FixedPattern | None = None
) -> Floats:
    """Mean electrons of light (photons times quantum efficiency, PRNU applied) and of dark current (EMVA eqs. 3-5)."""
    if pattern is None:
        return sensor.mean_electrons(radiance, exposure_ms)
    electrons = sensor.mean_electrons(radiance * pattern.responsivity, exposure_ms)
    if pattern.dark_e_per_s is not None:
        electrons = electrons + pattern.dark_e_per_s * (exposure_ms * 1e-3)
    return electrons


def with_shot_noise(mean_e: Floats, sensor: Emva, rng: np.random.Generator) -> Floats:
    """Electrons drawn from Poisson's law, exactly (a normal approximation would save little time).

    Means far above the full well F are first lowered to ``F + 12 sqrt(F) + 100``, which still fills it: a draw falls
    d > 100 below that mean with probability below ``exp(-d^2 / (2 mean)) < exp(-50)`` (Chernoff).
    """
    well = sensor.full_well_e
    ceiling = well + 12.0 * np.sqrt(well) + 100.0
    # Rounding in the path tracer may leave a black pixel slightly below zero, where Poisson's law is undefined.
    return rng.poisson(np.clip(mean_e, 0.0, ceiling)).astype(np.float64)


def with_read_noise(electrons: Floats, sensor: Emva, rng: np.random.Generator) -> Floats:
    """Electrons plus Gaussian read noise, which comes after the full well."""
    if not sensor.read_noise_e:
        return electrons
    return electrons + sensor.read_noise_e * rng.standard_normal(electrons.shape, dtype=np.float32)


def digitised(dn: Floats, sensor: Sensor) -> NDArray[Any]:
    """Digital numbers rounded and clipped to the converter's range; unchanged for 0 bits."""
    if sensor.bits:
        np.clip(np.rint(dn, out=dn), 0.0, sensor.full_scale_dn, out=dn)
    return dn.astype(sensor.dtype)


def random_stream(seed: int, purpose: Stream, *key: int) -> np.random.Generator:
    """Random numbers of one purpose; other keys give independent ones."""
    return np.random.Generator(
        np.random.PCG64DXSM(np.random.SeedSequence(seed, spawn_key=(purpose, *key)))
    )
