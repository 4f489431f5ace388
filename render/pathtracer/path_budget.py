"""How many light paths and places each pixel needs, so that the noise of light stays below a share of the sensor's.

What decides is not what is averaged, so the light stays unbiased: a pilot that is thrown away decides on the first paths, and
each half of these on the rest of the other half. A pixel's phase noise has the variance ``v / n``, v of one path; the
cheapest way to a sum of such variances is n in proportion to the root of v (Neyman 1934). The scatter of a few paths is a
bad estimate of one pixel's v. Known better are the modulation B and, over some neighbours, the mean of indirect light L:
``n = k sqrt(L) / B``. The measured scatter only sets k, one for each label. Behind a lens, light of a pixel counts in each
label around it, by the squares of the blur's weights; it gets as many paths as the label that needs the most of it asks for.
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
# Paths from one place at most, on average.
PATHS_OF_PLACE = 4
# A block of the pilot.
PILOT_PLACES, PILOT_PATHS = 4, 2
# Behind a lens a few places cannot tell the modulation of a fringe out of focus: 16 are noisier than if they were independent.
PILOT_LENS_PLACES = 32
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
MOST_PLACES, LENS_PLACES = 64, 256
# Of the noise allowed, what is aimed at: two seeds show no more than was asked for.
AIMED = 0.95
# Of the paths that the pilot asks for, those traced before the halves ask for the rest: it often asks for too many.
FIRST = 0.35
# Variance of direct light falls with the places of a block to this power; behind a lens, of a fringe by 2.3, of steps by 1 to 1.6.
PLACES_POWER, LENS_POWER = 1.25, 2.0
# A half's scatter is itself an estimate, of a law with long tails: a label's sum counts as larger by so many of its own
# standard errors, which matters in small labels.
STANDARD_ERRORS = 1.0
# As long as a pixel has fewer paths than this, its indirect light's part of the modulation is better known from that of its
# neighbours: so much of it keeps the fringe.
KNOWING_PATHS, COHERENT = 16, 0.35


@dataclass(frozen=True, eq=False)
class Pilot:
    """What some paths found, images (row, col)."""

    label: NDArray[np.uint16]
    lit: Mask
    scored: Mask
    """Lit pixels whose height can be measured: those that a target counts."""
    counted: Mask
    """These, and pixels that may be found to be such when their light is better known."""
    phasor: Complex
    """Of each projector, (projector, row, col), any unit."""
    chip: Complex
    """Behind the lens, as long as it may well be, likewise."""
    mm_per_rad: Floats
    """(projector, row, col) what each projector's phase adds to the height; 0 where it does not measure."""
    kernel: Floats | None
    """Of the lens, as `render.blur.point_spread.spread_kernel` has it; None: no blur."""
    indirect: tuple[Floats, Floats]
    """White indirect light of each projector as `smooth_indirect` has it, (projector, row, col), same unit."""
    sensor_mm: Floats
    """Noise of the sensor in the height."""
    path_variance: Floats
    """Of one path's light across and along each phasor, same unit squared, (2, projector, row, col)."""
    place_variance: Floats
    """Of the direct light of one of the pilot's blocks, with all of its places, likewise."""


def pilot_blocks(label: NDArray[np.uint16], lens: bool) -> Blocks:
    """The pilot's own paths: more of them in small labels."""
    pixels = np.bincount(label.ravel())
    wanted = PILOT_LABEL_PATHS / (PILOT_PATHS * np.maximum(pixels, 1))
    number = np.clip(np.ceil(wanted), FEWEST_ELSEWHERE, PILOT_MOST_BLOCKS).astype(np.uint32)
    number[0] = FEWEST_ELSEWHERE
    blocks = number[label.ravel()]
    return Blocks(
        np.arange(blocks.size, dtype=np.uint32),
        blocks,
        np.full_like(blocks, PILOT_LENS_PLACES if lens else PILOT_PLACES),
        np.full_like(blocks, PILOT_PATHS),
        np.zeros_like(blocks),
    )


