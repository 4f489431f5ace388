"""A basis of the patterns' row space: the responses that light transport must hold to make every frame.

Light transport is linear, so a camera pixel's response to a frame is a weighted sum of its responses to the basis. Ideal
sinusoids need ``1, cos, sin`` per axis and period, for any number of steps. Gray code, and patterns changed by gamma or
quantisation, are tables of projector pixels; their basis comes from a singular value decomposition. Bit planes of a
micromirror device are tables, too, in the same decomposition.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenes.acquisition.patterns import Axis, EvenLight, Frame, Patterns, RandomDots
from scenes.acquisition.projector_pixels import along
from scenes.rig.projectors import Emission

# Kinds of frames that have edges.
CODES = ("gray", "xor", "line")
AXES: tuple[Axis, ...] = ("column", "row")
# Directions this far below the strongest are below float32's resolution of a frame.
RANK_TOLERANCE = 1e-7


@dataclass(frozen=True)
class Channel:
    """One function of the projector's coordinate u: 1, cos or sin of 2 pi u / period_px, or a table of pixels.

    A table has `cells` values per projector pixel along `axis`: one is constant over its pixel j, [j, j + 1); between the
    centres of several, light is linear. Random dots are named by `values`: seed, share of white, columns and rows of dots.
    """

    kind: Literal["one", "cos", "sin", "table", "dots"]
    axis: Axis = "column"
    period_px: float = 0.0
    values: tuple[float, ...] = ()
    cells: int = 1

    @property
    def name(self) -> str:
        """Short name, unique among analytic channels: used for EXR layers."""
        return "one" if self.kind == "one" else f"{self.kind}-{self.axis}-{self.period_px:g}px"


@dataclass(frozen=True)
class Basis:
    """Channels, and the weights (frame, channel) that turn them into emitted frames."""

    channels: tuple[Channel, ...]
    weights: NDArray[np.float64]
    """(frame, channel): each frame is the sum of the channels times these."""


def basis(patterns: Patterns, emission: Emission, resolution: tuple[int, int]) -> Basis:
    """The basis of one projector's frames as emitted.

    Parameters
    ----------
    patterns
        The patterns shown.
    emission
        The projector's tone response.
    resolution
        Its (columns, rows).

    Returns
    -------
    Basis
        Channels, and weights (frame, channel).

    Examples
    --------
    >>> import scenes
    >>> projector = scenes.load("step").projectors[0]
    >>> found = basis(scenes.PhaseShift(periods_px=(16.0,)), projector, projector.resolution)
    >>> [channel.name for channel in found.channels]
    ['one', 'cos-column-16px', 'sin-column-16px']
    """
    if isinstance(patterns, RandomDots | EvenLight):
        return _stereo_basis(patterns, emission, resolution)
    frames = patterns.frames()
    continuous = emission.linear and not emission.pixelated
    ideal = [i for i, frame in enumerate(frames) if frame.kind not in CODES and continuous]
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


def _stereo_basis(
    patterns: RandomDots | EvenLight, emission: Emission, resolution: tuple[int, int]
) -> Basis:
    """Black and white pass any gamma and quantisation unchanged, so one channel of dots is enough."""
    if isinstance(patterns, EvenLight):
        return Basis((Channel("one"),), np.ones((1, 1)))
    across, down = (float(np.ceil(n / patterns.dot_px)) for n in resolution)
    recipe = (float(patterns.seed), patterns.share, across, down)
    dots = Channel("dots", "column", patterns.dot_px, recipe)
    return Basis((Channel("one"), dots), np.array([[emission.black, 1.0 - emission.black]]))


def _sinusoids(
    patterns: Patterns, frames: Sequence[Frame], emission: Emission
) -> tuple[list[Channel], NDArray[np.float64]]:
    """Analytic channels for fringes and uniform frames, and their weights (frame, channel)."""
    made = [frame.waves(patterns.amplitude) for frame in frames]
    waves = zip(frames, made, strict=True)
    fringes = dict.fromkeys((f.axis, period) for f, (_, parts) in waves for period, _, _ in parts)
    channels = [Channel("one")]
    channels += [Channel(wave, *fringe) for fringe in fringes for wave in ("cos", "sin")]
    index = {(c.kind, c.axis, c.period_px): i for i, c in enumerate(channels)}
    weights = np.zeros((len(frames), len(channels)))
    span = 1.0 - emission.black
    for row, frame, (mean, parts) in zip(weights, frames, made, strict=True):
        row[0] = emission.black + mean * span
        for period, amplitude, phase in parts:
            row[index["cos", frame.axis, period]] += span * amplitude * np.cos(phase)
            row[index["sin", frame.axis, period]] -= span * amplitude * np.sin(phase)
    return channels, weights


def _tables(
    patterns: Patterns, frames: Sequence[Frame], emission: Emission, resolution: tuple[int, int]
) -> tuple[list[Channel], NDArray[np.float64]]:
    """Tables that span frames of one axis, and their weights (frame, table)."""
    axis = frames[0].axis
    count = resolution[0 if axis == "column" else 1]
    centres = np.arange(0.5, count)
    pixels = np.stack([emission.emit(patterns.commanded(frame, centres)) for frame in frames])
    emitted = along(emission, pixels, np.array([frame.kind not in CODES for frame in frames]))
    if emission.frame_ms is not None:
        parts = [bit_planes(patterns, frame, emission, resolution) for frame in frames]
        emitted = np.concatenate([emitted, *parts])
    left, strength, right = np.linalg.svd(emitted, full_matrices=False)
    kept = strength > RANK_TOLERANCE * strength[0]
    # Scaled so that tables are of the order of 1, as the analytic channels are.
    scale = np.sqrt(emitted.shape[1])
    cells = emitted.shape[1] // count
    tables = [Channel("table", axis, 0.0, tuple(table), cells) for table in right[kept] * scale]
    return tables, left[: len(frames), kept] * strength[kept] / scale


def bit_planes(
    patterns: Patterns, frame: Frame, emission: Emission, resolution: tuple[int, int]
) -> NDArray[np.float64]:
    """Light of each bit plane of a frame along its axis, (plane, pixels x cells), the most significant first."""
    centres = np.arange(0.5, resolution[0 if frame.axis == "column" else 1])
    pixels = emission.planes(patterns.commanded(frame, centres))
    return along(emission, pixels, np.full(len(pixels), frame.kind not in CODES))
