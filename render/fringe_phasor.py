"""The phasor of the finest fringes, straight from a transport's channels: it sets the height, coarser ones number it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.fringe_fit import fringe_design
from scenes.acquisition.pattern_basis import Basis
from scenes.acquisition.patterns import Axis, Patterns
from scenes.scene import Scene

Floats = NDArray[np.float64]

# Variance of a phase that is not known at all, rad^2.
ANY_PHASE = np.pi**2 / 3.0


@dataclass(frozen=True)
class FinestFringe:
    """The finest fringe of one axis. Its phasor is ``Z = (C, S) = B (cos phi, sin phi)``."""

    axis: Axis
    period_px: float
    frames: tuple[int, ...]
    """Numbers of its frames among one projector's."""
    solve: Floats
    """(2, step) least squares over the steps: C and S from the samples."""
    terms: tuple[Floats, ...]
    """Of each projector, (2, channel): C and S from the channels."""

    def phasor(self, channels: NDArray[np.float32], projector: int) -> Floats:
        """C and S, (2, ...), of light (channel, ...) of one projector."""
        terms = self.terms[projector]
        used = np.flatnonzero(np.any(terms != 0.0, axis=0))
        # Not a matrix product: its last bits depend on the number of threads, and samples must not.
        found: Floats = np.einsum(
            "fc,c...->f...", terms[:, used], channels[used].astype(np.float64)
        )
        return found


def finest_fringes(patterns: Patterns, bases: Sequence[Basis]) -> tuple[FinestFringe, ...]:
    """The finest fringe of each axis that has fringes, in the order of the frames."""
    frames = patterns.frames()
    finest: dict[Axis, float] = {}
    for frame in frames:
        if frame.kind == "fringe":
            finest[frame.axis] = min(frame.period_px, finest.get(frame.axis, np.inf))
    found = []
    for axis, period in finest.items():
        rows = [i for i, f in enumerate(frames) if (f.axis, f.period_px) == (axis, period)]
        rows = [i for i in rows if frames[i].kind == "fringe"]
        shifts = np.array([frames[i].phase_shift_rad for i in rows])
        solve = np.asarray(np.linalg.pinv(fringe_design(shifts)), np.float64)[1:]
        terms = tuple(solve @ b.weights[rows] for b in bases)
        found.append(FinestFringe(axis, period, tuple(rows), solve, terms))
    return tuple(found)


def direction(phasor: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Phasors of length 1; 1 where there is none."""
    size = np.abs(phasor)
    return np.divide(phasor, size, out=np.ones_like(phasor), where=size > 0.0)


def measuring_axis(scene: Scene, axes: Sequence[Axis], projector: int = 0) -> int:
    """Number of the axis that height moves more, in projector px per mm at the image's centre: decoding measures by it."""
    camera, light = scene.camera.projection(), scene.projectors[projector].projection()
    centre = np.array([camera.width, camera.height]) / 2.0
    pixels, _ = light.project(camera.points_at(scene.height_range_mm, centre))
    moved = np.abs(pixels[1] - pixels[0])
    return int(np.argmax([moved[("column", "row").index(axis)] for axis in axes]))


def white_weights(basis: Basis) -> NDArray[np.float32]:
    """Weights (channel,) of a white pattern: of the constant channel; without one the nearest combination of tables."""
    weights = [float(channel.kind == "one") for channel in basis.channels]
    if not any(weights):
        # Tables are orthogonal and their mean square is 1, so each counts by its mean.
        weights = [float(np.mean(channel.values)) for channel in basis.channels]
    return np.array(weights, np.float32)
