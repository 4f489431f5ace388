"""What camera and projector of a rig see in common."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes import Calibration
from scenes.errors import SceneError

GRID = 61
# Of the camera's image: with less in common, nothing useful fits.
LEAST = 0.05


@dataclass(frozen=True)
class CommonField:
    """The part of a plane z = const that both devices see."""

    middle_mm: NDArray[np.float64]
    """Its median point (x, y)."""
    size_mm: tuple[float, float]
    """Sides of the largest rectangle about the middle, along x and y, whose edges both devices see."""


def common_field(rig: Calibration, projector: int = 0, height_mm: float = 0.0) -> CommonField:
    """The common field at one height. Raises `SceneError` where there is next to none."""
    camera, light = rig.camera.projection(), rig.projectors[projector].projection()
    u, v = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    origin, direction = camera.rays(np.stack([u, v], axis=-1))
    points = origin + (height_mm - origin[..., 2:]) / direction[..., 2:] * direction

    def seen(at: NDArray[np.float64]) -> NDArray[np.bool_]:
        both = []
        for device in (camera, light):
            pixels = device.project(at)[0]
            both.append(((pixels >= 0) & (pixels <= (device.width, device.height))).all(axis=-1))
        return np.asarray(both[0] & both[1])

    there = seen(points)
    if there.mean() < LEAST:
        raise SceneError(
            f"camera and projector see {there.mean():.0%} of the camera's image in common at z = {height_mm:g} mm: choose "
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
