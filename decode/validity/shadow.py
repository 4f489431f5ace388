"""Shadow: pixels that the projector reaches only by way of other surfaces.

Stray light carries fringes too, and a long exposure lifts them far above the noise: in an HDR stack of a board with solder
they decode, agree over all periods, and are wrong by millimetres. They are recognised by how little light they have: a few
hundredths of what black ink sends back. So the modulation per time of exposure is compared with the image's typical one
(`level`, `typical`), and around the shadow found in this way with its neighbours' (`borders`). Brighter stray light is found by the
order of its coordinates: `decode.validity.epipolar_order`.
"""

import math
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from decode.device import Lanes
from decode.fusion.interface import Samples

# Pixels whose levels make the typical one: its median is then good to a few per cent.
GRID_PIXELS = 4096
# Standard deviations by which a modulation is lowered before it counts: what noise alone shows in a short exposure.
SURE = 3.0

# Factor above the minimum light up to which light that touches shadow is taken for stray light. With a minimum of 2 % of
# the typical light this is 5 %: the darkest ink.
STRAY = 2.5
# A straight edge of shadow through a pixel's centre leaves half of the pixel lit, and at least two neighbours dark.
HALF, NEIGHBOURS = 0.5, 2
# Maximum distance of the pixels that show how bright the lit surface next to an edge is.
REACH = 2
# What a pixel may be.
DARK, NOTHING = 1, 2


def level(samples: Samples) -> Lanes:
    """Modulation per exposure time that a pixel has with certainty, DN/ms; 0 or less without a fringe.

    The largest over the exposures of ``(B - 3 sigma_B) / t``: clipping and noise only lower it, so the fusion rule and
    saturation do not matter.
    """
    dr, root = samples.device.dr, samples.device.root
    best = None
    for exposure, time_ms in enumerate(samples.exposure_ms):
        phasor = samples.phasor(exposure)
        power = phasor.cosine * phasor.cosine + phasor.sine * phasor.sine
        sure = root(power) - SURE * root(samples.modulation_variance_dn2(exposure))
        # An argument of the kernel: another exposure time does not compile another kernel.
        per_ms = dr.opaque(samples.device.types.Float, 1.0 / time_ms)
        scaled = dr.select(power > 0.0, sure * per_ms, 0.0)
        best = scaled if best is None else dr.maximum(best, scaled)
    return best


def grid(image: tuple[int, int]) -> NDArray[np.uint32]:
    """Flat indices (n,) of a regular grid over the image, about `GRID_PIXELS` of them."""
    rows, columns = image
    stride = max(1, math.isqrt(rows * columns // GRID_PIXELS))
    row, column = np.mgrid[stride // 2 : rows : stride, stride // 2 : columns : stride]
    return np.asarray(row * columns + column, dtype=np.uint32).reshape(-1)


def typical(levels: NDArray[np.float32]) -> float:
    """Median `level` in DN/ms of the pixels that show a fringe; 0 if none does."""
    seen = levels[levels > 0.0]
    return float(np.median(seen)) if seen.size else 0.0


def borders(
    levels: NDArray[np.float32], dark: NDArray[np.bool_], nothing: NDArray[np.bool_], minimum: float
) -> NDArray[np.bool_]:
    """What belongs to the shadow `dark` although it is brighter than `minimum`; all (row, col). `nothing`: no samples.

    Two kinds of pixels border on shadow and decode wrongly, without any other sign of it. Stray light that is somewhat brighter: up to `STRAY`
    times the minimum, as far as it reaches from the shadow without a gap. And pixels across the shadow's edge: their light
    is the share of the lit surface's that their lit part has, and the height is that part's; below one half, the pixel's
    centre is in shadow. The surface's light is taken from nearby pixels that touch no shadow themselves.
    """
    shade = dark.astype(np.uint8)
    weak = (levels < STRAY * minimum) & ~dark & ~nothing
    if weak.any():
        _, parts = cv2.connectedComponents(weak.astype(np.uint8))
        at = np.flatnonzero(weak)
        part = parts.reshape(-1)[at]
        touching = np.zeros(int(part.max()) + 1, np.bool_)
        touching[part[_neighbours(shade).reshape(-1)[at] > 0]] = True
        shade.reshape(-1)[at] = touching[part]
    dark_neighbours = _neighbours(shade)
    edge = np.nonzero((dark_neighbours >= NEIGHBOURS) & (shade == 0) & ~nothing)
    lit = _light_near(levels, (dark_neighbours == 0) & (shade == 0) & ~nothing, *edge)
    shade[edge] |= levels[edge] < HALF * lit
    return np.asarray((shade > 0) & ~dark)


def _neighbours(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """How many of a pixel and its eight neighbours are set."""
    border = cv2.BORDER_CONSTANT
    return np.asarray(cv2.boxFilter(mask, -1, (3, 3), normalize=False, borderType=border))


def _light_near(
    levels: NDArray[np.float32],
    clear: NDArray[np.bool_],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
) -> NDArray[np.float32]:
    """Mean level of the clear pixels within reach of some pixels; 0 without any."""
    total, count = np.zeros(rows.size, np.float32), np.zeros(rows.size, np.float32)
    high, wide = levels.shape
    for down, right in product(range(-REACH, REACH + 1), repeat=2):
        there = np.clip(rows + down, 0, high - 1), np.clip(columns + right, 0, wide - 1)
        use = clear[there]
        total += np.where(use, levels[there], np.float32(0.0))
        count += use
    return np.asarray(total / np.maximum(count, 1.0))
