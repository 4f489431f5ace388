"""How many light paths and places each pixel needs, so that the noise of light stays below a share of the sensor's.

Everything here is learnt from a pilot that is thrown away: what decides is not what is averaged, so the light stays
unbiased. A pixel's phase noise has the variance ``v / n``, v of one path; the cheapest way to a sum of such variances is n
in proportion to the root of v (Neyman 1934). The scatter of a few paths is a bad estimate of one pixel's v. Known well are the
modulation B and, over some neighbours, the mean of indirect light L: ``n = k sqrt(L) / B``. The measured scatter only sets
k, one for each label. Behind a lens, light of a pixel counts in each label around it, by the squares of the blur's weights;
it gets as many paths as the label that needs the most of it asks for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from render.light_noise import weights
from render.pathtracer.block_light import Blocks

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
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
# Of the noise allowed, what is aimed at: two seeds show no more than was asked for.
AIMED = 0.75
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
    phasor: Complex
    """Of the projector that measures the pixel, any unit."""
    chip: Complex
    """The same behind the lens."""
    kernel: Floats | None
    """Of the lens, as `render.point_spread.spread_kernel` has it; None: no blur."""
    indirect: Floats
    """White indirect light of that projector, same unit."""
    sensor_rad: Floats
    """Noise of the sensor in the phase."""
    path_variance: Floats
    """Of one path's indirect light across and along the phasor, relative to its square, (2, row, col)."""
    place_variance: Floats
    """Of the direct light of a block of `PILOT_PLACES` places, likewise."""


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
) -> tuple[Blocks, NDArray[np.uint16]]:
    """Blocks of every pixel for each label's target, and which label asked for them (row, col).

    `targets` maps a label's number to a share of the sensor's noise. Labels without a target get `FEWEST_ELSEWHERE` of the
    fewest paths. `indirect`: whether any path leaves the first vertex.
    """
    shape = pilot.label.shape
    paths = np.full(shape, 2.0 * FEWEST_ELSEWHERE if indirect else 1.0)
    fewest = np.where(np.isin(pilot.label, list(targets)), FEWEST_BLOCKS, FEWEST_ELSEWHERE)
    paths = np.maximum(paths, 2.0 * fewest if indirect else 1.0)
    # The contrast of fringes, which neighbours see behind a lens, needs two pairs.
    step = 2 if pilot.kernel is None else 4
    places = np.full(shape, 2.0)
    power = LENS_POWER if lens else PLACES_POWER
    asked_by = pilot.label.copy()
    light = _smooth_indirect(pilot)
    allowed: dict[int, float] = {}
    for label, target in targets.items():
        inside = pilot.label == label
        scored, counted = inside & pilot.scored, inside & pilot.counted
        if not scored.any():
            continue
        allowed[label] = (AIMED * target) ** 2 * float((pilot.sensor_rad[scored] ** 2).sum())
        if indirect:
            adds = weights(pilot.phasor, pilot.chip, counted, pilot.kernel)
            shares, without = _shares(light, adds.sum(axis=0), counted)
            variance = _summed(adds, pilot.path_variance, pilot.phasor)
            some = without > 0.0
            need = _sum(variance[some] / without[some])
            wanted = np.minimum(need / ((1.0 - DIRECT) * allowed[label]) * shares, most_paths)
            asked_by[wanted > paths] = label
            paths = np.maximum(paths, wanted)
            allowed[label] *= DIRECT
    blocks = 2.0 * np.ceil(np.maximum(paths / BLOCK_PATHS, fewest) / 2.0)
    for label, most in allowed.items():
        counted = (pilot.label == label) & pilot.counted
        adds = weights(pilot.phasor, pilot.chip, counted, pilot.kernel)
        variance = _summed(adds, pilot.place_variance, pilot.phasor)
        places = np.maximum(places, _places(variance, blocks, most, power, step))
    found = Blocks(
        np.arange(blocks.size, dtype=np.uint32),
        blocks.ravel().astype(np.uint32),
        places.ravel().astype(np.uint32),
        np.ceil(paths / blocks).ravel().astype(np.uint32),
        np.zeros(blocks.size, np.uint32),
    )
    return found, asked_by


