"""Fringe orders: which period of the fringe each wrapped phase belongs to.

Temporal unwrapping works pixel by pixel inside the kernel: `anchored` fixes the coarsest set's order, `climb` carries it
to the next finer one (Huntley & Saldner 1993; ``n = round(Phi_lo P_lo / P_hi - phi_hi)``, phases in periods). Spatial
unwrapping (`row_scan`, `quality_guided`) works on images; its whole is known up to a multiple of 2 pi, which `level`
fixes where heights are known.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.device import Device, Lanes

TURN = 2.0 * np.pi
Orders = NDArray[np.int32]


def anchored(device: Device, wrapped_rad: Lanes, period_px: float, expected_px: Lanes) -> Lanes:
    """Order that brings the coordinate within half a period of the expected one (An, Hyun & Zhang 2016)."""
    turns = expected_px * (1.0 / period_px) - wrapped_rad * (1.0 / TURN)
    return device.types.Int32(device.dr.round(turns))


def climb(
    device: Device, coarse_rad: Lanes, order: Lanes, ratio: float, fine_rad: Lanes
) -> tuple[Lanes, Lanes]:
    """Order of the finer set, whose period is the coarser one's divided by `ratio`.

    The second value is how far from a whole number the prediction was, in fine periods; above 0.5 it would be wrong.
    """
    types, dr = device.types, device.dr
    turns = (types.Float(order) + coarse_rad * (1.0 / TURN)) * ratio - fine_rad * (1.0 / TURN)
    whole = types.Int32(dr.round(turns))
    return whole, dr.abs(turns - types.Float(whole))


def coordinate(device: Device, wrapped_rad: Lanes, order: Lanes, period_px: float) -> Lanes:
    """Projector coordinate in px, float64: float32 would lose 1e-5 rad above some 16 fringes."""
    float64 = device.types.Float64
    return device.dr.fma(float64(wrapped_rad), period_px / TURN, float64(order) * period_px)


def row_scan(wrapped_rad: NDArray[np.float32], good: NDArray[np.bool_]) -> Orders:
    """Orders by the naive scan: down the rows' first pixels, then along each row; pixels not good are stepped over.

    One false jump shifts the rest of its row. A pixel stepped over takes the order that brings it nearest the good one
    before it. `wrapped_rad` and `good` are (row, col); orders start at 0.
    """
    rows, columns = good.shape
    last = np.maximum.accumulate(np.where(good, np.arange(columns), -1), axis=1)
    first = np.where(good.any(axis=1), good.argmax(axis=1), 0)
    source = np.where(last < 0, first[:, None], last)
    filled = np.take_along_axis(wrapped_rad, source, axis=1).astype(np.float64)
    lines = np.maximum.accumulate(np.where(good.any(axis=1), np.arange(rows), -1))
    start = filled[np.maximum(lines, good.any(axis=1).argmax()), 0]
    down = np.concatenate([[0.0], -np.round(np.diff(start) / TURN)]).cumsum()
    along = -np.round(np.diff(filled, axis=1) / TURN).cumsum(axis=1)
    along = np.concatenate([np.zeros((rows, 1)), along], axis=1)
    turns = down[:, None] + along + (filled - wrapped_rad) / TURN
    return np.asarray(np.round(turns), dtype=np.int32)


def quality_guided(wrapped_rad: NDArray[np.float32], good: NDArray[np.bool_]) -> Orders:
    """Orders by scikit-image's reliability-sorted unwrapping (Herraez et al. 2002), most reliable pixels first.

    Each connected region of good pixels has its own multiple of 2 pi, set so that its first pixel has order 0.
    """
    from skimage.restoration import unwrap_phase  # half a second to import

    phase = np.ma.masked_array(wrapped_rad.astype(np.float64), mask=~good)
    unwrapped = np.ma.getdata(unwrap_phase(phase, rng=0))
    orders = np.where(good, np.round((unwrapped - wrapped_rad) / TURN), 0.0).astype(np.int32)
    labels, count = ndimage.label(good)
    if count:
        at = ndimage.minimum_position(
            np.arange(good.size).reshape(good.shape), labels, np.arange(1, count + 1)
        )
        start = np.array([0, *(orders[p] for p in at)], dtype=np.int32)
        orders = np.where(good, orders - start[labels], 0)
    return orders


def level(
    orders: Orders,
    wrapped_rad: NDArray[np.float32],
    good: NDArray[np.bool_],
    expected_turns: NDArray[np.float64],
    whole: bool,
) -> Orders:
    """Shift spatial orders by whole turns so that the median lies nearest the expected phase, in periods.

    `whole`: one shift for the image (row scan); else one for each connected region.
    """
    miss = expected_turns - (orders + wrapped_rad / TURN)
    labels, count = (good.astype(np.int32), 1) if whole else ndimage.label(good)
    if not good.any():
        return orders
    shifts = np.round(ndimage.median(miss, labels, np.arange(1, count + 1)))
    if whole:
        return np.asarray(orders + shifts[0], dtype=np.int32)
    return np.asarray(orders + np.array([0.0, *np.atleast_1d(shifts)])[labels], dtype=np.int32)
