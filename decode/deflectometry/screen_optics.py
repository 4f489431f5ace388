"""Which point of each position of a screen every pixel sees, how well, and why some see none."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decode.deflectometry.edges import change_px, mostly_outside, near_edges, shift_px
from decode.deflectometry.reflection import Floats, Looks
from decode.one_camera import decode_pixels
from decode.options import Options
from decode.reason import Reason
from decode.reconstruction import AxisPhase, Reconstruction
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

AXES: tuple[Axis, ...] = ("column", "row")
# Contrast of the finest fringes, relative to the screen's own, below which a surface shows no image of it. A matt surface
# mixes light of all the screen: nothing of a fringe is left but the noise of simulated light.
MIN_CONTRAST = 0.2
# The decoder's own limit of phase noise: light that would pass it with full contrast is bright enough to judge contrast.
BRIGHT_RAD = 1.0 / 8.0


@dataclass(frozen=True, eq=False)
class ScreenImage:
    """The image of the screen that a camera sees."""

    looks: Looks
    """Of the whole image, (screen, axis, row, col)."""
    first: Reconstruction
    """Decode of the first position, for its modulation and exposure."""
    phases: dict[Axis, AxisPhase]
    reason: NDArray[np.uint8]


def screen_image(stack: Stack, options: Options) -> ScreenImage:
    """Decode columns and rows of each position."""
    assert stack.calibration is not None
    screens = stack.calibration.screens
    shown = range(len(screens)) if options.projector is None else [options.projector]
    sensor = stack.sensor
    found = []
    for p in shown:
        for axis in AXES:
            # The model h = (u - x) / c with c = 1 px per mm turns the phase's noise into that of the coordinate.
            own = replace(
                options, projector=p, axis=axis, height="linear", c_px_per_mm=1.0, known_point=None
            )
            rec = decode_pixels(stack, own)
            if not rec.order_known:
                raise DecodeError(
                    f"nothing fixes the fringe order of the screen's {axis}s: show a period as wide as the screen, periods "
                    "whose beat is, or Gray code"
                )
            found.append(
                (axis, rec, _own_reason(rec, axis, sensor.black_level_dn, screens[p].contrast))
            )
    reason = np.zeros_like(found[0][2])
    for _, _, own_reason in found:
        reason = np.where(reason == Reason.OK, own_reason, reason)
    for _, _, own_reason in found:
        reason = np.where(
            (own_reason == Reason.NO_IMAGE) & (reason != Reason.OUTSIDE_ROI), own_reason, reason
        )
    reason = reason.astype(np.uint8)
    near = near_edges(reason)
    shape = (len(shown), len(AXES), *reason.shape)
    coordinates = np.stack([rec.phases[axis].coordinate_px for axis, rec, _ in found])
    sigma = np.stack([rec.sigma_mm for _, rec, _ in found]).astype(np.float64)
    edge = np.zeros_like(sigma)
    for at, (axis, rec, _) in enumerate(found):
        light = _light(rec, stack.exposure_ms)
        noise = sigma[at] * (2.0 * np.pi / rec.phases[axis].period_px)
        shift = shift_px(light, noise, near, sensor)
        edge[at] = (shift * change_px(np.where(near, coordinates[at], np.nan))).sum(axis=0)
        reason[mostly_outside(light, near)] = Reason.MIXED
    return ScreenImage(
        Looks(
            tuple(screens[p] for p in shown),
            coordinates.reshape(shape),
            sigma.reshape(shape),
            edge.reshape(shape),
        ),
        found[0][1],
        {axis: rec.phases[axis] for axis, rec, _ in found[:2]},
        reason,
    )


def _light(rec: Reconstruction, exposure_ms: tuple[float, ...]) -> Floats:
    """Modulation per exposure time (row, col), DN/ms; NaN where exposures were merged, which may have different times."""
    times = np.full(256, np.nan)
    times[: len(exposure_ms)] = exposure_ms
    return np.asarray(rec.modulation_dn / times[rec.exposure])


def _own_reason(
    rec: Reconstruction, axis: Axis, black_dn: float, contrast: float
) -> NDArray[np.uint8]:
    """The decoder's reasons, and no image where there is light but no contrast."""
    light = rec.offset_dn - black_dn
    noise_rad = rec.sigma_mm * (2.0 * np.pi / rec.phases[axis].period_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        shown = rec.modulation_dn / light / contrast
        blurred = (shown < MIN_CONTRAST) & (noise_rad * shown < BRIGHT_RAD)
    judged = np.isin(rec.reason, (Reason.OK, Reason.DARK, Reason.SHADOW, Reason.ORDER_MISMATCH))
    return np.where(blurred & judged, Reason.NO_IMAGE, rec.reason).astype(np.uint8)
