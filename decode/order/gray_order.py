"""Fringe orders from a Gray code, and a Gray code alone as a phase."""

from dataclasses import dataclass

import numpy as np

from decode.device import Device, Lanes
from decode.order.gray_cells import GrayCell, GraySet
from decode.phase.n_step import PI, TURN, Phasor


@dataclass(frozen=True)
class CodedPhase:
    """A Gray code read as a phase whose period is one cell, as lanes."""

    phasor: Phasor
    wrapped_rad: Lanes
    order: Lanes
    mismatch: Lanes
    """0 where the code is sure, else 1."""
    sigma_px: Lanes
    """Standard deviation of a uniform distribution over the cell, px."""


def order_in_cell(
    device: Device, gray: GraySet, cell: GrayCell, phase: Lanes, period_px: float, field_px: float
) -> tuple[Lanes, Lanes]:
    """Fringe order nearest the Gray cell, and the share of the margin next to the cell that the phase uses: 0.5 is all
    of it.
    """
    dr, real = device.dr, device.types.Float
    turns = cell.centre_px * (1.0 / period_px) - phase * (1.0 / TURN)
    whole = dr.round(turns)
    margin = max(0.5 - 0.5 * gray.cell_px / period_px, 1e-3)
    outside = dr.abs(turns - whole) - cell.width_px * (0.5 / period_px)
    residual = dr.maximum(outside, 0.0) * (0.5 / margin)
    known = cell.sure & (cell.width_px <= period_px * 1.001) & _in_field(cell, field_px)
    return device.types.Int32(whole), dr.select(known, residual, real(1.0))


def coded_phase(device: Device, gray: GraySet, cell: GrayCell, field_px: float) -> CodedPhase:
    """The middle of each pixel's cell, as a phase of the cell's width."""
    dr, types = device.dr, device.types
    turns = cell.centre_px * (1.0 / gray.cell_px)
    order = dr.round(turns)
    wrapped_rad = (turns - order) * TURN
    known = cell.sure & _in_field(cell, field_px)
    phasor = Phasor(
        cosine=cell.contrast,
        sine=types.Float(0.0),
        offset=cell.offset,
        variance_rad2=cell.contrast_variance,
        usable=types.Bool(True),
        exposure=cell.exposure,
    )
    # (-0.5, 0.5] turns of rounding become [-0.5, 0.5).
    edge = wrapped_rad >= PI
    return CodedPhase(
        phasor,
        dr.select(edge, -PI, wrapped_rad),
        types.Int32(dr.select(edge, order + 1.0, order)),
        dr.select(known, types.Float(0.0), types.Float(1.0)),
        cell.width_px * float(np.sqrt(1.0 / 12.0)),
    )


def _in_field(cell: GrayCell, field_px: float) -> Lanes:
    """Where the code names a cell that the projector has."""
    return cell.centre_px - 0.5 * cell.width_px < (field_px if np.isfinite(field_px) else 1e9)
