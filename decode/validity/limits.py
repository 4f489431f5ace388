"""Why a pixel is not to be trusted: one reason each, the first that applies in the order of `Reason`; NaN goes before
saturation.
"""

from dataclasses import dataclass

from decode.device import Device, Lanes
from decode.phase.n_step import Phasor
from decode.reason import Reason

# Where there is no fringe at all, noise makes a modulation above three of its own standard deviations in exp(-4.5) =
# 1 % of pixels (Rayleigh): below, a pixel cannot be distinguished from "no projector light".
NO_FRINGE_RAD2 = 1.0 / 3.0**2
# Eight standard deviations: a phase noise of 1/8 rad, at which order and height still mean something.
DIM_RAD2 = 1.0 / 8.0**2


@dataclass(frozen=True)
class ValidityLimits:
    """Thresholds of validity."""

    min_modulation_dn: float | None
    """None: eight standard deviations of the modulation's own noise."""
    max_order_residual: float
    heights_mm: tuple[float, float] | None


def reasons(
    device: Device,
    limits: ValidityLimits,
    finest: Phasor,
    modulation_dn: Lanes,
    usable: Lanes,
    residuals: list[Lanes],
    height_mm: Lanes | None,
    lit: Lanes | None = None,
    lost: Lanes | None = None,
    accepted: Reason = Reason.OK,
) -> Lanes:
    """`Reason` codes (uint8 lanes); comparisons are written so that NaN rejects.

    `residuals` are distances of predicted orders from whole numbers, in periods; None for `height_mm`, `lit` or `lost`
    leaves that test out; `accepted` is the code of what nothing rejects.
    """
    pick, code = device.dr.select, device.types.UInt32
    reason = code(accepted)
    if height_mm is not None:
        if limits.heights_mm is not None:
            low, high = limits.heights_mm
            inside = (height_mm >= low) & (height_mm <= high)
            reason = pick(inside, reason, code(Reason.OUT_OF_VOLUME))
        reason = pick(device.dr.isfinite(height_mm), reason, code(Reason.NO_HEIGHT))
    for residual in residuals:
        agree = residual <= limits.max_order_residual
        reason = pick(agree, reason, code(Reason.ORDER_MISMATCH))
    if limits.min_modulation_dn is None:
        bright = finest.variance_rad2 <= DIM_RAD2
    else:
        bright = modulation_dn >= limits.min_modulation_dn
    fringe = finest.variance_rad2 < NO_FRINGE_RAD2
    dim = pick(fringe, code(Reason.DARK), code(Reason.SHADOW))
    reason = pick(bright, reason, dim)
    if lit is not None:
        reason = pick(lit, reason, code(Reason.SHADOW))
    reason = pick(usable, reason, code(Reason.SATURATED))
    if lost is not None:
        reason = pick(lost, code(Reason.NOT_A_NUMBER), reason)
    return device.types.UInt8(reason)
