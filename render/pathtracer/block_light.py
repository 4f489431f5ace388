"""Light of pixels that are traced in independent blocks of paths: its mean, and how blocks scatter about it.

A block has random numbers of its own, so blocks of one pixel are independent and alike however skewed their law is: the
jackknife over blocks gives the variance of the phase of their mean (Efron and Stein 1981, "The jackknife estimate of
variance"). It leaves out one block at a time and looks at the phase itself, not at its linear part: where the fringe of one
of few blocks all but cancels that of the others, the linear part exceeds any phase.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import ANY_PHASE, FinestFringe, direction
from render.pathtracer.path_kernel import Pass

# Numbers that a chunk of lanes may return at once: 64 MB of float32.
CHUNK_NUMBERS = 1 << 24
# Between chunks progress is shown and an interrupt is noticed. Starting one costs some 30 ms of processor time. It is
# processor time that sizes them, not the clock: on a busy machine they would shrink to nothing.
CHUNK_S = 1.0
FIRST_CHUNK_PATHS = 1 << 20
# Blocks of a pixel's second half are numbered from here.
SECOND_HALF = 1 << 24

Counts = NDArray[np.uint32]
Images = NDArray[np.float32]
Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Blocks:
    """How pixels are traced, (entry,): an entry is all blocks of a pixel, or one half of them."""

    pixel: Counts
    """Numbers of the pixels in row order."""
    number: Counts
    """Blocks of each entry, at least one."""
    places: Counts
    """Places in each of its blocks."""
    paths: Counts
    """Paths in each of its blocks."""
    first: Counts
    """Number of its first block, which sets its random numbers."""

    @property
    def total_paths(self) -> int:
        """Paths of all pixels."""
        return int((self.number.astype(np.int64) * self.paths).sum())

    def halved(self) -> "Blocks":
        """The same blocks, two entries for each pixel, one after the other."""
        pixel, number, places, paths, first = (
            np.repeat(x, 2)
            for x in (self.pixel, self.number // 2, self.places, self.paths, self.first)
        )
        first[1::2] += SECOND_HALF
        return Blocks(pixel, number, places, paths, first)

    def of(self, entry: NDArray[np.intp]) -> "Blocks":
        """The same blocks of some of these entries."""
        parts = (self.pixel, self.number, self.places, self.paths, self.first)
        return Blocks(*(part[entry] for part in parts))

    def more(self, entry: NDArray[np.intp], number: Counts) -> "Blocks":
        """So many more of the same blocks for some of these entries."""
        first = self.first[entry] + self.number[entry]
        return Blocks(self.pixel[entry], number, self.places[entry], self.paths[entry], first)


@dataclass(frozen=True, eq=False)
class BlockLight:
    """Mean radiance over the blocks of each entry, W/(m^2 sr)."""

    total: Images
    """(projector, channel, entry)."""
    direct: Images
    ambient: Images
    """(entry,)."""
    phasor: NDArray[np.complex64]
    """Of single blocks, in the order of the entries, (part, fringe, projector, block): of all light; perhaps of direct light."""


def add(have: BlockLight, number: Counts, new: BlockLight, more: Counts, at: Any) -> Counts:
    """Average `more` blocks for the entries `at` into `have`, each block with the same weight; returns all their numbers."""
    number = number.copy()
    number[at] += more
    share = (more / number[at]).astype(np.float32)
    for old, image in (
        (have.total, new.total),
        (have.direct, new.direct),
        (have.ambient, new.ambient),
    ):
        old[..., at] += share * (image - old[..., at])
    return number


def phasor_variance(
    blocks: Sequence[tuple[NDArray[np.intp], NDArray[np.complex64]]], number: Counts, halves: int
) -> tuple[Images, Images, Images]:
    """Variances of the phase, rad^2, and of the modulation of all light, and their correlation, (fringe, projector, pixel),
    by the jackknife.

    That of the phase is NaN without a fringe, both are for one block. The modulation's is what the phase's leaves of the
    phasor's, so that together they are right where the phase is not known at all.

    `blocks` are the entry of each block and its phasor (fringe, projector, block); entries have `number` of them, and `halves`
    entries in a row are averaged with the same weight.
    """
    pixels = number.size // halves
    weight = 1.0 / (halves * number.astype(np.float64))
    squares = (number * weight**2).reshape(pixels, halves).sum(axis=1)
    shape = blocks[0][1].shape[:-1]
    phase = np.empty((*shape, pixels), np.float32)
    amplitude, correlation = np.empty_like(phase), np.empty_like(phase)
    for at in np.ndindex(shape):
        own = [(entry // halves, weight[entry], z[at]) for entry, z in blocks]
        mean = np.zeros(pixels, np.complex128)
        for pixel, w, z in own:
            mean += np.bincount(pixel, w * z.real, pixels)
            mean += 1j * np.bincount(pixel, w * z.imag, pixels)
        found, whole_found, both = np.zeros((3, pixels))
        for pixel, w, z in own:
            whole = mean[pixel]
            off = np.angle((whole - w * z) * whole.conj())
            # Each block's distance from a mean that it is part of is too short by this.
            scale = 1.0 / np.maximum(1.0 - 2.0 * w + squares[pixel], 1e-9)
            found += np.bincount(pixel, scale * ((1.0 - w) * off) ** 2, pixels)
            moved = np.sqrt(scale) * w * (z - whole) * direction(whole).conj()
            whole_found += np.bincount(pixel, np.abs(moved) ** 2, pixels)
            both += np.bincount(pixel, moved.real * moved.imag, pixels)
        found = np.minimum(found, ANY_PHASE)
        left = np.maximum(whole_found - found * np.abs(mean) ** 2, 0.0)
        found[(mean == 0.0) | (squares >= 1.0)] = np.nan
        left[squares >= 1.0] = np.nan
        phase[at], amplitude[at] = found, left
        with np.errstate(divide="ignore", invalid="ignore"):
            share = both / (np.sqrt(found * left) * np.abs(mean))
        correlation[at] = np.clip(np.nan_to_num(share), -1.0, 1.0)
    return phase, amplitude, correlation


def scatter_about_direct(light: BlockLight, number: Counts) -> Floats:
    """Variance of one block across and along its phasor from direct and from indirect light, (part, 2, fringe, projector, entry).

    About the phasor of direct light, which few paths know well; one bright path among few pulls the phasor of all light
    towards itself, and looks harmless. NaN for one block or without any light.
    """
    first = np.cumsum(number, dtype=np.int64) - number
    local = np.repeat(np.arange(number.size), number)

    def mean(z: NDArray[Any]) -> NDArray[Any]:
        """Of each entry's blocks."""
        return np.add.reduceat(z, first) / number

    result = np.empty((2, 2, *light.phasor.shape[1:3], number.size))
    for f, p in np.ndindex(light.phasor.shape[1:3]):
        total, direct = light.phasor[:, f, p].astype(np.complex128)
        own, whole = mean(direct), mean(total)
        # Without any direct light the phase is that of indirect light.
        own = np.where(own == 0.0, whole, own)
        with np.errstate(divide="ignore", invalid="ignore"):
            unit = (own.conj() / np.abs(own))[local]
            for part, z in enumerate((direct, total - direct)):
                off = z * unit
                off -= mean(off)[local]
                for way, side in enumerate((off.imag, off.real)):
                    result[part, way, f, p] = mean(side * side) * number / (number - 1)
    return result


