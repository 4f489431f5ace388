"""Stacks with known heights, made from formulas alone: no renderer, no file."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import DTypeLike, NDArray

from scenes.acquisition.patterns import Axis, Frame, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt, Pinhole, Telecentric
from scenes.rig.projectors import PinholeProjector, TelecentricProjector

Map = NDArray[np.float64]
LENS = (-0.12, 0.05, 8e-4, -6e-4, 0.01)


def rig(
    camera: str = "telecentric",
    projector: str = "telecentric",
    lenses: bool = False,
    size: tuple[int, int] = (64, 48),
    heights_mm: tuple[float, float] = (-0.5, 3.0),
) -> Calibration:
    """A camera above the board and a tilted projector, 16 x 12 mm of field; `lenses`: both pinholes distort.

    The projector is off both axes of the board, so that columns and rows both shift with height.
    """
    columns, rows = size
    above, aside = LookAt(origin_mm=(0, 0, 60)), LookAt(origin_mm=(30, 18, 50))
    lens = LENS if lenses else (0.0,) * 5
    cameras = {
        "telecentric": Telecentric(resolution=size, pose=above, field_width_mm=16),
        "pinhole": Pinhole(
            resolution=size,
            pose=above,
            fx_px=columns * 60 / 16,
            fy_px=columns * 60 / 16,
            cx_px=columns / 2 + 0.7,
            cy_px=rows / 2 - 0.4,
            distortion=lens,
        ),
    }
    projectors = {
        "telecentric": TelecentricProjector(resolution=(400, 400), pose=aside, field_width_mm=40),
        "pinhole": PinholeProjector(
            resolution=(400, 400),
            pose=aside,
            fx_px=600,
            fy_px=600,
            cx_px=201.3,
            cy_px=198.2,
            reference_mm=60,
            distortion=lens,
        ),
    }
    return Calibration(
        camera=cameras[camera], projectors=(projectors[projector],), height_range_mm=heights_mm
    )


def hills(size: tuple[int, int] = (64, 48), top_mm: float = 2.0) -> Map:
    """A smooth height map (row, col) from 0 to `top_mm`, with a sharp step on its right."""
    columns, rows = size
    y, x = np.mgrid[:rows, :columns] / (rows, columns)[0]
    smooth = 0.5 * top_mm * (1.0 - np.cos(2.0 * np.pi * x) * np.cos(2.0 * np.pi * y)) / 1.0
    smooth = smooth / smooth.max() * top_mm
    smooth[:, columns * 7 // 8 :] = top_mm / 2.0
    return np.asarray(smooth, np.float64)


def coordinates(calibration: Calibration, height_mm: Map) -> tuple[Map, Map]:
    """Projector column and row that light the surface of that height, on each camera ray."""
    camera = calibration.camera.projection()
    pixels, _ = calibration.projectors[0].projection().project(camera.points_at(height_mm))
    return pixels[..., 0], pixels[..., 1]


def frames(
    at_px: dict[Axis, Map], patterns: Sequence[Frame], offset: float | Map, modulation: float | Map
) -> Map:
    """Ideal frames (frame, row, col): ``A + B cos(2 pi u / P + shift)``."""
    return np.stack(
        [
            offset
            + modulation * np.cos(2.0 * np.pi * at_px[f.axis] / f.period_px + f.phase_shift_rad)
            for f in patterns
        ]
    )


def digitise(
    ideal: Map, sigma_dn: float, dtype: DTypeLike, rng: np.random.Generator, top: float = 255.0
) -> NDArray[np.generic]:
    """Noise, then clipping at 0 and `top`, then rounding for whole-number types."""
    noisy = np.clip(ideal + rng.normal(0.0, sigma_dn, ideal.shape), 0.0, top)
    whole = np.issubdtype(np.dtype(dtype), np.integer)
    return (np.round(noisy) if whole else noisy).astype(dtype)


def calibrated_stack(
    calibration: Calibration,
    height_mm: Map,
    patterns: PhaseShift,
    *,
    sigma_dn: float = 0.0,
    dtype: DTypeLike = np.float32,
    offset: float | Map = 120.0,
    modulation: float | Map = 80.0,
    rng: np.random.Generator | None = None,
) -> Stack:
    """One exposure of a calibrated rig."""
    column, row = coordinates(calibration, height_mm)
    shown = patterns.frames()
    ideal = frames({"column": column, "row": row}, shown, offset, modulation)
    counts = digitise(ideal, sigma_dn, dtype, rng or np.random.default_rng(0))
    bits = 0 if np.dtype(dtype) == np.float32 else 8
    sensor = SimpleSensor(sigma_dn=sigma_dn, bits=bits)
    return Stack(counts[None], shown, (1.0,), sensor, calibration)
