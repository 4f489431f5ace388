"""Brightness of the frames of a fringe set of four steps or more, from what a sinusoid leaves of the samples.

With factors h_k that undo the flicker, the samples ``h_k I_k`` of every pixel are a sinusoid of the steps, whatever its
brightness, contrast and phase: ``P diag(I) h = 0``, P the projection on what a sinusoid leaves. Summed over the pixels,
``h^T (P o sum I I^T) h`` is smallest at the eigenvector of the smallest eigenvalue, and that eigenvalue is the noise's. Unlike
contrast by phase this needs no more than one fringe in view, but also a linear response: gamma leaves residuals of its own, which
the eigenvalue shows.
"""

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.fringe_fit import fringe_design

Floats = NDArray[np.float64]

# Where the phases in view are too uneven, a harmonic of the response looks like flicker: 1.5 turns have 0.2.
UNEVEN = 0.35
# Times the noise that may be left: a gamma of 1.05 leaves more.
LEFT = 2.0
OUTLIER = 1.5
ITERATIONS = 4
FEWEST_PIXELS, FEWEST_GROUPS = 400, 6


def residual_gains(
    samples: Floats, groups: NDArray[np.intp], shifts_rad: tuple[float, ...], variance_dn2: float
) -> tuple[Floats, float] | None:
    """Brightness of each step relative to their mean, and its standard error.

    Parameters
    ----------
    samples
        (step, pixel) in DN above black, unsaturated.
    groups
        (pixel,) number of the part of the image, whose scatter gives the error.
    shifts_rad
        Phase shift of each step.
    variance_dn2
        Variance of a sample's noise.

    Returns
    -------
    tuple or None
        (step,) and a number; None where steps, pixels or phases are too few, or the samples are no sinusoids.
    """
    steps, pixels = samples.shape
    design = fringe_design(shifts_rad)
    if steps < 4 or pixels < FEWEST_PIXELS:
        return None
    _, cosine, sine = np.linalg.pinv(design) @ samples
    turn = np.exp(1j * np.arctan2(sine, cosine))
    if max(abs(np.mean(turn**k)) for k in (1, 2, 3)) > UNEVEN:
        return None
    left_over = np.eye(steps) - design @ np.linalg.pinv(design)
    level = samples.mean(axis=0)
    relative = samples / level
    weight = trust = (level / level.max()) ** 2
    for _ in range(ITERATIONS):
        values, vectors = np.linalg.eigh(left_over * ((relative * weight) @ relative.T))
        undo = vectors[:, 0] / vectors[:, 0].mean()
        misfit = np.linalg.norm(left_over @ (relative * undo[:, None]), axis=0)
        limit = OUTLIER * float(np.median(misfit)) + 1e-9
        weight = trust * limit / np.maximum(misfit, limit)
    noise = variance_dn2 * float((weight / level**2).sum()) * (steps - 3) / steps
    # An eigenvalue of vectors of length one, as the noise's.
    if values[0] > LEFT * noise:
        return None
    inverse = vectors[:, 1:] / np.maximum(values[1:] - values[0], 1e-12) @ vectors[:, 1:].T
    share = left_over @ (relative * undo[:, None] * weight) * relative
    share -= values[0] * undo[:, None] * weight / weight.sum()
    moved = np.array([inverse @ share[:, groups == group].sum(axis=1) for group in set(groups)])
    if len(moved) < FEWEST_GROUPS:
        return None
    gains = 1.0 / undo
    return gains / gains.mean(), float(np.sqrt((moved**2).sum(axis=0)).max())
