"""What light from vertices deeper than a trace follows would do to the phase: its error that no scatter shows.

A pilot is traced once more with the same random numbers and more vertices. What differs, block by block, is exactly the light
that the depth cuts off. Its square averaged over blocks would be mostly noise; products of two different blocks are not, on
average (a U-statistic).
"""

from collections.abc import Mapping

import numpy as np

from render.light_noise import SensorNoise, chosen
from render.pathtracer.block_light import BlockLight, Blocks
from render.pathtracer.path_budget import Pilot

# What is not so many of its standard errors above nothing counts as nothing.
SURE = 2.0


def cut_to_sensor_noise(
    quick: BlockLight, deep: BlockLight, blocks: Blocks, pilot: Pilot, sensor: SensorNoise
) -> Mapping[int, float]:
    """Label's number -> root mean square of the cut light's phase over that of the sensor's noise, over its scored pixels.

    `deep` is the pilot `quick`, traced again in the same `blocks` with more vertices.
    """
    found = deep.phasor[0] - quick.phasor[0]
    number = blocks.number.astype(np.float64)
    entry = np.repeat(np.arange(number.size), blocks.number)
    square = np.empty((*found.shape[:2], *pilot.label.shape))
    for at in np.ndindex(found.shape[:2]):
        z = quick.phasor[0][at]
        mean = np.bincount(entry, z.real) + 1j * np.bincount(entry, z.imag)
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = (found[at] * (number / mean)[entry]).imag
        once, twice = np.bincount(entry, turn), np.bincount(entry, turn**2)
        square[at] = ((once**2 - twice) / (number * (number - 1.0))).reshape(pilot.label.shape)
    own = chosen(square, sensor)
    ratios = {}
    for n in np.unique(pilot.label[pilot.scored]):
        at = pilot.scored & (pilot.label == n) & np.isfinite(own)
        if at.any():
            mean, error = own[at].mean(), own[at].std() / np.sqrt(at.sum())
            share = mean / np.mean(sensor.phase_rad[at] ** 2)
            ratios[int(n)] = float(np.sqrt(share)) if mean > SURE * error else 0.0
    return ratios
