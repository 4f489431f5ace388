"""Shadow: pixels that the projector reaches only by way of other surfaces.

Stray light carries fringes too, and a long exposure lifts them far above the noise: in an HDR stack of a board with solder
they decode, agree over all periods, and are wrong by millimetres. What gives them away is how little light it is: a few
hundredths of what black ink sends back. So the modulation per time of exposure is compared with the image's typical one.
"""

import math

import numpy as np
from numpy.typing import NDArray

from decode.device import Lanes
from decode.fusion import Samples

# Pixels whose levels make the typical one: its median is then good to a few per cent.
GRID_PIXELS = 4096
# Standard deviations by which a modulation is lowered before it counts: what noise alone shows in a short exposure.
SURE = 3.0


def level(samples: Samples) -> Lanes:
    """Modulation per exposure time in DN/ms that the pixel surely has, float32; 0 or less without a fringe.

    The largest over the exposures of ``(B - 3 sigma_B) / t``: clipping and noise only lower it, so the fusion rule and
    saturation do not matter.
    """
    dr, root = samples.device.dr, samples.device.root
    best = None
    for exposure, time_ms in enumerate(samples.exposure_ms):
        phasor = samples.phasor(exposure)
        power = phasor.cosine * phasor.cosine + phasor.sine * phasor.sine
        # sigma_B = B sigma_phi, which is no number where all steps are clipped alike
        sure = root(power) * (1.0 - SURE * root(phasor.variance_rad2))
        # an argument of the kernel: another exposure time does not compile another kernel
        per_ms = dr.opaque(samples.device.types.Float, 1.0 / time_ms)
        scaled = dr.select(power > 0.0, sure * per_ms, 0.0)
        best = scaled if best is None else dr.maximum(best, scaled)
    return best


def grid(image: tuple[int, int]) -> NDArray[np.uint32]:
    """Flat indices of a regular grid over the image (rows, columns)."""
    rows, columns = image
    stride = max(1, math.isqrt(rows * columns // GRID_PIXELS))
    row, column = np.mgrid[stride // 2 : rows : stride, stride // 2 : columns : stride]
    return np.asarray(row * columns + column, dtype=np.uint32).reshape(-1)


def typical(levels: NDArray[np.float32]) -> float:
    """Median level of the pixels that show a fringe; 0 if none does."""
    seen = levels[levels > 0.0]
    return float(np.median(seen)) if seen.size else 0.0
