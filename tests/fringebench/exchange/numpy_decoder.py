"""A decoder of 40 lines, written from the header of an exported manifest alone: NumPy, and OpenCV to read the images."""

import sys
import tomllib
from pathlib import Path

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
    column = np.zeros(best.shape)
    start, sets = 0, []
    for fringe in shot["frames"]:
        k = np.arange(fringe["steps"])[:, None, None]
        shift = 2 * np.pi * fringe["direction"] * k / fringe["steps"]
        shown = frames[start : start + fringe["steps"]]
        start += fringe["steps"]
        phase = np.arctan2(-(shown * np.sin(shift)).sum(0), (shown * np.cos(shift)).sum(0))
        phase -= np.deg2rad(fringe["first_phase_deg"])
        sets.append((fringe["period_px"], phase, fringe["origin_px"]))
    for i, (period, phase, origin) in enumerate(sorted(sets, key=lambda s: -s[0])):
        fraction = phase / (2 * np.pi) % 1.0
        order = 0.0 if i == 0 else np.round((column - origin) / period - fraction)
        column = origin + period * (order + fraction)
    return np.where(usable.any(axis=0), triangulated(shot["rig"], column), np.nan)


def triangulated(rig: dict, column: NDArray[np.float64]) -> NDArray[np.float64]:  # type: ignore[type-arg]
    """Where the ray of each pixel meets the plane of its projector column; pinholes without distortion."""
    eye, lamp = rig["camera"], rig["projectors"][0]
    R, t = np.array(eye["pose"]["R"]), np.array(eye["pose"]["t_mm"])
    v, u = np.indices(column.shape) + 0.5
    x, y = (u - eye["cx_px"]) / eye["fx_px"], (v - eye["cy_px"]) / eye["fy_px"]
    direction = np.stack([x, y, np.ones_like(x)], axis=-1) @ R
    origin = -R.T @ t
    S, s = np.array(lamp["pose"]["R"]), np.array(lamp["pose"]["t_mm"])
    # x - x' z = 0 for all points of the column's plane.
    slope = (column - lamp["cx_px"]) / lamp["fx_px"]
    normal = S[0] - slope[..., None] * S[2]
    distance = -(normal @ origin + s[0] - slope * s[2]) / (normal * direction).sum(-1)
    return np.asarray(origin[2] + distance * direction[..., 2])


if __name__ == "__main__":
    np.save(sys.argv[2], heights_mm(Path(sys.argv[1])))
