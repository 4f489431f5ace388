"""Noise of phasors behind a lens, which adds up those of neighbours, noise and all.

Pixels are independent, so variances add up with the squares of the kernel's weights. A phasor has noise along itself and
across it; only the latter turns it, but where a neighbour's phase differs, its noise along becomes noise across. As a complex
number of angle phi, noise d has ``E|d|^2 = along + across`` and ``E d^2 = (along - across) exp(2 i phi)``; both add up.
"""

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import ANY_PHASE
from render.point_spread import blurred

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
Mask = NDArray[np.bool_]


def through(phasor: Complex, kernel: Floats) -> Complex:
    """Phasors (row, col) behind a lens with the kernel of `spread_kernel`."""
    real, imaginary = blurred(np.stack([phasor.real, phasor.imag]).astype(np.float32), kernel)
    return np.asarray(real + 1j * imaginary, np.complex128)


def phase_variance(phasor: Complex, across: Floats, along: Floats, kernel: Floats) -> Floats:
    """Variance of the phase behind the lens, rad^2 (row, col), of phasors with these variances before it."""
    chip = through(phasor, kernel)
    own = (along - across) * _direction(phasor) ** 2
    both, real, imaginary = _squared(np.stack([along + across, own.real, own.imag]), kernel)
    with np.errstate(divide="ignore", invalid="ignore"):
        turned = (_direction(chip).conj() ** 2 * (real + 1j * imaginary)).real
        variance: Floats = (both - turned) / (2.0 * np.abs(chip) ** 2)
    return np.clip(variance, 0.0, ANY_PHASE)


def weights(phasor: Complex, chip: Complex, counted: Mask, kernel: Floats | None) -> Floats:
    """How much each pixel's variances across and along its phasor add to the sum of phase variances of the `counted` pixels.

    (2, row, col), in 1 / power. `chip` are the phasors behind the lens; the kernel is None without one.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        own = np.where(counted, 1.0 / np.abs(chip) ** 2, 0.0)
    if kernel is None:
        return np.stack([own, np.zeros_like(own)])
    turned = own * _direction(chip).conj() ** 2
    both, real, imaginary = _squared(np.stack([own, turned.real, turned.imag]), kernel)
    lean = (_direction(phasor) ** 2 * (real + 1j * imaginary)).real
    return np.maximum([both + lean, both - lean], 0.0) / 2.0


def _squared(images: Floats, kernel: Floats) -> Floats:
    """Images blurred with the squares of the kernel's weights."""
    return blurred(images.astype(np.float32), kernel**2).astype(np.float64)


def _direction(phasor: Complex) -> Complex:
    size = np.abs(phasor)
    return np.divide(phasor, size, out=np.ones_like(phasor), where=size > 0.0)
