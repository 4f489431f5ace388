"""How many light paths and places each pixel needs, so that the noise of light stays below a share of the sensor's.

Everything here is learnt from a pilot that is thrown away: what decides is not what is averaged, so the light stays
unbiased. A pixel's phase noise has the variance ``v / n``, v of one path; the cheapest way to a sum of such variances is n
in proportion to the root of v (Neyman 1934). The scatter of a few paths is a bad estimate of one pixel's v. Known well are the
modulation B and, over some neighbours, the mean of indirect light L: ``n = k sqrt(L) / B``. The measured scatter only sets
k, one for each label.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from render.pathtracer.block_light import Blocks

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# A block's paths at most: one lane with more stalls those next to it.
BLOCK_PATHS = 16
# Blocks of a pixel that counts at least, two in each half, so that a half shows a scatter; and of other pixels.
FEWEST_BLOCKS, FEWEST_ELSEWHERE = 4, 2
# A block of the pilot.
PILOT_PLACES, PILOT_PATHS = 4, 2
# The pilot has this many paths in each label at least, so that the label's scatter is known; and in a pixel at most.
PILOT_LABEL_PATHS, PILOT_MOST_BLOCKS = 1 << 16, 32
# Windows, in pixels, over which indirect light is averaged within its label.
WINDOWS = (5, 13)
# Paths of a pixel at least, relative to its label's mean.
FLOOR = 0.12
# And at most: a few pixels without direct light would take them all.
CEILING = 30.0
# Share of the noise's variance that direct light may have. A place costs a third of a path.
DIRECT = 0.15
MOST_PLACES = 64
# Variance of direct light falls with the places of a block to this power; of a lens, whose points are not paired, by 1.
PLACES_POWER, LENS_POWER = 1.25, 1.0
# The pilot's scatter is itself an estimate, of a law with long tails: a label's sum counts as larger by so many of its own
# standard errors, which matters in small labels.
STANDARD_ERRORS = 2.0


@dataclass(frozen=True, eq=False)
class Pilot:
    """What the pilot found, images (row, col)."""

    label: NDArray[np.uint16]
    scored: Mask
    """Lit pixels whose phase can be measured: those that a target counts."""
    counted: Mask
    """These, and pixels that may be found to be such when their light is better known."""
    modulation: Floats
    """Of the projector that measures the pixel, any unit."""
    indirect: Floats
    """White indirect light of that projector, same unit."""
    sensor_rad: Floats
    """Noise of the sensor in the phase."""
    path_variance: Floats
    """Variance of the phase from one path's indirect light, rad^2."""
    place_variance: Floats
    """Variance of the phase from the direct light of a block of `PILOT_PLACES` places, rad^2."""
    kept: Floats
    """Each label's variance behind the lens over that before it, (label,), at least 1: blur averages neighbours, but also
    lets in noise of neighbours of other labels, which may get fewer paths."""


def pilot_blocks(label: NDArray[np.uint16]) -> Blocks:
    """The pilot's own paths: more of them in small labels."""
    pixels = np.bincount(label.ravel())
    wanted = PILOT_LABEL_PATHS / (PILOT_PATHS * np.maximum(pixels, 1))
    number = np.clip(np.ceil(wanted), FEWEST_ELSEWHERE, PILOT_MOST_BLOCKS).astype(np.uint32)
    number[0] = FEWEST_ELSEWHERE
    blocks = number[label.ravel()]
    return Blocks(
        np.arange(blocks.size, dtype=np.uint32),
        blocks,
        np.full_like(blocks, PILOT_PLACES),
        np.full_like(blocks, PILOT_PATHS),
        np.zeros_like(blocks),
    )


