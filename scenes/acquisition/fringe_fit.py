"""The least-squares fit of a phase-shifted sinusoid, and how little light counts as stray: shared by render, decode and evaluation."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

STRAY_FRACTION = 0.02
"""Modulation per exposure time, as a fraction of the image's median, below which light is taken for stray light in a
shadow: black ink sends back 5 % or more of what its surroundings do."""


def fringe_design(shifts_rad: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Design matrix (N, 3) of ``I_k = A + B cos(phi + delta_k)`` in the unknowns ``(A, B cos phi, B sin phi)``; delta_k
    in rad.

    >>> fringe_design([0.0, np.pi]).round(6).tolist()
    [[1.0, 1.0, -0.0], [1.0, -1.0, -0.0]]
    """
    shifts = np.asarray(shifts_rad, np.float64)
    return np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)


def fringe_solution(
    shifts_rad: Sequence[float] | NDArray[np.float64],
) -> NDArray[np.float64] | None:
    """Pseudo-inverse of `fringe_design`, (3, N), by least squares; None where the shifts leave the phase undetermined.

    For equal steps this is the first bin of the discrete Fourier transform (Bruning et al. 1974); for others,
    Greivenkamp (1984).
    """
    design = fringe_design(shifts_rad)
    if np.linalg.matrix_rank(design, tol=1e-6) < 3:
        return None
    return np.asarray(np.linalg.pinv(design), np.float64)
