"""Light for two cameras: random dots, which give every surface a texture, and even light, which gives it none."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenes.acquisition.frames import Axis, Frame, ShownPatterns


class StereoLight(ShownPatterns):
    """What both kinds have: one frame of each projector, whose values are black and white alone."""

    @property
    def amplitude(self) -> float:
        """From black to white."""
        return 1.0

    @property
    def axes(self) -> tuple[Axis, ...]:
        """None: no axis is coded."""
        return ()


class RandomDots(StereoLight):
    """A fixed random pattern of square dots, each white or black: active stereo, as in depth cameras.

    Examples
    --------
    >>> [frame.kind for frame in RandomDots(dot_px=4.0).frames()]
    ['dots']
    """

    kind: Literal["random-dots"] = "random-dots"
    dot_px: Annotated[float, Field(ge=1.0, le=1e4)] = 4.0
    """Side of a dot in projector pixels; 2 to 3 camera pixels match best."""
    share: Annotated[float, Field(ge=0.05, le=0.95)] = 0.5
    """Share of white dots."""
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    """Other seeds give other dots."""

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """One frame of each projector."""
        return tuple(Frame("column", self.dot_px, 0, 1, 0.0, p, "dots") for p in range(projectors))


class EvenLight(StereoLight):
    """White light without a pattern: passive stereo, which sees the surface's own texture.

    Examples
    --------
    >>> [frame.kind for frame in EvenLight().frames()]
    ['white']
    """

    kind: Literal["even"] = "even"

    def frames(self, projectors: int = 1) -> tuple[Frame, ...]:
        """One white frame of each projector."""
        return tuple(Frame("column", 0.0, 0, 1, 0.0, p, "white") for p in range(projectors))


def dot_table(seed: int, share: float, columns: int, rows: int) -> NDArray[np.float32]:
    """Value (row, col) of each dot: 1 with probability `share`, else 0."""
    drawn = np.random.Generator(np.random.PCG64(seed)).random((rows, columns))
    return (drawn < share).astype(np.float32)