def blocks_needed(
    pilot: Pilot, targets: dict[int, float], most_paths: int, indirect: bool, lens: bool
) -> Blocks:
    """Blocks of every pixel for each label's target: `targets` maps its number to a share of the sensor's noise.

    Labels without a target get `FEWEST_ELSEWHERE` of the fewest paths. `indirect`: whether any path leaves the first vertex.
    """
    shape = pilot.label.shape
    paths = np.full(shape, 2.0 * FEWEST_ELSEWHERE if indirect else 1.0)
    blocks = np.full(shape, float(FEWEST_ELSEWHERE))
    places = np.full(shape, 2.0)
    power = LENS_POWER if lens else PLACES_POWER
    for label, target in targets.items():
        inside = pilot.label == label
        scored, counted = inside & pilot.scored, inside & pilot.counted
        if not scored.any():
            continue
        allowed = target**2 * float((pilot.sensor_rad[scored] ** 2).sum()) / pilot.kept[label]
        if indirect:
            shares, without = _shares(pilot, inside, counted)
            need = _sum(pilot.path_variance[counted] / without[counted])
            scale = need / ((1.0 - DIRECT) * allowed)
            paths[inside] = np.clip(scale * shares[inside], 2.0 * FEWEST_BLOCKS, most_paths)
            allowed *= DIRECT
        blocks[inside] = 2.0 * np.ceil(np.maximum(paths[inside] / BLOCK_PATHS, FEWEST_BLOCKS) / 2.0)
        places[inside] = _places(pilot, counted, blocks, allowed, power)[inside]
    return Blocks(
        np.arange(blocks.size, dtype=np.uint32),
        blocks.ravel().astype(np.uint32),
        places.ravel().astype(np.uint32),
        np.ceil(paths / blocks).ravel().astype(np.uint32),
        np.zeros(blocks.size, np.uint32),
    )


def _sum(variances: Floats) -> float:
    """What the sum of these estimates may be."""
    return float(variances.sum() + STANDARD_ERRORS * np.sqrt((variances**2).sum()))


def _shares(pilot: Pilot, inside: Mask, counted: Mask) -> tuple[Floats, Floats]:
    """(row, col) what a label's paths are in proportion to, with and without the light of the pixel itself.

    The latter serves to find how many there must be: a pixel whose pilot met a bright path shows both more light and more
    scatter than it has, and the one must not excuse the other. Pixels that do not count get the least.
    """
    seen = np.where(inside, pilot.indirect, 0.0)
    light, others = np.zeros(seen.shape), np.zeros(seen.shape)
    for window in WINDOWS:
        pixels = ndimage.uniform_filter(inside.astype(np.float64), window) * window**2
        whole = ndimage.uniform_filter(seen, window) * window**2
        light += whole / np.maximum(pixels, 1.0)
        others += (whole - seen) / np.maximum(pixels - 1.0, 1.0)
    found = []
    for kind in (light, others):
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.sqrt(np.maximum(kind, 0.0)) / pilot.modulation
        shares[~counted] = 0.0
        found.append(shares)
    mean = float(found[0][counted].mean())
    if mean <= 0.0:
        # A label without any indirect light has no need.
        return np.ones_like(light), np.ones_like(light)
    low, high = FLOOR * mean, CEILING * mean
    return np.clip(found[0], low, high), np.clip(found[1], low, high)


def _places(pilot: Pilot, counted: Mask, blocks: Floats, allowed: float, power: float) -> Floats:
    """(row, col) places in each block: ``L P`` of them cost ``v / (L P^power)`` of variance, L the blocks."""
    # Edges run on from pixel to pixel; two blocks alone may both have missed one.
    variance = np.where(counted, pilot.place_variance, 0.0)
    variance = ndimage.uniform_filter(variance, 3) * PILOT_PLACES**power / blocks
    allowed *= float(variance[counted].sum()) / max(_sum(variance[counted]), 1e-300)
    weight = np.where(counted, variance / blocks, 0.0)
    # Edges that matter a million times less than the worst take no part.
    weight = np.where(weight > 1e-6 * weight.max(), weight, 0.0)
    low, high = 0.0, 1.0
    if weight.any():
        # So many places in all that even the smallest edge has the most.
        high = MOST_PLACES ** (power + 1.0) / float(weight[weight > 0.0].min())

    def at(scale: float) -> Floats:
        found = (scale * weight) ** (1.0 / (power + 1.0))
        # One without its opposite would shift the phase of direct light.
        return np.clip(2.0 * np.ceil(found / 2.0), 2, MOST_PLACES)

    for _ in range(60):
        middle = np.sqrt(low * high) if low else high * 1e-9
        if float((variance / at(middle) ** power)[counted].sum()) > allowed:
            low = middle
        else:
            high = middle
        if low and high / low < 1.02:
            break
    return at(high)
