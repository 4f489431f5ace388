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
from decode.reason import Reason
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
# Of the means over parts of the axis: slope below which it is no period's, and offset from the origin in parts of the middle.
BINS, SLOPE, PROPORTIONAL = 24, 0.003, 0.1
# Turns in view over which what gamma, flicker or stray light do to the phase varies, and variation, in parts of the mean, below
# which it is not theirs; flicker of 5 % moves the mean by 0.03 rad.
QUARTER, CONSTANT, SHIFTED_RAD = 0.25, 0.15, 0.06
# The line must explain three quarters of the mean square difference.
LEFT = 0.5
# Edges of cells, and neighbouring pixels on both sides of each.
FEWEST_EDGES, FEWEST_CROSSINGS = 5, 20
# Distance of edges and fringes, in periods, which gamma and blur do not make, and scatter of the edges in parts of it.
APART, CLEARLY = 0.03, 0.25


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
        For each coarser period of which two turns are in view, or that is wrong with fewer, and for the Gray code; its value
        is the largest displacement, px.
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
        span = (
            np.percentile(at_px[good & rec.valid[thin]], (1.0, 99.0)) if good.any() else np.zeros(2)
        )
        short = np.ptp(span) < FEWEST_TURNS * fringes.period_px
        good &= _lit(rec)[thin] if short else rec.valid[thin]
        if good.sum() < FEWEST_PIXELS:
            continue
        at = at_px[good]
        miss = wrap(phase[good] - TURN * at / fringes.period_px) * (fringes.period_px / TURN)
        if short:
            yield from _short_field(name, at, miss, (fringes, finest))
            continue
        first, last = span
        slope, offset = _line(at, miss)
        left = miss - offset - slope * at
        moved = float(max(abs(offset + slope * first), abs(offset + slope * last)))
        explained = np.median(np.abs(left)) < LEFT * np.median(np.abs(miss))
        said = f"coordinates differ by up to {moved:.3f} px along the axis"
        if not explained or moved < MOVED * sigma_px:
            yield Finding(name, "ok", said, moved)
            continue
        yield Finding(name, "wrong", said + _fitting(slope, fringes, finest), moved)


def _lit(rec: Reconstruction) -> NDArray[np.bool_]:
    """Pixels with a coordinate, also where orders disagree: leaving those out would hide what they disagree about."""
    return np.isin(rec.reason, (Reason.OK, Reason.ORDER_MISMATCH))


def _fitting(slope: float, fringes: FringeSet, finest: FringeSet) -> str:
    return (
        f": a period or an origin is not as stated; period_px = {finest.period_px * (1.0 + slope):.6g} instead of "
        f"{finest.period_px:g}, or {fringes.period_px / (1.0 + slope):.6g} instead of {fringes.period_px:g}, would fit"
    )


