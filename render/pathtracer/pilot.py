"""What paths that are traced say of the paths that are still needed: those of the pilot, and of either half."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.blur.point_spread import spread_kernel
from render.fringe_phasor import FinestFringe, direction, finest_fringes, white_weights
from render.light_noise import Mask, SensorNoise, sensor_noises, through
from render.pathtracer.block_light import BlockLight, Blocks, Images, scatter_about_direct
from render.pathtracer.path_budget import (
    COHERENT,
    KNOWING_PATHS,
    PILOT_PATHS,
    STANDARD_ERRORS,
    Pilot,
    paths_needed,
    smooth_indirect,
)
from render.transport import Transport

Floats = NDArray[np.float64]
Maker = Callable[[BlockLight, int], Transport]
"""Makes a transport of the light of blocks and the number of their paths."""

# The pilot knows a pixel's modulation only roughly: what misses the decoder's limits by so much may still be decoded.
SLACK = 2.0
# Fraction of the golden ratio: rounds fractions of blocks up in so many pixels as the fraction says, evenly spread.
GOLDEN = 0.6180339887498949


def first_pilot(
    light: BlockLight, blocks: Blocks, transport: Transport, lit: Mask
) -> tuple[Pilot, SensorNoise]:
    """What the pilot's own paths say, and which projectors and axes measure each pixel."""
    shape = transport.label.shape
    place, path = scatter_about_direct(light, blocks.number)
    place, path = (v.reshape(*v.shape[:3], *shape) for v in (place, path * PILOT_PATHS))
    return _pilot(transport, (blocks.number * blocks.paths).reshape(shape), place, path, lit)


def mean_images(light: BlockLight, shape: tuple[int, ...]) -> tuple[Images, Images, Images]:
    """Total, direct and ambient light, (..., row, col): the mean over a pixel's entries."""
    number = light.ambient.size // (shape[0] * shape[1])
    total, direct, ambient = (
        x.reshape(*x.shape[:-1], *shape, number).mean(-1)
        for x in (light.total, light.direct, light.ambient)
    )
    return total, direct, ambient


def more_of_halves(
    light: BlockLight,
    noise: tuple[Images, Images],
    blocks: Blocks,
    targets: dict[int, float],
    most_paths: int,
    lit: Mask,
    transport: Maker,
) -> NDArray[np.uint32]:
    """(entry,) how many more blocks each half gets, as the other half's light and its noise ask for.

    `noise` is the variance of the phase and of the modulation, (fringe, projector, entry).
    """
    more = np.zeros_like(blocks.number)
    for half in (0, 1):
        seen = _half(transport(_part(light, half), 1), noise, blocks, half, lit)
        more[1 - half :: 2] = _more(seen, targets, blocks, most_paths)
    return more


def _part(light: BlockLight, half: int) -> BlockLight:
    """One half of every pixel's blocks; without their phasors."""
    total, direct, ambient = (x[..., half::2] for x in (light.total, light.direct, light.ambient))
    return BlockLight(total, direct, ambient, light.phasor[..., :0])


def _half(
    transport: Transport, noise: tuple[Images, Images], blocks: Blocks, half: int, lit: Mask
) -> Pilot:
    """What one half's light says."""
    paths = (blocks.number * blocks.paths)[half::2].reshape(transport.label.shape)
    fringes = finest_fringes(transport.scene.patterns, transport.bases)
    phase, along = (v[..., half::2].reshape(*v.shape[:2], *paths.shape) for v in noise)
    power = np.stack([np.stack(_power(transport, fringe)) for fringe in fringes])
    path = np.stack([phase * power, along]) * paths
    return _pilot(transport, paths, np.zeros_like(path), path, lit)[0]


def _power(transport: Transport, fringe: FinestFringe) -> list[Floats]:
    """Square of each projector's modulation, (row, col)."""
    light = ((p, transport.total[p, : len(b.channels)]) for p, b in enumerate(transport.bases))
    return [(fringe.phasor(channels, p) ** 2).sum(axis=0) for p, channels in light]


def _more(
    other: Pilot, targets: dict[int, float], blocks: Blocks, most_paths: int
) -> NDArray[np.uint32]:
    """(pixel,) how many more blocks a half gets, as the other half asks for."""
    number, each = blocks.number[::2].astype(np.float64), 2.0 * blocks.paths[::2]
    have = (number * each).reshape(other.label.shape)
    wanted = paths_needed(other, targets, have, most_paths, STANDARD_ERRORS).ravel() / each
    wanted = np.floor(wanted - number + GOLDEN * np.arange(number.size) % 1.0)
    room = np.maximum(most_paths // each - number, 0.0)
    return np.clip(wanted, 0.0, room).astype(np.uint32)


def _pilot(
    transport: Transport, paths: NDArray[Any], place: Floats, path: Floats, lit: Mask
) -> tuple[Pilot, SensorNoise]:
    """What light of so many `paths` (row, col) says, and which projectors and axes measure each pixel.

    `place` and `path` are the variances that `Pilot` has, of every fringe and projector, (2, fringe, projector, row, col).
    """
    strict, slack = sensor_noises(transport, (1.0, SLACK), lit)
    scored = np.isfinite(strict.height_mm)
    sensor = SensorNoise(
        np.where(scored, strict.height_mm, slack.height_mm),
        np.where(scored, strict.mm_per_rad, slack.mm_per_rad),
        strict.fringe,
    )
    fringes = finest_fringes(transport.scene.patterns, transport.bases)
    known = paths / (paths + KNOWING_PATHS)
    kernel = spread_kernel(transport.scene.sensor)
    sharp, chip, smooth = [], [], []
    for p, b in enumerate(transport.bases):
        direct, total = (
            light[p, : len(b.channels)] for light in (transport.direct, transport.total)
        )
        fringe = fringes[sensor.fringe[p]]
        cosine, sine = (1.0 - known) * fringe.phasor(direct, p) + known * fringe.phasor(total, p)
        sharp.append(cosine + 1j * sine)
        white = np.tensordot(white_weights(b), total - direct, 1).astype(np.float64)
        smooth.append(smooth_indirect(white, transport.label))
        # What a lens blurs is the light of one projector.
        seen = sharp[p] if kernel is None else through(sharp[p], kernel)
        # Indirect light that is not known yet adds to the modulation, too.
        longer = np.hypot(np.abs(seen), (1.0 - known) * COHERENT * smooth[p][0])
        chip.append(direction(seen) * longer)
    places, each = (
        np.stack([part[:, f, p] for p, f in enumerate(sensor.fringe)], axis=1)
        for part in (place, path)
    )
    counts = sensor.mm_per_rad > 0.0
    counted = np.isfinite(sensor.height_mm) & np.isfinite(
        np.where(counts, places[0] + each[0], 0.0)
    ).all(axis=0)
    pilot = Pilot(
        transport.label,
        np.asarray(lit.any(axis=0)),
        counted & scored,
        counted,
        np.stack(sharp),
        np.stack(chip),
        sensor.mm_per_rad,
        kernel,
        (np.stack([one for one, _ in smooth]), np.stack([other for _, other in smooth])),
        sensor.height_mm,
        each,
        places,
    )
    return pilot, sensor
