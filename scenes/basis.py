"""A basis of the patterns' row space: all that light transport must carry to make every frame.

Light is linear, so a camera pixel's response to a frame is the same weighted sum of its responses to the basis.
Ideal sinusoids need ``1, cos, sin`` per axis and period, whatever the number of steps. Patterns changed by gamma or
quantisation are tables of projector pixels; their basis comes from a singular value decomposition.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenes.emission import Emission
from scenes.patterns import Axis, Patterns

# Directions this far below the strongest carry less than float32 can hold of a frame.
RANK_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Channel:
    """One function of the projector's image: 1, cos or sin of 2 pi u / period_px, or a table of pixels.

    `values` (projector pixels along `axis`) is read piecewise constant: pixel j covers [j, j + 1).
    """

    kind: Literal["one", "cos", "sin", "table"]
    axis: Axis = "column"
    period_px: float = 0.0
    values: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        """Short, unique among analytic channels: used for EXR layers."""
        return "one" if self.kind == "one" else f"{self.kind}-{self.axis}-{self.period_px:g}px"


@dataclass(frozen=True)
class Basis:
    """Channels, and the weights (frame, channel) that turn them into emitted frames."""

    channels: tuple[Channel, ...]
    weights: NDArray[np.float64]


def basis(patterns: Patterns, emission: Emission, resolution: tuple[int, int]) -> Basis:
    """The basis of one projector's frames as emitted; `resolution` is its (columns, rows)."""
    if emission.pixelated:
        return _tables(patterns, emission, resolution)
    return _sinusoids(patterns, emission)


def _sinusoids(patterns: Patterns, emission: Emission) -> Basis:
    channels = [Channel("one")]
    for axis in patterns.axes:
        for period in patterns.periods_px:
            channels += [Channel("cos", axis, period), Channel("sin", axis, period)]
    index = {(c.kind, c.axis, c.period_px): i for i, c in enumerate(channels)}
    frames = patterns.frames()
    weights = np.zeros((len(frames), len(channels)))
    span = 1.0 - emission.black
    weights[:, 0] = emission.black + 0.5 * span
    for row, frame in zip(weights, frames, strict=True):
        fringe = 0.5 * span * patterns.amplitude
        row[index["cos", frame.axis, frame.period_px]] = fringe * np.cos(frame.phase_shift_rad)
        row[index["sin", frame.axis, frame.period_px]] = -fringe * np.sin(frame.phase_shift_rad)
    return Basis(tuple(channels), weights)


def _tables(patterns: Patterns, emission: Emission, resolution: tuple[int, int]) -> Basis:
    frames = patterns.frames()
    channels: list[Channel] = []
    blocks: list[tuple[list[int], NDArray[np.float64]]] = []
    for axis in patterns.axes:
        centres = np.arange(0.5, resolution[0 if axis == "column" else 1])
        rows = [i for i, frame in enumerate(frames) if frame.axis == axis]
        emitted = np.stack([emission.emit(patterns.commanded(frames[i], centres)) for i in rows])
        left, strength, right = np.linalg.svd(emitted, full_matrices=False)
        kept = strength > RANK_TOLERANCE * strength[0]
        # Scaled so that tables stay of the order of 1, as the analytic channels are.
        scale = np.sqrt(emitted.shape[1])
        tables = right[kept] * scale
        channels += [Channel("table", axis, 0.0, tuple(table)) for table in tables]
        blocks.append((rows, left[:, kept] * strength[kept] / scale))
    weights = np.zeros((len(frames), len(channels)))
    start = 0
    for rows, block in blocks:
        weights[np.ix_(rows, range(start, start + block.shape[1]))] = block
        start += block.shape[1]
    return Basis(tuple(channels), weights)
