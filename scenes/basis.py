"""A basis of the patterns' row space: all that light transport must carry to make every frame.

Light is linear, so a camera pixel's response to a frame is the same weighted sum of its responses to the basis.
Ideal sinusoids need ``1, cos, sin`` per axis and period, whatever the number of steps. Gray code, and whatever gamma or
quantisation has changed, are tables of projector pixels; their basis comes from a singular value decomposition.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenes.emission import Emission
from scenes.patterns import Axis, Frame, Patterns

AXES: tuple[Axis, ...] = ("column", "row")
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
    frames = patterns.frames()
    ideal = [i for i, frame in enumerate(frames) if frame.kind != "gray" and not emission.pixelated]
    channels: list[Channel] = []
    blocks: list[tuple[list[int], NDArray[np.float64]]] = []
    if ideal:
        channels, weights = _sinusoids(patterns, [frames[i] for i in ideal], emission)
        blocks.append((ideal, weights))
    for axis in AXES:
        rows = [i for i, frame in enumerate(frames) if frame.axis == axis and i not in ideal]
        if rows:
            tables, weights = _tables(patterns, [frames[i] for i in rows], emission, resolution)
            channels += tables
            blocks.append((rows, weights))
    together = np.zeros((len(frames), len(channels)))
    start = 0
    for rows, weights in blocks:
        together[np.ix_(rows, range(start, start + weights.shape[1]))] = weights
        start += weights.shape[1]
    return Basis(tuple(channels), together)


def _sinusoids(
    patterns: Patterns, frames: Sequence[Frame], emission: Emission
) -> tuple[list[Channel], NDArray[np.float64]]:
    """Analytic channels of fringes and uniform frames, and their weights (frame, channel)."""
    fringes = dict.fromkeys((f.axis, f.period_px) for f in frames if f.kind == "fringe")
    channels = [Channel("one")]
    channels += [Channel(wave, *fringe) for fringe in fringes for wave in ("cos", "sin")]
    index = {(c.kind, c.axis, c.period_px): i for i, c in enumerate(channels)}
    weights = np.zeros((len(frames), len(channels)))
    span = 1.0 - emission.black
    for row, frame in zip(weights, frames, strict=True):
        if frame.kind != "fringe":
            row[0] = 1.0 if frame.kind == "white" else emission.black
            continue
        row[0] = emission.black + 0.5 * span
        fringe = 0.5 * span * patterns.amplitude
        row[index["cos", frame.axis, frame.period_px]] = fringe * np.cos(frame.phase_shift_rad)
        row[index["sin", frame.axis, frame.period_px]] = -fringe * np.sin(frame.phase_shift_rad)
    return channels, weights


def _tables(
    patterns: Patterns,
    frames: Sequence[Frame],
    emission: Emission,
    resolution: tuple[int, int],
) -> tuple[list[Channel], NDArray[np.float64]]:
    """Tables that span frames of one axis, and their weights (frame, table)."""
    axis = frames[0].axis
    centres = np.arange(0.5, resolution[0 if axis == "column" else 1])
    emitted = np.stack([emission.emit(patterns.commanded(frame, centres)) for frame in frames])
    left, strength, right = np.linalg.svd(emitted, full_matrices=False)
    kept = strength > RANK_TOLERANCE * strength[0]
    # Scaled so that tables stay of the order of 1, as the analytic channels are.
    scale = np.sqrt(emitted.shape[1])
    tables = [Channel("table", axis, 0.0, tuple(table)) for table in right[kept] * scale]
    return tables, left[:, kept] * strength[kept] / scale
