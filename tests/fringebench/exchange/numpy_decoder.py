"""A decoder of 60 lines, written from the header of an exported manifest alone: NumPy, and OpenCV to read the images."""

import sys
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def heights_mm(manifest: Path) -> NDArray[np.float64]:
    """World z of each pixel (row, col), NaN where no exposure is free of clipped samples."""
    shot = tomllib.loads(manifest.read_text())
    paths = [str(manifest.parent / name) for name in shot["files"]]
    images = np.array([cv2.imread(path, cv2.IMREAD_UNCHANGED) for path in paths], dtype=float)
    images = images.reshape(len(shot["exposures_ms"]), -1, *images.shape[1:])
    usable = (images < shot["saturation_dn"]).all(axis=1)
    # The longest exposure without clipped samples, pixel by pixel.
    times = np.array(shot["exposures_ms"])[:, None, None]
    best = np.argmax(np.where(usable, times, 0.0), axis=0)
    frames = np.take_along_axis(images, best[None, None], axis=0)[0]
    start, sets = 0, []
    for fringe in shot["frames"]:
        k = np.arange(fringe["steps"])[:, None, None]
        shift = 2 * np.pi * fringe["direction"] * k / fringe["steps"]
        shown = frames[start : start + fringe["steps"]]
        start += fringe["steps"]
        phase = np.arctan2(-(shown * np.sin(shift)).sum(0), (shown * np.cos(shift)).sum(0))
        phase -= np.deg2rad(fringe["first_phase_deg"])
        sets.append((fringe["period_px"], phase, fringe["origin_px"]))
    sets.sort(key=lambda one: -one[0])
    rig = shot["rig"]
    column = _anchored(rig, *sets[0], shot["projector_resolution"][0])
    for period, phase, origin in sets[1:]:
        fraction = phase / (2 * np.pi) % 1.0
        column = origin + period * (np.round((column - origin) / period - fraction) + fraction)
    return np.where(usable.any(axis=0), triangulated(rig, column), np.nan)


def _anchored(
    rig: Any, period: float, phase: NDArray[np.float64], origin: float, width: int
) -> NDArray[np.float64]:
    """Column of the coarsest fringes: of all orders, the one whose height is in the working volume."""
    low, high = rig["height_range_mm"]
    column = np.full(phase.shape, np.nan)
    for order in range(int(np.ceil(width / period))):
        one = origin + period * (phase / (2 * np.pi) % 1.0 + order)
        height = triangulated(rig, one)
        column = np.where((low < height) & (height < high), one, column)
    return column


def triangulated(rig: Any, column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the ray of each pixel meets the plane of its projector column; devices without distortion."""
    eye, lamp = rig["camera"], rig["projectors"][0]
    R, t = np.array(eye["pose"]["R"]), np.array(eye["pose"]["t_mm"])
    v, u = np.indices(column.shape) + 0.5
    if eye["model"] == "telecentric":
        scale = eye["resolution"][0] / eye["field_width_mm"]
        across = (u - eye["resolution"][0] / 2) / scale, (v - eye["resolution"][1] / 2) / scale
        start = (np.stack([*across, np.zeros_like(u)], axis=-1) - t) @ R
        ray = np.broadcast_to(R[2], start.shape)
    else:
        x, y = (u - eye["cx_px"]) / eye["fx_px"], (v - eye["cy_px"]) / eye["fy_px"]
        ray = np.stack([x, y, np.ones_like(x)], axis=-1) @ R
        start = np.broadcast_to(-R.T @ t, ray.shape)
    S, s = np.array(lamp["pose"]["R"]), np.array(lamp["pose"]["t_mm"])
    # All points of the column's plane have x - slope z = shift in the projector's frame.
    slope, shift = (column - lamp.get("cx_px", 0.0)) / lamp.get("fx_px", 1.0), 0.0 * column
    if lamp["model"] == "telecentric":
        scale = lamp["resolution"][0] / lamp["field_width_mm"]
        slope, shift = 0.0 * column, (column - lamp["resolution"][0] / 2) / scale
    normal = S[0] - slope[..., None] * S[2]
    distance = (shift - (normal * start).sum(-1) - s[0] + slope * s[2]) / (normal * ray).sum(-1)
    return np.asarray(start[..., 2] + distance * ray[..., 2])


if __name__ == "__main__":
    np.save(sys.argv[2], heights_mm(Path(sys.argv[1])))
