"""A projector to show patterns with, and what a basis makes of them."""

from typing import Any

import numpy as np

from scenes.acquisition.pattern_basis import Basis
from scenes.rig.devices import LookAt
from scenes.rig.projectors import TelecentricProjector


def projector(columns: int, rows: int, **emission: Any) -> TelecentricProjector:
    pose = LookAt(origin_mm=(-1, 0, 2))
    return TelecentricProjector(
        resolution=(columns, rows), pose=pose, field_width_mm=10.0, **emission
    )


def emitted(made: Basis, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Frames (frame, point) that a basis makes at continuous projector coordinates."""
    values = []
    for channel in made.channels:
        along = u if channel.axis == "column" else v
        if channel.kind == "one":
            values.append(np.ones_like(along))
        elif channel.kind == "table":
            values.append(np.asarray(channel.values)[np.floor(along).astype(int)])
        else:
            wave = np.cos if channel.kind == "cos" else np.sin
            values.append(wave(2 * np.pi * along / channel.period_px))
    return np.asarray(made.weights @ np.stack(values))
