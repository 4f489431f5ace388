"""A stack of a rig with a screen becomes slopes and heights, with their standard deviations."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decode.deflectometry.choices import height_by
from decode.deflectometry.mirror_surface import Measured, integrated, nothing, two_positions
from decode.deflectometry.reflection import Floats, Rays
from decode.deflectometry.screen_optics import AXES, screen_image
from decode.one_camera import require_some
from decode.options import Options
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError

# Heights this fraction of the working volume outside it are still accepted.
VOLUME_MARGIN = 0.05


def decode_mirror(stack: Stack, options: Options) -> Reconstruction:
    """Slopes and heights of a mirroring surface from a stack that shows a screen by way of it.

    Parameters
    ----------
    stack
        Frames (exposure, frame, row, col) in DN, with the calibration of camera and screen.
    options
        As `decode.reconstruct` takes them; `known_point` fixes the height where the screen has one position.

    Returns
    -------
    reconstruction
        Per pixel: heights (row, col) and their standard deviations in mm, slopes (2, row, col), and reasons.
    """
    way = height_by(stack, options)
    seen = screen_image(stack, options)
    assert stack.calibration is not None
    image = seen.reason.shape
    good = seen.reason == Reason.OK
    camera = stack.calibration.camera.projection()
    rays = Rays(*(part[good] for part in camera.rays(camera.pixel_centres())))
    looks = seen.looks.of(good)
    found = nothing(0)
    reason = seen.reason.copy()
    if good.any():
        if way == "two-positions":
            found = two_positions(rays, looks)
        else:
            found = integrated(rays, looks, good, options.known_point)
        reason[good] = _in_volume(found, stack, options)

    def whole(values: Floats) -> NDArray[np.float32]:
        result = np.full((*values.shape[:-1], *image), np.nan, np.float32)
        result[..., good] = values
        return result

    result = replace(
        seen.first,
        height_mm=whole(found.height_mm),
        sigma_mm=whole(found.sigma_mm),
        slope=whole(found.slope),
        slope_sigma=whole(found.slope_sigma),
        reason=reason,
        phases=seen.phases,
        settings=options.summary()
        | {"resolved": seen.first.settings["resolved"] | {"height": way, "axis": list(AXES)}},
    )
    if (reason == Reason.NO_IMAGE).any() and not (reason == Reason.OK).any():
        raise DecodeError(
            f"no pixel shows an image of the screen (no-image {result.reason_fractions()['no-image']:.1%}): the surface is matt, and "
            "mixes light of the whole screen; measure it with a projector"
        )
    require_some(result, options)
    return result


def _in_volume(found: Measured, stack: Stack, options: Options) -> NDArray[np.uint8]:
    assert stack.calibration is not None
    low, high = options.height_range_mm or stack.calibration.height_range_mm
    margin = VOLUME_MARGIN * (high - low)
    with np.errstate(invalid="ignore"):
        outside = ~((found.height_mm >= low - margin) & (found.height_mm <= high + margin))
    return np.where(
        outside & (found.reason == Reason.OK), Reason.OUT_OF_VOLUME, found.reason
    ).astype(np.uint8)
