"""Uneven light: where brightness changes within a pixel's blur, the pixel sees its brighter side.

A pixel averages the fringes over its area and over the lens's blur, by weights w. Its phase is that of the centre of its
light, which is off the pixel's own by ``c = int x w m / int w m``, with m the amplitude of fringes that a sharp image would
have. The modulation ``M = int w m``, which is measured, shows it: for Gaussian weights of variance s^2 per axis ``c = s^2 grad(M)
/ M`` exactly. The coordinate is then off by c times its change per pixel.
"""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

# Standard deviations of a Sobel gradient, per one of a pixel.
SOBEL = float(np.sqrt(12.0) / 8.0)
# Variance per axis of a pixel's area.
SQUARE_PX2 = 1.0 / 12.0


def relative_slope(light: NDArray[np.floating]) -> NDArray[Any]:
    """Change of an image (row, col) per px to the right and down, relative to its value, (2, row, col); not finite where it is 0.

    Examples
    --------
    >>> relative_slope(np.exp(0.01 * np.arange(5.0))[None].repeat(3, axis=0))[:, 1, 2].round(4)
    array([0.01, 0.  ])
    """
    slope = np.stack([cv2.Sobel(light, -1, *way, scale=0.125) for way in ((1, 0), (0, 1))])
    with np.errstate(divide="ignore", invalid="ignore"):
        slope /= light
    return slope
