"""Stereo by phase: two cameras that see the same fringes need no calibrated projector.

A surface point shows both cameras the same projector coordinate (Zhang & Yau 2008). Candidates come from a grid of epipolar
lines (`decode.stereo_phase.epipolar_grid`); each is then refined on the left pixel's exact ray, lens distortion of both
cameras included, until the right camera's map shows the left pixel's coordinate. Where both axes were decoded, the other one
must agree too.
"""

from dataclasses import replace

import numpy as np

from decode.fusion.interface import FusionRule
from decode.options import Anchor, Backend, Gamma, Options, Roi, Saturation, Unwrap, known_options
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from decode.stereo_phase.pair_search import CoordinateMaps, PairSearch, Progress
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import Pinhole
from scenes.rig.projectors import PinholeProjector
from scenes.support.errors import DecodeError
from scenes.support.memory import room_for

# Memory per pixel of either camera, as measured.
PIXEL_BYTES = 400


@known_options
def stereo(
    left: Stack,
    right: Stack,
    cameras: tuple[Pinhole, Pinhole],
    heights_mm: tuple[float, float],
    *,
    fusion: str | FusionRule = "max-modulation",
    exposure: int | None = None,
    saturation: Saturation = "reject",
    unwrap: Unwrap | None = None,
    anchor: Anchor | None = None,
    gamma: Gamma | None = None,
    roi: Roi | None = None,
    min_modulation_dn: float | None = None,
    min_relative_modulation: float = STRAY_FRACTION,
    max_order_residual: float = 0.25,
    backend: Backend | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Heights of the left camera's pixels from two cameras and an uncalibrated projector.

    Parameters
    ----------
    left, right
        Frames (exposure, frame, row, col) in DN of the two cameras, under the same patterns.
    cameras
        Left and right camera, in one world, mm.
    heights_mm
        Lowest and highest world z that is searched, mm.
    fusion, exposure, saturation, unwrap, anchor, gamma, min_modulation_dn, min_relative_modulation, max_order_residual, backend
        As in `decode.reconstruct`.
    roi
        (row0, row1, col0, col1) of the left image in px, ends exclusive, or a boolean mask (row, col).
    progress
        Called with the share that is done, from 0 to 1.

    Returns
    -------
    Reconstruction
        Images (row, col) of the left camera. Its calibration holds the right camera in the projector's place, as the inverse
        camera it is.

    Raises
    ------
    DecodeError
        The stacks do not show the same patterns, do not fit their cameras, or nothing matches.
    TooLargeError
        More pixels than memory holds.

    Examples
    --------
    >>> rec = stereo(left, right, cameras, (-900.0, -400.0))  # doctest: +SKIP
    """
    _check(left, right, cameras, heights_mm)
    done = progress or (lambda share: None)
    options = Options(
        fusion=fusion,
        exposure=exposure,
        saturation=saturation,
        unwrap=unwrap,
        anchor=anchor,
        gamma=gamma,
        height="phase",
        min_modulation_dn=min_modulation_dn,
        min_relative_modulation=min_relative_modulation,
        max_order_residual=max_order_residual,
        backend=backend,
    )
    pixels = sum(stack.resolution[0] * stack.resolution[1] for stack in (left, right))
    with room_for(PIXEL_BYTES * pixels, f"stereo of {pixels} pixels", "choose smaller images"):
        views = []
        for stack, choices in ((left, replace(options, roi=roi)), (right, options)):
            views.append(CoordinateMaps.of(replace(stack, calibration=None), choices))
            done(0.1 * len(views))
        axis = _axis(views[0].rec, cameras, heights_mm)
        lenses = cameras[0].projection(), cameras[1].projection()
        search = PairSearch(views[0], views[1], *lenses, axis, heights_mm)
        height, sigma = search.heights(done)
    rec = views[0].rec
    reason = np.where(rec.valid & ~np.isfinite(height), Reason.NO_HEIGHT, rec.reason)
    if not (reason == Reason.OK).any():
        raise DecodeError(
            f"no left pixel finds its match within {list(heights_mm)} mm: check the calibration and the heights"
        )
    second = cameras[1].model_dump(exclude={"model"})
    return replace(
        rec,
        height_mm=height.astype(np.float32),
        sigma_mm=sigma.astype(np.float32),
        reason=reason.astype(np.uint8),
        axis=axis,
        calibration=Calibration(
            camera=cameras[0],
            projectors=(PinholeProjector(**second, reference_mm=1.0),),
            height_range_mm=heights_mm,
        ),
        settings=dict(rec.settings) | {"height": "stereo"},
    )


def _check(
    left: Stack, right: Stack, cameras: tuple[Pinhole, Pinhole], heights_mm: tuple[float, float]
) -> None:
    if left.patterns != right.patterns:
        raise DecodeError("the two stacks show different patterns: stereo needs the same sequence")
    for name, stack, camera in (("left", left, cameras[0]), ("right", right, cameras[1])):
        camera.projection().require_shape(
            stack.frames.shape[2:], f"the {name} stack's frames", DecodeError
        )
    if not heights_mm[0] < heights_mm[1]:
        raise DecodeError(f"heights_mm is {heights_mm}: the first must be below the second")
    origins = [camera.projection().origin_mm for camera in cameras]
    if heights_mm[1] >= origins[0][2]:
        raise DecodeError(
            f"heights_mm {list(heights_mm)} reach the left camera, which is at {origins[0][2]:g} mm: search below it"
        )
    if np.allclose(origins[0], origins[1]):
        raise DecodeError(
            "both cameras are at one place: stereo needs a distance between them; check the calibration's translation"
        )


def _axis(
    rec: Reconstruction, cameras: tuple[Pinhole, Pinhole], heights_mm: tuple[float, float]
) -> Axis:
    """The projector axis that changes most along the right image's way of a point that rises."""
    if len(rec.phases) == 1:
        return next(iter(rec.phases))
    left, right = (camera.projection() for camera in cameras)
    low, high = right.project(left.points_at(heights_mm, [left.width / 2.0, left.height / 2.0]))[0]
    way = high - low
    gradients = {}
    for axis, phase in rec.phases.items():
        at = np.where(rec.valid, phase.coordinate_px, np.nan)
        # The left map's slope is used for the right one's: the cameras look at the same fringes.
        slope = np.array([np.nanmedian(np.diff(at, axis=1)), np.nanmedian(np.diff(at, axis=0))])
        gradients[axis] = abs(float(slope @ way))
    return max(gradients, key=lambda axis: gradients[axis])