def trace_blocks(
    pass_: Pass,
    width: int,
    blocks: Blocks,
    channels: Sequence[int],
    fringes: Sequence[FinestFringe],
    seed: int,
    progress: Callable[[float], None] | None = None,
    direct: bool = False,
) -> BlockLight:
    """Trace every block of every entry; the same seed gives the same bits, however lanes are cut into chunks.

    `channels` are the numbers of each projector's channels. `direct`: keep the phasors of direct light, too.
    """
    count = blocks.number.size
    ends = np.cumsum(blocks.number, dtype=np.int64)
    light = BlockLight(
        np.zeros((len(channels), max(channels), count), np.float32),
        np.zeros((len(channels), max(channels), count), np.float32),
        np.zeros(count, np.float32),
        np.zeros((1 + direct, len(fringes), len(channels), int(ends[-1])), np.complex64),
    )
    work = np.cumsum(blocks.number.astype(np.float64) * (blocks.paths + blocks.places))
    most = CHUNK_NUMBERS // (2 * sum(channels) + 1)
    start, size = 0, float(FIRST_CHUNK_PATHS)
    while start < count:
        began = time.process_time()
        done, lanes = (work[start - 1], int(ends[start - 1])) if start else (0.0, 0)
        end = min(np.searchsorted(work, done + size), np.searchsorted(ends, lanes + most))
        part = slice(start, max(int(end), start + 1))
        _trace_chunk(pass_, width, part, lanes, blocks, channels, fringes, seed, light)
        start = part.stop
        if progress:
            progress(float(work[start - 1] / work[-1]))
        size *= min(CHUNK_S / max(time.process_time() - began, 1e-3), 4.0)
    return light


def _trace_chunk(
    pass_: Pass,
    width: int,
    part: slice,
    lanes: int,
    blocks: Blocks,
    channels: Sequence[int],
    fringes: Sequence[FinestFringe],
    seed: int,
    light: BlockLight,
) -> None:
    number = blocks.number[part].astype(np.int64)
    first = np.cumsum(number) - number
    local = np.repeat(np.arange(number.size), number)
    block = (np.arange(local.size) - first[local]).astype(np.uint32) + blocks.first[part][local]
    counts = (blocks.places[part][local], blocks.paths[part][local])
    images = pass_.blocks(blocks.pixel[part][local], block, counts, width, seed)
    own = slice(lanes, lanes + local.size)

    def mean(values: NDArray[Any]) -> NDArray[np.float64]:
        return np.asarray(np.add.reduceat(values, first, dtype=np.float64) / number)

    light.ambient[part] = mean(next(images))
    for p, n in enumerate(channels):
        values = np.empty((2, n, local.size), np.float32)
        for c in range(n):
            for kind, image in ((1, light.direct), (0, light.total)):
                values[kind, c] = next(images)
                image[p, c, part] = mean(values[kind, c])
        for kind in range(light.phasor.shape[0]):
            for f, fringe in enumerate(fringes):
                cosine, sine = fringe.phasor(values[kind], p)
                light.phasor[kind, f, p, own] = cosine + 1j * sine
