"""Whether the periods of an axis agree beyond the fringe order: each phase against the coordinate of the finest fringes.

A period that is wrong by a per cent still gives the right orders over most of an image, and coordinates that are wrong by
pixels. Whatever the surface and the lenses, all periods of an axis show one coordinate; so a difference that grows along the axis is
the patterns', not the scene's.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decode.phase.gamma import CLEAR, clearest
from decode.phase.n_step import TURN, FringeSet, fringe_sets, solution, wrap
from decode.pipeline import reconstruct
from decode.reconstruction import Reconstruction
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding

MAX_PIXELS = 100_000
FEWEST_PIXELS = 1000
# Over fewer turns a periodic error of the phase, such as gamma's, looks like one that grows.
FEWEST_TURNS = 2.0
# Predicted standard deviations by which coordinates must be moved.
MOVED = 10.0
# The line must explain three quarters of the mean square difference.
LEFT = 0.5
# Edges of cells, and neighbouring pixels on both sides of each.
FEWEST_EDGES, FEWEST_CROSSINGS = 5, 20


def scales(stack: Stack, rec: Reconstruction, projector: int) -> Iterator[Finding]:
    """Compare the coarser periods of an axis with its finest.

    Parameters
    ----------
    stack
        Frames (exposure, frame, row, col) in DN.
    rec
        The decoded axis.
    projector
        Index of the projector.

    Yields
    ------
    Finding
        For each coarser period of which two turns are in view, and for the Gray code; its value is the largest
        displacement, px.
    """
    *coarser, finest = fringe_sets(stack.patterns, projector)[rec.axis]
    every = max(1, int(np.sqrt(rec.valid.size / MAX_PIXELS)))
    thin = (slice(None, None, every), slice(None, None, every))
    at_px = rec.phases[rec.axis].coordinate_px[thin]
    sigma_px = _sigma_px(stack, rec, finest)
    yield from _code(stack, rec, projector, every, sigma_px)
    for fringes in coarser:
        name = f"{rec.axis} fringes of {fringes.period_px:g} and {finest.period_px:g} px, scale"
        phase, good = _phase(stack, fringes, thin)
        good &= rec.valid[thin]
        if good.sum() < FEWEST_PIXELS:
            continue
        at = at_px[good]
        first, last = np.percentile(at, (1.0, 99.0))
        if last - first < FEWEST_TURNS * fringes.period_px:
            continue
        miss = wrap(phase[good] - TURN * at / fringes.period_px) * (fringes.period_px / TURN)
        slope, offset = _line(at, miss)
        left = miss - offset - slope * at
        moved = float(max(abs(offset + slope * first), abs(offset + slope * last)))
        explained = np.median(np.abs(left)) < LEFT * np.median(np.abs(miss))
        said = f"coordinates differ by up to {moved:.3f} px along the axis"
        if not explained or moved < MOVED * sigma_px:
            yield Finding(name, "ok", said, moved)
            continue
        said += (
            f": a period or an origin is not as stated; period_px = {finest.period_px * (1.0 + slope):.6g} instead of "
            f"{finest.period_px:g}, or {fringes.period_px / (1.0 + slope):.6g} instead of {fringes.period_px:g}, would fit"
        )
        yield Finding(name, "wrong", said, moved)


def _code(
    stack: Stack, rec: Reconstruction, projector: int, every: int, sigma_px: float
) -> Iterator[Finding]:
    """Whether the edges of a Gray code's cells are a cell apart in the coordinate of the fringes."""
    mine = [
        k
        for k, f in enumerate(stack.patterns)
        if f.projector == projector
        and (f.kind != "fringe" and (f.axis == rec.axis or not f.period_px))
    ]
    cells = {stack.patterns[k].period_px for k in mine if stack.patterns[k].kind == "gray"}
    if not cells:
        return
    small = replace(
        stack,
        frames=np.ascontiguousarray(stack.frames[:, mine, ::every, ::every]),
        patterns=tuple(stack.patterns[k] for k in mine),
        calibration=None,
        projector_resolution=stack.projector_size(projector),
    )
    try:
        code = reconstruct(small, height="phase", axis=rec.axis, projector=projector)
    except DecodeError:
        return
    good = code.valid & rec.valid[::every, ::every]
    cell = np.where(good, code.phases[rec.axis].coordinate_px, np.nan)
    at = rec.phases[rec.axis].coordinate_px[::every, ::every]
    edges, measured = np.concatenate(
        [_crossings(*planes, max(cells)) for planes in ((cell, at), (cell.T, at.T))], axis=1
    )
    edge, which, count = np.unique(np.round(edges, 3), return_inverse=True, return_counts=True)
    often = count >= FEWEST_CROSSINGS
    if often.sum() < FEWEST_EDGES:
        return
    miss = (np.bincount(which, measured) / count - edge)[often]
    edge = edge[often]
    slope, offset = _line(edge, miss)
    left = miss - offset - slope * edge
    moved = abs(slope) * float(np.ptp(edge))
    explained = np.median(np.abs(left)) < LEFT * np.median(np.abs(miss - np.median(miss)))
    bad = bool(explained and moved > MOVED * sigma_px)
    said = f"widths of cells and periods differ by {moved:.3f} px along the axis"
    said += ": cell_px or a period is not as stated" if bad else ""
    yield Finding(f"{rec.axis} Gray code, scale", "wrong" if bad else "ok", said, moved)


def _crossings(
    cell: NDArray[np.float64], at: NDArray[np.float64], width_px: float
) -> NDArray[np.float64]:
    """Edge of the cells (0) and coordinate (1) between neighbours along rows that see adjacent cells."""
    one, two = cell[:, :-1], cell[:, 1:]
    adjacent = np.isclose(np.abs(two - one), width_px, rtol=1e-3)
    middle = 0.5 * (at[:, :-1] + at[:, 1:])
    return np.stack([0.5 * (one + two)[adjacent], middle[adjacent]])


def _phase(
    stack: Stack, fringes: FringeSet, thin: tuple[slice, slice]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Phase of the clearest exposure, and where it is unsaturated and clear of noise."""
    exposure = clearest(stack, fringes)
    samples = stack.frames[exposure][list(fringes.frames)][:, *thin].astype(np.float64)
    level, cosine, sine = np.tensordot(solution(fringes), samples, axes=1)
    sigma = np.sqrt(stack.sensor.variance_dn2(level, stack.exposure_ms[exposure]))
    good = np.hypot(cosine, sine) > CLEAR * sigma
    return np.arctan2(sine, cosine), good & (samples.max(axis=0) < stack.saturation_dn)


def _line(at: NDArray[np.float64], miss: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and offset, fitted once more without what is three deviations off."""
    slope, offset = np.polyfit(at, miss, 1)
    left = np.abs(miss - offset - slope * at)
    near = left <= 3.0 * 1.4826 * np.median(left)
    if near.sum() > FEWEST_PIXELS // 2:
        slope, offset = np.polyfit(at[near], miss[near], 1)
    return float(slope), float(offset)


def _sigma_px(stack: Stack, rec: Reconstruction, finest: FringeSet) -> float:
    """Predicted standard deviation of a typical pixel's coordinate."""
    level = float(np.median(rec.offset_dn[rec.valid]))
    variance = float(stack.sensor.variance_dn2(level, float(np.median(stack.exposure_ms))))
    modulation = float(np.median(rec.modulation_dn[rec.valid]))
    return (
        finest.period_px / TURN * float(np.sqrt(2.0 * variance / len(finest.frames))) / modulation
    )
