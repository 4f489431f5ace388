"""What light from vertices deeper than a trace follows would do to the phase: its error that no scatter shows.

Some pixels of a pilot are traced once more with the same random numbers and more vertices. What differs, block by block, is
exactly the light that the depth cuts off. Its square averaged over blocks would be mostly noise; products of two different
blocks are not, on average (a U-statistic).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from render.light_noise import SensorNoise
from render.pathtracer.block_light import BlockLight, Blocks
from render.pathtracer.path_budget import Pilot

# What is not so many of its standard errors above nothing counts as nothing.
SURE = 2.0
# Pixels of a label that are traced once more, about.
LABEL_PIXELS = 1 << 14
# Fraction of the golden ratio: takes such a share of the pixels evenly.
GOLDEN = 0.6180339887498949


def judged_pixels(pilot: Pilot) -> NDArray[np.intp]:
    """Numbers of the scored pixels by which each label's cut light is estimated."""
    scored = np.where(pilot.scored, pilot.label, 0).ravel()
    share = LABEL_PIXELS / np.maximum(np.bincount(scored), 1)
    share[0] = 0.0
    return np.flatnonzero(GOLDEN * np.arange(scored.size) % 1.0 < share[scored])


def cut_to_sensor_noise(
    quick: BlockLight,
    deep: BlockLight,
    blocks: Blocks,
    pixels: NDArray[np.intp],
    pilot: Pilot,
    sensor: SensorNoise,
) -> Mapping[int, float]:
    """Label's number -> root mean square of the cut light's height over that of the sensor's noise, over some scored pixels.

    `deep` are these `pixels` of the pilot `quick`, traced again in the same `blocks` with more vertices.
    """
    again = np.zeros(blocks.number.size, np.bool_)
    again[pixels] = True
    before = quick.phasor[0][..., np.repeat(again, blocks.number)]
    number = blocks.number[pixels].astype(np.float64)
    entry = np.repeat(np.arange(number.size), blocks.number[pixels])
    found = deep.phasor[0] - before
    height = np.zeros(entry.size)
    for p, fringe in enumerate(sensor.fringe):
        own = before[fringe, p]
        mean = np.bincount(entry, own.real) + 1j * np.bincount(entry, own.imag)
        share = sensor.mm_per_rad[p].ravel()[pixels][entry]
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = (found[fringe, p] * (number / mean)[entry]).imag
        height += np.where(share > 0.0, share * turn, 0.0)
    once, twice = np.bincount(entry, height), np.bincount(entry, height**2)
    square = np.full(blocks.number.size, np.nan)
    square[pixels] = (once**2 - twice) / (number * (number - 1.0))
    own = square.reshape(pilot.label.shape)
    ratios = {}
    for n in np.unique(pilot.label[pilot.scored]):
        at = pilot.scored & (pilot.label == n) & np.isfinite(own)
        if at.any():
            mean, error = own[at].mean(), own[at].std() / np.sqrt(at.sum())
            share = mean / np.mean(sensor.height_mm[at] ** 2)
            ratios[int(n)] = float(np.sqrt(share)) if mean > SURE * error else 0.0
    return ratios