def _summed(adds: Floats, variance: Floats, phasor: Complex) -> Floats:
    """(row, col) what such a variance of each pixel adds to a label's sum."""
    found: Floats = (adds * np.nan_to_num(variance)).sum(axis=0) * np.abs(phasor) ** 2
    return found


def _sum(variances: Floats) -> float:
    """What the sum of these estimates may be."""
    return float(variances.sum() + STANDARD_ERRORS * np.sqrt((variances**2).sum()))


def _smooth_indirect(pilot: Pilot) -> tuple[Floats, Floats]:
    """(row, col) mean indirect light of a pixel's neighbours of the same label, with and without that of the pixel itself.

    The latter is used to find how many paths there must be: a pixel whose pilot met a bright path shows both more light and
    more scatter than it has, and the one must not excuse the other.
    """
    light, others = np.zeros(pilot.label.shape), np.zeros(pilot.label.shape)
    for label in np.unique(pilot.label):
        inside = pilot.label == label
        seen = np.where(inside, np.maximum(pilot.indirect, 0.0), 0.0)
        for window in WINDOWS:
            pixels = ndimage.uniform_filter(inside.astype(np.float64), window) * window**2
            whole = ndimage.uniform_filter(seen, window) * window**2
            light[inside] += (whole / np.maximum(pixels, 1.0))[inside]
            others[inside] += ((whole - seen) / np.maximum(pixels - 1.0, 1.0))[inside]
    return np.maximum(light, 0.0), np.maximum(others, 0.0)


def _shares(light: tuple[Floats, Floats], adds: Floats, counted: Mask) -> tuple[Floats, Floats]:
    """(row, col) what a label's paths are in proportion to, by either light; 0 where light adds nothing to its noise.

    `adds` is how much a pixel's variance adds to that of the label.
    """
    found = [np.sqrt(kind * adds) for kind in light]
    mean = float(found[0][counted].mean())
    if mean <= 0.0:
        # A label without any indirect light has no need.
        return counted.astype(np.float64), counted.astype(np.float64)
    low = FLOOR * mean * np.minimum(np.sqrt(adds / adds[counted].mean()), 1.0)
    low[counted] = FLOOR * mean
    shares, without = (np.clip(kind, low, CEILING * mean) for kind in found)
    return shares, without


def _places(variance: Floats, blocks: Floats, allowed: float, power: float, step: int) -> Floats:
    """(row, col) places in each block: ``L P`` of them cost ``v / (L P^power)`` of variance, L the blocks.

    `variance` is what a pilot's block adds to the label's sum. Places come in groups of `step`.
    """
    # Edges run on from pixel to pixel; two blocks alone may both have missed one.
    variance = np.where(variance > 0.0, ndimage.uniform_filter(variance, 3), 0.0)
    variance *= PILOT_PLACES**power / blocks
    allowed *= float(variance.sum()) / max(_sum(variance), 1e-300)
    weight = variance / blocks
    # Edges that matter a million times less than the worst take no part.
    weight = np.where(weight > 1e-6 * weight.max(), weight, 0.0)
    low, high = 0.0, 1.0
    if weight.any():
        # So many places in all that even the smallest edge has the most.
        high = MOST_PLACES ** (power + 1.0) / float(weight[weight > 0.0].min())

    def at(scale: float) -> Floats:
        found = (scale * weight) ** (1.0 / (power + 1.0))
        # One without its opposite would shift the phase of direct light.
        return np.where(weight > 0.0, np.clip(step * np.ceil(found / step), step, MOST_PLACES), 2.0)

    for _ in range(60):
        middle = np.sqrt(low * high) if low else high * 1e-9
        if float((variance / at(middle) ** power).sum()) > allowed:
            low = middle
        else:
            high = middle
        if low and high / low < 1.02:
            break
    return at(high)
