"""Phases that another program computed, as the frames that would show them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io
from numpy.typing import NDArray

from scenes.acquisition.patterns import Frame
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.capture_frames import OrderMap, PhaseMap, Shown
from scenes.support.errors import FileError

SUFFIXES = (".npy", ".mat")
OFFSET_DN, MODULATION_DN = 128.0, 100.0
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Made:
    """Frames of four steps that have the phases of some maps."""

    frames: NDArray[np.float32]
    """(1, frame, row, col), DN."""
    patterns: tuple[Frame, ...]
    sensor: SimpleSensor


def as_frames(files: Sequence[Path], shown: Sequence[Shown], size: tuple[int, int] | None) -> Made:
    """Four steps of each phase map, and of a phase as wide as the projector of `size` (columns, rows) where its order is known.

    Raises `FileError` for files that do not fit the manifest.
    """
    if len(files) != len(shown):
        raise FileError(
            f"{len(files)} files for {len(shown)} maps: give one file for each map, in order"
        )
    arrays = [_array(path) for path in files]
    if len({a.shape for a in arrays}) > 1:
        raise FileError(f"the maps have shapes {[a.shape for a in arrays]}: all must have one")
    planes: list[NDArray[np.float64]] = []
    patterns: list[Frame] = []
    sigmas = []
    for i, (one, array) in enumerate(zip(shown, arrays, strict=True)):
        if not isinstance(one, PhaseMap):
            if i == 0 or not isinstance(shown[i - 1], PhaseMap):
                raise FileError(f"frames.{i} is an order map: put it after its phase map")
            continue
        turns = array / TURN
        following = shown[i + 1] if i + 1 < len(shown) else None
        known = one.unwrapped
        if isinstance(following, OrderMap):
            turns, known = turns + np.round(arrays[i + 1]), True
        periods = [one.period_px]
        if known:
            if not np.isfinite(turns).any() or np.nanmin(turns) < -0.05:
                raise FileError(
                    f"'{files[i]}': orders are below 0 or absent: count them from 0, and state where that is with origin_px"
                )
            field_px = (size or (0, 0))[0 if one.axis == "column" else 1]
            widest = max(float(np.nanmax(turns)) + 1.0, field_px / one.period_px)
            periods.append(one.period_px * float(np.ceil(widest)))
        for period in periods:
            phase = TURN * turns * one.period_px / period
            back = TURN * one.origin_px / period
            for k in range(4):
                wave = np.nan_to_num(np.cos(phase + 0.5 * np.pi * k), nan=0.0)
                planes.append(OFFSET_DN + MODULATION_DN * wave)
                patterns.append(Frame(one.axis, period, k, 4, 0.5 * np.pi * k - back))
        sigmas.append(one.sigma_rad)
    # Four steps have a phase noise of sigma / (sqrt(2) B).
    sensor = SimpleSensor(bits=0, sigma_dn=float(np.sqrt(2.0)) * MODULATION_DN * min(sigmas))
    return Made(np.array(planes, np.float32)[None], tuple(patterns), sensor)


def _array(path: Path) -> NDArray[np.float64]:
    """The one array of real numbers with two axes in a file."""
    try:
        if path.suffix.lower() == ".npy":
            found = [np.load(path, allow_pickle=False)]
        else:
            found = [v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__")]
    # SciPy raises errors of many kinds for a damaged file.
    except Exception as error:
        raise FileError(f"'{path}' is no readable {path.suffix} file: {error}") from error
    maps = [np.asarray(a) for a in found]
    maps = [a for a in maps if a.ndim == 2 and a.dtype.kind in "fiu" and a.size > 1]
    if len(maps) != 1:
        raise FileError(
            f"'{path}' has {len(maps)} arrays of real numbers with two axes (row, col): write one map to a file"
        )
    return maps[0].astype(np.float64)
