"""The common field of the camera and a projector of a rig."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes import Calibration
from scenes.support.errors import SceneError

GRID = 61
# Minimum share of the camera image that the projector lights; with less, nothing useful fits.
MIN_SHARE = 0.05


@dataclass(frozen=True)
class CommonField:
    """The part of a plane z = const that both devices see, in mm."""

    middle_mm: NDArray[np.float64]
    """Median point (x, y), world mm."""
    size_mm: tuple[float, float]
    """Sides along x and y, mm, of the largest rectangle about the middle whose edges both devices see."""


def common_field(rig: Calibration, projector: int = 0, height_mm: float = 0.0) -> CommonField:
    """The common field of camera and projector in the plane z = `height_mm`; `SceneError` below 5 % of the camera
    image.

    >>> import scenes
    >>> field = common_field(scenes.load("step").calibration())
    >>> field.size_mm[0] > 10.0
    True
    """
    camera, light = rig.camera.projection(), rig.projectors[projector].projection()
    u, v = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    points = camera.points_at(height_mm, np.stack([u, v], axis=-1))

    def seen(at: NDArray[np.float64]) -> NDArray[np.bool_]:
        both = []
        for device in (camera, light):
            pixels = device.project(at)[0]
            both.append(((pixels >= 0) & (pixels <= (device.width, device.height))).all(axis=-1))
        return np.asarray(both[0] & both[1])

    there = seen(points)
    if there.mean() < MIN_SHARE:
        raise SceneError(
            f"camera and projector share {there.mean():.0%} of the camera image at z = {height_mm:g} mm: choose "
            "the height or distance at which the rig is used, or check the calibration's unit and direction"
        )
    middle = np.median(points[there][:, :2], axis=0)
    whole = np.ptp(points[there][:, :2], axis=0)
    edge = np.linspace(-0.5, 0.5, 21)
    unit = np.concatenate(
        [np.stack([side, edge], axis=-1) for side in (np.full(21, -0.5), np.full(21, 0.5))]
        + [np.stack([edge, side], axis=-1) for side in (np.full(21, -0.5), np.full(21, 0.5))]
    )
    scale = 1.0
    while scale > 0.02:
        flat = middle + unit * whole * scale
        if seen(np.column_stack([flat, np.full(len(flat), height_mm)])).all():
            break
        scale *= 0.95
    width, height = (float(side) for side in whole * scale)
    return CommonField(middle, (width, height))
