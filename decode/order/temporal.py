"""Fringe orders: which period of the fringe each wrapped phase belongs to.

Temporal unwrapping works pixel by pixel inside the kernel: `anchored` fixes the coarsest set's order, `climb` carries it
to the next finer one (Huntley & Saldner 1993; ``n = round(Phi_lo P_lo / P_hi - phi_hi)``, phases in periods). Spatial
unwrapping (`row_scan`, `quality_guided`) works on images; its whole is known up to a multiple of 2 pi, which `level`
fixes where heights are known.
"""

from decode.device import Device, Lanes
from decode.phase.n_step import TURN

# Periods of a range that count as a whole number, and of noise of the finest phase.
WHOLE, NOISE = 1e-4, 0.01


def anchored(device: Device, wrapped_rad: Lanes, period_px: float, expected_px: Lanes) -> Lanes:
    """Order (int32) that brings the coordinate within half a period of the expected one (An, Hyun & Zhang 2016)."""
    turns = expected_px * (1.0 / period_px) - wrapped_rad * (1.0 / TURN)
    return device.types.Int32(device.dr.round(turns))


def climb(
    device: Device, coarse_rad: Lanes, order: Lanes, ratio: float, fine_rad: Lanes
) -> tuple[Lanes, Lanes]:
    """Order of the finer fringes, and the distance of its prediction from a whole number: above 0.5 fine periods it is
    wrong.
    """
    types, dr = device.types, device.dr
    turns = (types.Float(order) + coarse_rad * (1.0 / TURN)) * ratio - fine_rad * (1.0 / TURN)
    whole = types.Int32(dr.round(turns))
    return whole, dr.abs(turns - types.Float(whole))


def in_field(
    device: Device, wrapped_rad: Lanes, order: Lanes, range_turns: float, field_turns: float
) -> Lanes:
    """Order of a coordinate in the field, where noise of a beat as wide as the field took one at its border to the other side.

    `range_turns`, over which the order is unique, and the field's size are in periods; nothing changes unless the range is a
    whole number of them.
    """
    whole = round(range_turns)
    if abs(range_turns - whole) > WHOLE:
        return order
    dr, types = device.dr, device.types
    turns = types.Float(order) + wrapped_rad * (1.0 / TURN)
    # Half of the rest is noise of the finest phase on either side.
    margin = max(0.5 * (whole - field_turns), NOISE)
    below, above = turns < -margin, turns > field_turns + margin
    return order + dr.select(below, types.Int32(whole), 0) - dr.select(above, types.Int32(whole), 0)


def coordinate(device: Device, wrapped_rad: Lanes, order: Lanes, period_px: float) -> Lanes:
    """Projector coordinate in px, float64: float32 would lose 1e-5 rad above some 16 fringes."""
    float64 = device.types.Float64
    return device.dr.fma(float64(wrapped_rad), period_px / TURN, float64(order) * period_px)
