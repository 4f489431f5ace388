"""Light beyond an image's borders, from where the lens's blur carries some into it.

An image is continued by its mirror image, which keeps even light even. Mirrored fringes would turn back at the border, though, and
a blur of a few pixels then shifts the phase of the outermost ones by ten standard deviations of the sensor's noise. So
fringes keep the modulation of the mirror image, which never makes light negative, but their phase continues as it does at
the border, by the same step from pixel to pixel.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.pattern_basis import Basis
from scenes.acquisition.patterns import Patterns

Complex = NDArray[np.complex128]
Images = NDArray[np.float32]

# Kinds of frames that are sums of sinusoids.
WAVES = ("fringe", "modulated")
# Pixels of the sensor that fringes are continued for. Beyond, a kernel has 0.3 % of its light, and over many fringes that is even.
MARGIN = 32
# Steps of the phase at the border that are averaged. With more, edges near the border would disturb them.
STEPS = 2


def fringe_terms(basis: Basis, patterns: Patterns) -> Complex:
    """Weights (fringe, channel) of the phasors ``B exp(i phi)`` of a projector's fringes: what its channels have of each."""
    channels = basis.channels
    terms = []
    for number, channel in enumerate(channels):
        if channel.kind == "cos":
            # Its sine is the next channel.
            row = np.zeros(len(channels), np.complex128)
            row[number : number + 2] = 1.0, 1.0j
            terms.append(row)
    waves = {(f.axis, p) for f in patterns.frames() if f.kind in WAVES for p, _, _ in f.waves()[1]}
    for axis, period_px in sorted(waves):
        row = np.zeros(len(channels), np.complex128)
        for number, channel in enumerate(channels):
            if channel.kind == "table" and channel.axis == axis:
                at = (np.arange(len(channel.values)) + 0.5) / channel.cells
                row[number] = np.mean(channel.values * np.exp(2j * np.pi / period_px * at))
        terms.append(row)
    return np.array([row for row in terms if row.any()], np.complex128).reshape(-1, len(channels))


def continued(images: Images, terms: Complex, margins: tuple[int, int]) -> Iterator[Images]:
    """Each of one projector's images (channel, row, col) with `margins` beyond its borders; `terms` are its `fringe_terms`."""
    down, across = margins
    left = _beyond(images[:, :, :across], terms)[:, :, ::-1]
    right = _beyond(images[:, :, ::-1][:, :, :across], terms)

    def widened(channel: int | slice, rows: slice) -> Images:
        parts = (left[channel, rows], images[channel, rows], right[channel, rows])
        return np.concatenate(parts, axis=-1)

    top, bottom = widened(slice(None), slice(down)), widened(slice(None), slice(-down, None))
    above = _beyond(top.swapaxes(1, 2), terms).swapaxes(1, 2)[:, ::-1]
    below = _beyond(bottom[:, ::-1].swapaxes(1, 2), terms).swapaxes(1, 2)
    for channel in range(len(images)):
        middle = widened(channel, slice(None))
        yield np.concatenate([above[channel], middle, below[channel]])


def margins_of(rows: int, columns: int, subpixels: int) -> tuple[int, int]:
    """Rows and columns to add on each side of an image with so many pixels along a side of the sensor's."""
    return min(MARGIN * subpixels, rows), min(MARGIN * subpixels, columns)


def _beyond(inside: Images, terms: Complex) -> Images:
    """Pixels (channel, row, col) on the other side of a border, in order of their distance from it, as `inside` is."""
    z = np.einsum("fc,cyx->fyx", terms, inside)
    distance = np.arange(inside.shape[-1])
    near = min(STEPS, inside.shape[-1] - 1)
    step = np.angle((z[..., :near] * z[..., 1 : near + 1].conj()).sum(axis=-1, keepdims=True))
    border = (z * np.exp(1j * step * distance))[..., : near + 1].sum(axis=-1, keepdims=True)
    turned = np.abs(z) * np.exp(1j * (np.angle(border) + step * (distance + 1))) - z
    back = np.linalg.pinv(np.concatenate([terms.real, terms.imag]))
    change = np.einsum("cf,fyx->cyx", back, np.concatenate([turned.real, turned.imag]))
    beyond: Images = (inside + change).astype(np.float32)
    return beyond
