"""Fringe orders from neighbours: a naive row scan, and reliability-sorted unwrapping. Each works on images."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.device import Device, Lanes
from decode.phase.n_step import TURN

Orders = NDArray[np.int32]


def scanned(
    device: Device,
    image: tuple[int, int],
    wrapped_rad: Lanes,
    good: Lanes,
    guided: bool,
    expected_turns: Lanes | None,
) -> Lanes:
    """Fringe orders (int32 lanes) by a scan on the host, quality-guided or by rows; without `expected_turns` whole
    turns stay open.
    """
    types = device.types
    mask_lanes = types.UInt8(device.dr.select(good, types.UInt32(1), types.UInt32(0)))
    device.dr.eval(wrapped_rad, mask_lanes)
    phase, mask = device.image(wrapped_rad, image), device.image(mask_lanes, image) > 0
    scan: Callable[..., Orders] = quality_guided if guided else row_scan
    orders = scan(phase, mask)
    if expected_turns is not None:
        expected = device.image(expected_turns, image)
        orders = level(orders, phase, mask, expected, whole=not guided)
    return types.Int32(orders.reshape(-1))


def row_scan(wrapped_rad: NDArray[np.float32], good: NDArray[np.bool_]) -> Orders:
    """Orders (row, col) by the naive scan: down the rows' first pixels, then along each row; one false jump shifts the
    rest of it.

    Pixels that are not `good` are stepped over, and take the order that brings them nearest the good one before them.
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
    """Orders (row, col) by reliability-sorted unwrapping; the first pixel of each connected region has order 0, the
    others too.

    Herraez, Burton, Lalor & Gdeisat, Appl. Opt. 41, 7437 (2002), by scikit-image.
    """
    from skimage.restoration import unwrap_phase  # Half a second to import.

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
    """Shift spatial orders by whole turns so that the median is nearest the expected phase; `whole`: one shift for the
    image, not for each connected region.
    """
    miss = expected_turns - (orders + wrapped_rad / TURN)
    labels, count = (good.astype(np.int32), 1) if whole else ndimage.label(good)
    if not good.any():
        return orders
    shifts = np.round(ndimage.median(miss, labels, np.arange(1, count + 1)))
    if whole:
        return np.asarray(orders + shifts[0], dtype=np.int32)
    return np.asarray(orders + np.array([0.0, *np.atleast_1d(shifts)])[labels], dtype=np.int32)
