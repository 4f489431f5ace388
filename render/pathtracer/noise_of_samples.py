"""Noise of a pass of given samples, from one pixel in eight that is traced a second time.

The samples of a pixel are stratified together, so they show no scatter from which the error of their mean would follow. A second,
independent set of as many does: half the square of the difference of two phases is the variance of one, whatever the law. It
costs an eighth of the pass and leaves its light alone. In between, light is as noisy as in the nearest such pixel of the label.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from render.fringe_phasor import ANY_PHASE, FinestFringe
from render.pathtracer.block_light import Blocks, trace_blocks
from render.pathtracer.path_kernel import Pass

# Stream of the second set's random numbers.
STREAM = 0x3C6EF372
# One pixel of each such cell, (rows, columns), has a second set; at random, not to fall in step with what is periodic.
CELL = (2, 4)
# Pixels at a time, to save memory.
BAND = 1 << 16


def phasor_noise(
    pass_: Pass,
    total: NDArray[np.float32],
    label: NDArray[np.uint16],
    channels: Sequence[int],
    fringes: Sequence[FinestFringe],
    samples: int,
    seed: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Standard deviations of the phase and of the modulation of a pass's light `total` (projector, channel, row, col), and
    their correlation, (fringe, projector, row, col)."""
    rows, columns = label.shape
    measured = _one_of_each_cell(label.shape, seed)
    pixels = np.flatnonzero(measured).astype(np.uint32)
    light = total.reshape(*total.shape[:2], -1)
    # Across the phasor, which turns it, and along it; and whether with the same sign.
    off = np.empty((3, len(fringes), len(channels), pixels.size))
    for start in range(0, pixels.size, BAND):
        band = slice(start, start + BAND)
        pixel = pixels[band]
        one = np.ones_like(pixel)
        blocks = Blocks(pixel, one, *pass_.counts(pixel, columns, samples), 0 * one)
        again = trace_blocks(pass_, columns, blocks, channels, fringes, seed ^ STREAM)
        for p, count in enumerate(channels):
            for f, fringe in enumerate(fringes):
                cosine, sine = fringe.phasor(light[p, :count, pixel].T, p)
                # Times the modulation, which neighbours need not share.
                other = again.phasor[0, f, p]
                first = cosine + 1j * sine
                across = np.angle(other * first.conj()) * np.abs(first)
                along = np.sqrt(np.maximum(np.abs(other - first) ** 2 - across**2, 0.0))
                longer = ((other - first) * first.conj()).real
                off[:2, f, p, band] = np.abs([across, along]) / np.sqrt(2.0)
                off[2, f, p, band] = np.sign(across * longer)
    near = np.cumsum(measured.ravel())[_nearest_of_label(measured, label).ravel()] - 1
    noise, amplitude, correlation = np.empty(
        (3, len(fringes), len(channels), rows, columns), np.float32
    )
    for p, count in enumerate(channels):
        for f, fringe in enumerate(fringes):
            modulation = np.hypot(*fringe.phasor(total[p, :count], p))
            with np.errstate(divide="ignore", invalid="ignore"):
                found = off[0, f, p, near].reshape(label.shape) / modulation
            noise[f, p] = np.minimum(found, np.sqrt(ANY_PHASE))
            amplitude[f, p] = off[1, f, p, near].reshape(label.shape)
            correlation[f, p] = off[2, f, p, near].reshape(label.shape)
    return noise, amplitude, correlation


def _one_of_each_cell(shape: tuple[int, ...], seed: int) -> NDArray[np.bool_]:
    """Which pixels have a second set, (row, col)."""
    cells = [-(-n // size) for n, size in zip(shape, CELL, strict=True)]
    rng = np.random.default_rng(seed)
    index = [
        np.minimum(
            size * np.arange(count).reshape(-1 if axis == 0 else 1, -1 if axis else 1)
            + rng.integers(size, size=cells),
            shape[axis] - 1,
        )
        for axis, (size, count) in enumerate(zip(CELL, cells, strict=True))
    ]
    measured = np.zeros(shape, np.bool_)
    measured[tuple(index)] = True
    return measured


def _nearest_of_label(measured: NDArray[np.bool_], label: NDArray[np.uint16]) -> NDArray[np.intp]:
    """Number of the nearest measured pixel of the same label, (row, col); of any label where its own has none."""
    nearest = np.empty(label.shape, np.intp)
    for number in np.unique(label):
        own = label == number
        where = measured & own
        found = ndimage.distance_transform_edt(
            ~(where if where.any() else measured), return_distances=False, return_indices=True
        )
        nearest[own] = np.ravel_multi_index(tuple(found), label.shape)[own]
    return nearest