def blocks_needed(
    pilot: Pilot, targets: dict[int, float], most_paths: int, indirect: bool, lens: bool
) -> Blocks:
    """First blocks of every pixel on the way to each label's target.

    `targets` maps a label's number to a share of the sensor's noise. Labels without a target get `FEWEST_ELSEWHERE` of the
    fewest paths. `indirect`: whether any path leaves the first vertex.
    """
    fewest = np.where(np.isin(pilot.label, list(targets)), FEWEST_BLOCKS, FEWEST_ELSEWHERE)
    budgets = _budgets(pilot, targets)
    share, paths = 1.0, np.ones(pilot.label.shape)
    if indirect:
        # One path each, but in the dark a few single paths look like fringes: valid to a decoder, which many are not.
        share, have = DIRECT, np.where(pilot.lit, 1.0, 2.0) * fewest
        paths = _paths(pilot, budgets, (1.0 - share) / FIRST, have, most_paths, 0.0)
    blocks = 2.0 * np.ceil(np.maximum(paths / BLOCK_PATHS, fewest) / 2.0)
    piloted, power, most_places = PILOT_PLACES, PLACES_POWER, MOST_PLACES
    if lens:
        piloted, power, most_places = PILOT_LENS_PLACES, LENS_POWER, LENS_PLACES
    # The contrast of fringes, which neighbours see behind a lens, needs two pairs.
    step = 2 if pilot.kernel is None else 4
    each = np.ceil(paths / blocks)
    # Paths from one place share what it sees.
    places = 2.0 * np.ceil(each / (2.0 * PATHS_OF_PLACE))
    for allowed, adds in budgets.values():
        of_one_place = piloted**power * np.nan_to_num(pilot.place_variance)
        variance = (adds * of_one_place).sum(axis=(0, 1))
        wanted = _places(variance, blocks, share / FIRST * allowed, power, step, most_places)
        places = np.maximum(places, wanted)
    if lens:
        # Fewer than the pilot had may have more noise than the fringe has contrast, which no power foresees. And Sobol's
        # sequence fills space evenly after powers of two.
        places = np.exp2(np.ceil(np.log2(np.maximum(places, PILOT_LENS_PLACES))))
    return Blocks(
        np.arange(blocks.size, dtype=np.uint32),
        blocks.ravel().astype(np.uint32),
        places.ravel().astype(np.uint32),
        each.ravel().astype(np.uint32),
        np.zeros(blocks.size, np.uint32),
    )


def paths_needed(
    pilot: Pilot, targets: dict[int, float], have: Floats, most_paths: int, errors: float
) -> Floats:
    """(row, col) paths with which each label meets its target: at least those that pixels `have`.

    A label's noise counts as larger by so many standard `errors` of its estimate.
    """
    return _paths(pilot, _budgets(pilot, targets), 1.0, have, most_paths, errors)


def _paths(
    pilot: Pilot,
    budgets: dict[int, tuple[float, Floats]],
    share: float,
    have: Floats,
    most_paths: int,
    errors: float,
) -> Floats:
    """`paths_needed`, if so much of each label's budget may be used, which `_budgets` has."""
    paths = have.astype(np.float64)
    for label, (allowed, adds) in budgets.items():
        inside = pilot.label == label
        some = inside & (pilot.lit | pilot.counted)
        variance = (adds * np.nan_to_num(pilot.path_variance)).sum(axis=(0, 1))
        counted = inside & pilot.counted
        shares, without = _shares(pilot.indirect, adds.sum(axis=0), variance, counted, some)
        noisy = variance > 0.0
        cost = _Cost(variance[noisy], without[noisy], have[noisy], most_paths, errors)
        paths = np.maximum(paths, np.minimum(cost.scale(share * allowed) * shares, most_paths))
    return paths


@dataclass(frozen=True)
class _Cost:
    """What a label's paths leave of its noise, (pixel,)."""

    variance: Floats
    shares: Floats
    have: Floats
    most: float
    errors: float

    def noise(self, scale: float) -> float:
        """Sum of variances if pixels have `scale` times their shares."""
        left = self.variance / np.maximum(np.minimum(scale * self.shares, self.most), self.have)
        return float(left.sum() + self.errors * np.sqrt((left**2).sum()))

    def scale(self, allowed: float) -> float:
        """The smallest with no more noise than allowed."""
        if not self.shares.any() or self.noise(0.0) <= allowed:
            return 0.0
        low, high = 0.0, self.most / float(self.shares[self.shares > 0.0].min())
        for _ in range(40):
            middle = np.sqrt(low * high) if low else high * 1e-6
            low, high = (middle, high) if self.noise(middle) > allowed else (low, middle)
            if low and high / low < 1.01:
                break
        return high


