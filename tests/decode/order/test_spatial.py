"""The row scan's answer for pixels it steps over."""

import numpy as np

from decode.order.spatial import level, row_scan


def test_pixel_stepped_over_keeps_the_order_of_the_far_side_of_a_wrap() -> None:
    turns = np.tile(np.linspace(0.1, 2.9, 57), (3, 1))
    wrapped = ((turns + 0.5) % 1.0 - 0.5) * 2.0 * np.pi
    # Gaps of a few pixels, among them both sides of each wrap at 0.5, 1.5 and 2.5 turns.
    good = np.ones(turns.shape, bool)
    for wrap in (0.5, 1.5, 2.5):
        good &= np.abs(turns - wrap) > 0.15
    orders = row_scan(wrapped.astype(np.float32), good)
    np.testing.assert_allclose(orders + wrapped / (2.0 * np.pi), turns, atol=1e-6)


def test_levelling_moves_pixels_stepped_over_too() -> None:
    turns = np.tile(np.linspace(0.1, 0.4, 10), (2, 1))
    good = np.ones(turns.shape, bool)
    good[:, 4] = False
    wrapped = (turns * 2.0 * np.pi).astype(np.float32)
    orders = level(np.zeros(turns.shape, np.int32), wrapped, good, turns + 3.0, whole=True)
    assert (orders == 3).all()