def _short_field(
    name: str, at: NDArray[np.float64], miss: NDArray[np.float64], sets: tuple[FringeSet, FringeSet]
) -> Iterator[Finding]:
    """A difference in proportion to the coordinate, which vanishes where the coordinate is 0, of less than two turns.

    Gamma and flicker of the coarse fringes make differences of any slope and offset; a wrong period ties one to the other.
    """
    edges = np.quantile(at, np.linspace(0.0, 1.0, BINS + 1))
    which = np.clip(np.searchsorted(edges, at, "right") - 1, 0, BINS - 1)
    count = np.maximum(np.bincount(which, minlength=BINS), 1)
    place, mean = (np.bincount(which, v, minlength=BINS) / count for v in (at, miss))
    (slope, offset), spread = np.polyfit(place, mean, 1, cov=True)
    slope_error, offset_error = np.sqrt(np.diag(spread))
    middle = abs(slope) * float(place.mean())
    moved = abs(slope) * float(place.max())
    said = f"coordinates differ by up to {moved:.3f} px along the axis"
    if (
        abs(slope) > max(SLOPE, MOVED * slope_error)
        and offset_error < PROPORTIONAL * middle
        and abs(offset) < PROPORTIONAL * middle
    ):
        yield Finding(name, "wrong", said + _fitting(float(slope), *sets), moved)
        return
    period = sets[0].period_px
    shift = float(np.median(mean))
    if (
        np.ptp(at) > QUARTER * period
        and abs(shift) > SHIFTED_RAD * period / TURN
        and np.ptp(mean[np.bincount(which, minlength=BINS) > 0]) < CONSTANT * abs(shift)
    ):
        said = f"coordinates differ by {shift:.3f} px everywhere: a first phase, an origin or a period is not as stated"
        yield Finding(name, "wrong", said, abs(shift))


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
    good = _lit(code) & _lit(rec)[::every, ::every]
    phases = rec.phases[rec.axis]
    period = phases.period_px
    cell = np.where(good, code.phases[rec.axis].coordinate_px, np.nan)
    turn = np.exp(1j * phases.wrapped_rad[::every, ::every].astype(np.float64))
    edges, seen = (
        np.concatenate(both)
        for both in zip(
            *(_crossings(*planes, max(cells)) for planes in ((cell, turn), (cell.T, turn.T))),
            strict=True,
        )
    )
    edge, which, count = np.unique(np.round(edges, 3), return_inverse=True, return_counts=True)
    often = count >= FEWEST_CROSSINGS
    if often.sum() < FEWEST_EDGES:
        return
    # By phase, whatever the orders: from edge to edge it moves by less than half a period.
    apart = seen * np.exp(-1j * TURN * edges / period)
    sums = np.bincount(which, apart.real) + 1j * np.bincount(which, apart.imag)
    miss = np.unwrap(np.angle(sums[often])) * (period / TURN)
    edge = edge[often]
    # Edges at a step of the surface are off, so medians (Theil 1950).
    i, j = np.triu_indices(edge.size, 1)
    slope = float(np.median((miss[j] - miss[i]) / (edge[j] - edge[i])))
    offset = float(np.median(miss - slope * edge))
    left = miss - offset - slope * edge
    # A difference in proportion to the coordinate is as large as its distance from the origin.
    proportional = abs(offset) < PROPORTIONAL * abs(slope) * float(edge.mean())
    moved = abs(slope) * float(edge.max() if proportional else np.ptp(edge))
    explained = np.median(np.abs(left)) < LEFT * np.median(np.abs(miss - np.median(miss)))
    bad = bool(explained and moved > MOVED * sigma_px)
    said = f"widths of cells and periods differ by {moved:.3f} px along the axis"
    said += ": cell_px or a period is not as stated" if bad else ""
    yield Finding(f"{rec.axis} Gray code, scale", "wrong" if bad else "ok", said, moved)
    shift = float(wrap(np.median(miss) * (TURN / period))) * (period / TURN)
    apart_px = max(MOVED * sigma_px, APART * period)
    if not bad and abs(shift) > apart_px and np.median(np.abs(left)) < CLEARLY * abs(shift):
        said = (
            f"the edges of the code's cells are {shift:+.3f} px from where the fringes have them: the code's or the fringes' "
            "origin_px, or a first phase, is not as stated"
        )
        yield Finding(f"{rec.axis} Gray code, place", "wrong", said, abs(shift))


def _crossings(
    cell: NDArray[np.float64], turn: NDArray[np.complex128], width_px: float
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Edge of the cells, px, and the phase there as a number of length one, between neighbours along rows that see
    adjacent cells.
    """
    one, two = cell[:, :-1], cell[:, 1:]
    adjacent = np.isclose(np.abs(two - one), width_px, rtol=1e-3)
    middle = turn[:, :-1][adjacent] + turn[:, 1:][adjacent]
    return 0.5 * (one + two)[adjacent], middle / np.maximum(np.abs(middle), 1e-12)


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