def _budgets(pilot: Pilot, targets: dict[int, float]) -> dict[int, tuple[float, Floats]]:
    """Label -> what its sum of height variances may be, and how much those of each pixel add to it, (2, projector, row, col)."""
    found = {}
    for label, target in targets.items():
        inside = pilot.label == label
        scored = inside & pilot.scored
        if scored.any():
            allowed = (AIMED * target) ** 2 * float((pilot.sensor_mm[scored] ** 2).sum())
            own = np.where(inside & pilot.counted, pilot.mm_per_rad, 0.0)
            found[label] = allowed, weights(pilot.phasor, pilot.chip, own, pilot.kernel)
    return found


def smooth_indirect(light: Floats, label: NDArray[np.uint16]) -> tuple[Floats, Floats]:
    """(row, col) mean of a pixel's neighbours of the same label, with and without the pixel itself.

    The latter is used to find how many paths there must be: a pixel whose pilot met a bright path shows both more light and
    more scatter than it has, and the one must not excuse the other.
    """
    found, others = np.zeros(label.shape), np.zeros(label.shape)
    for number in np.unique(label):
        inside = label == number
        seen = np.where(inside, np.maximum(light, 0.0), 0.0)
        for window in WINDOWS:
            pixels = ndimage.uniform_filter(inside.astype(np.float64), window) * window**2
            whole = ndimage.uniform_filter(seen, window) * window**2
            found[inside] += (whole / np.maximum(pixels, 1.0))[inside]
            others[inside] += ((whole - seen) / np.maximum(pixels - 1.0, 1.0))[inside]
    return np.maximum(found, 0.0) / len(WINDOWS), np.maximum(others, 0.0) / len(WINDOWS)


def _shares(
    light: tuple[Floats, Floats], adds: Floats, variance: Floats, counted: Mask, some: Mask
) -> tuple[Floats, Floats]:
    """(row, col) what a label's paths are in proportion to, by either light; 0 where light adds nothing to its noise.

    `adds` is what a unit of a pixel's variance adds to that of the label, (projector, row, col) as light is, `variance` what the
    pixel's measured variance adds.
    `some` pixels get some paths in any case: those that seem too dark to be measured may not be.
    """
    found = [np.sqrt((kind * adds).sum(axis=0)) for kind in light]
    adds = adds.sum(axis=0)
    mean = float(found[0][counted].mean())
    if mean <= 0.0:
        # Direct light alone scatters at edges, also at those of neighbours whose blur reaches the label.
        scatter = np.sqrt(variance)
        return scatter, scatter
    low = FLOOR * mean * np.minimum(np.sqrt(adds / adds[counted].mean()), 1.0)
    low[some] = FLOOR * mean
    shares, without = (np.clip(kind, low, CEILING * mean) for kind in found)
    return shares, without


def _places(
    variance: Floats, blocks: Floats, allowed: float, power: float, step: int, most: int
) -> Floats:
    """(row, col) places in each block, at most `most`: ``L P`` of them cost ``v / (L P^power)`` of variance, L the blocks.

    `variance` is what a block of one place would add to the label's sum. Places come in groups of `step`.
    """
    # Edges run on from pixel to pixel; two blocks alone may both have missed one.
    variance = np.where(variance > 0.0, ndimage.uniform_filter(variance, 3), 0.0)
    variance /= blocks
    weight = variance / blocks
    # Edges that matter a million times less than the worst take no part.
    weight = np.where(weight > 1e-6 * weight.max(), weight, 0.0)
    some = weight > 0.0
    # One without its opposite would shift the phase of direct light.
    places = np.full(weight.shape, 2.0)
    if not some.any():
        return places
    allowed -= float(variance[~some].sum()) / 2.0**power
    variance, root = variance[some], weight[some] ** (1.0 / (power + 1.0)) / step
    # What a block's variance is divided by, of each number of steps.
    divisor = (step * np.arange(1.0, most // step + 1.0)) ** power

    def steps(scale: float) -> NDArray[np.intp]:
        found = np.ceil(scale ** (1.0 / (power + 1.0)) * root)
        return np.asarray(np.clip(found, 1.0, divisor.size), np.intp)

    # At most so many that even the smallest edge has the most.
    low, high = 0.0, (most / step / float(root.min())) ** (power + 1.0)
    for _ in range(60):
        middle = np.sqrt(low * high) if low else high * 1e-9
        if float((variance / divisor[steps(middle) - 1]).sum()) > allowed:
            low = middle
        else:
            high = middle
        if low and high / low < 1.02:
            break
    places[some] = step * steps(high)
    return places
