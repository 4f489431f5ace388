"""Linear light: what each camera pixel returns of each basis channel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.basis import Basis
from scenes.scene import Scene


@dataclass(frozen=True)
class Transport:
    """The response of every camera pixel to a basis of the patterns, in radiance, W/(m^2 sr).

    Linear light: `frames` turns it into images of any patterns the basis spans, and `render.expose` into a stack.
    """

    total: NDArray[np.float32]
    """All light from the projectors, (projector, channel, row, col); channels a projector lacks are 0."""
    direct: NDArray[np.float32]
    """The part of `total` scattered once, at the first surface; same axes."""
    ambient: NDArray[np.float32]
    """Ambient light, (row, col)."""
    label: NDArray[np.uint16]
    """What each pixel's centre sees, (row, col): i + 1 for `labels[i]`, 0 for nothing."""
    labels: tuple[str, ...]
    bases: tuple[Basis, ...]
    """Each projector's channels and the weights that make its frames."""
    scene: Scene
    seed: int
    samples: int
    depth: int

    def frames(self, projector: int = 0, direct_only: bool = False) -> NDArray[np.float32]:
        """Radiance of the scene's patterns from one projector, ambient light included, (frame, row, col)."""
        basis = self.bases[projector]
        light = (self.direct if direct_only else self.total)[projector, : len(basis.channels)]
        weights = basis.weights.astype(np.float32)
        frames: NDArray[np.float32] = np.tensordot(weights, light, axes=1) + self.ambient
        return frames
