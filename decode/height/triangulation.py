"""Heights from projector coordinates of any source, by the calibration alone."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from decode.height.calibrated_view import CalibratedView, view_of
from scenes.acquisition.patterns import Axis
from scenes.rig.calibration import Calibration
from scenes.support.errors import DecodeError

# An axis that shifts this many times less with height than the other adds nothing to it.
INSENSITIVE = 0.01


def triangulate(
    column_px: ArrayLike | None,
    calibration: Calibration,
    *,
    row_px: ArrayLike | None = None,
    projector: int = 0,
) -> NDArray[np.float64]:
    """Heights where each camera ray meets the projector column (or row) that lights its pixel.

    Parameters
    ----------
    column_px
        Projector column of each camera pixel, (row, col), px; continuous, pixel centres at + 0.5. NaN: unknown. None: use
        `row_px` alone.
    calibration
        Camera and projectors; its camera has as many pixels as the coordinates.
    row_px
        Projector row of each camera pixel, like `column_px`. With both, heights are averaged with the weights
        ``(d coordinate / d height)^2``, which is best for equal noise in both; where one is NaN, the other is used.
    projector
        Index of the projector.

    Returns
    -------
    NDArray[np.float64]
        World z in mm, (row, col); NaN where the coordinate is NaN or the ray does not meet it.

    Raises
    ------
    DecodeError
        No coordinates, another shape than the camera's, an unknown projector, or fringes along the baseline.

    Notes
    -----
    Closed form (a ray meets a plane) without lens distortion of the projector, else Newton's method; float64.

    Examples
    --------
    A telecentric camera looks straight down, 0.1 mm a pixel; a telecentric projector comes in at 45 degrees:

    >>> from scenes.rig.devices import LookAt, Telecentric
    >>> from scenes.rig.projectors import TelecentricProjector
    >>> rig = Calibration(
    ...     camera=Telecentric(resolution=(40, 30), pose=LookAt(origin_mm=(0, 0, 50)), field_width_mm=4),
    ...     projectors=(TelecentricProjector(
    ...         resolution=(100, 100), pose=LookAt(origin_mm=(50, 0, 50)), field_width_mm=10),),
    ...     height_range_mm=(-1, 1),
    ... )
    >>> heights = triangulate(np.full((30, 40), 50.0), rig)
    >>> heights.shape, bool(abs(heights[15, 20]) < 0.1)
    ((30, 40), True)
    """
    view = view_of(calibration, projector)
    given: dict[Axis, NDArray[np.float64]] = {}
    if column_px is not None:
        given["column"] = _checked(column_px, view, "column_px")
    if row_px is not None:
        given["row"] = _checked(row_px, view, "row_px")
    if not given:
        raise DecodeError("neither column_px nor row_px is given: give one of them or both")
    best = max(view.sensitivity(axis) for axis in given)
    total = weights = np.zeros(next(iter(given.values())).shape)
    for axis, at_px in given.items():
        if view.sensitivity(axis) < INSENSITIVE * best:
            continue
        height, slope = _meet(view, axis, at_px)
        known = np.isfinite(height)
        weight = np.where(known, slope**2, 0.0)
        total = total + weight * np.where(known, height, 0.0)
        weights = weights + weight
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / weights


def _meet(
    view: CalibratedView, axis: Axis, at_px: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Height in mm and d coordinate / d height in px per mm, (row, col)."""
    rig = view.kernel_rig(axis)
    centres = rig.camera.pixel_centres()
    ray = rig.ray(centres[..., 0], centres[..., 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        t, slope = rig.meet(ray, at_px, axis)
        height = ray.world_origin[2] + t * ray.world_direction[2]
        return np.asarray(height), np.asarray(1.0 / (slope * ray.world_direction[2]))


def _checked(at_px: ArrayLike, view: CalibratedView, name: str) -> NDArray[np.float64]:
    coordinates = np.asarray(at_px, np.float64)
    camera = view.rig.camera
    if coordinates.shape != (camera.height, camera.width):
        raise DecodeError(
            f"{name} has shape {coordinates.shape}: expected (row, col) of the calibration's camera, "
            f"{(camera.height, camera.width)}"
        )
    return coordinates
