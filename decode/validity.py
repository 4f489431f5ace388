"""Why a pixel is not to be trusted: one reason each, the first that applies in the order of `Reason`; NaN goes before
saturation.
"""

from dataclasses import dataclass
from enum import IntEnum

from decode.device import Device, Lanes
from decode.phase import Phasor

# Where there is no fringe at all, noise makes a modulation above three of its own standard deviations in exp(-4.5) =
# 1 % of pixels (Rayleigh): below, the pixel tells nothing from "no projector light".
NO_FRINGE_RAD2 = 1.0 / 3.0**2
# Eight standard deviations: a phase noise of 1/8 rad, at which order and height still mean something.
DIM_RAD2 = 1.0 / 8.0**2


class Reason(IntEnum):
    """Codes of `Reconstruction.reason`."""

    OK = 0
    OUTSIDE_ROI = 1
    """Not asked for."""
    SATURATED = 2
    """The fusion rule found no usable exposure."""
    SHADOW = 3
    """No fringe above the noise, or light that must be stray or comes from beyond a shadow's edge: see `decode.shadow` and
    `decode.ordering`."""
    DARK = 4
    """A fringe, but of too little modulation."""
    ORDER_MISMATCH = 5
    """The periods disagree about the fringe order."""
    NO_HEIGHT = 6
    """The height model has no answer here: an invalid reference pixel, a ray that misses."""
    OUT_OF_VOLUME = 7
    """Height outside the working volume."""
    NOT_A_NUMBER = 8
    """Samples are NaN or infinite."""

    @property
    def label(self) -> str:
        """The name as text: order-mismatch."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True)
class Limits:
    """Thresholds of validity."""

    min_modulation_dn: float | None
    """None: eight standard deviations of the modulation's own noise."""
    max_order_residual: float
    heights_mm: tuple[float, float] | None


def reasons(
    device: Device,
    limits: Limits,
    finest: Phasor,
    modulation_dn: Lanes,
    usable: Lanes,
    residuals: list[Lanes],
    height_mm: Lanes | None,
    lit: Lanes | None = None,
    lost: Lanes | None = None,
) -> Lanes:
    """Reason codes as uint8 lanes; `lit` False is shadow, `lost` NaN. Comparisons are written so that NaN rejects."""
    pick, code = device.dr.select, device.types.UInt32
    reason = code(Reason.OK)
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
