"""How far light's own noise was brought down, where a phase error was asked for: as data, and in words."""

from collections.abc import Mapping
from typing import Any

import render
import scenes
from fringebench.suite import mm_per_rad


def figures(transport: render.Transport) -> dict[str, Any] | None:
    """What `render.PhaseError` says, samples, and the height that the error is worth; None where samples were given."""
    error = transport.phase_error
    if error is None:
        return None
    found = error.to_dict() | {"samples": transport.samples, "height_mm": None}
    if error.reached_rad is not None:
        found["height_mm"] = error.reached_rad * _mm_per_rad(transport.scene)
    return found


def told(light: Mapping[str, Any]) -> str:
    """`figures` in a line."""
    work = f"{light['passes']} passes, {light['samples']} samples per pixel"
    if light["reached_rad"] is None:
        return f"light's own noise: no pixel shows a fringe ({work})"
    limit = "below" if light["met"] else "not below"
    return (
        f"light's own noise: {light['reached_rad']:.2g} rad, {1e3 * light['height_mm']:.2g} µm of height, in 95 % of lit "
        f"pixels; {limit} the {light['target_rad']:.2g} rad asked for ({work})"
    )


def _mm_per_rad(scene: scenes.Scene) -> float:
    """Of the finest fringe of the axis that is more sensitive to height, which decoding uses."""
    calibration = scenes.Calibration.of(scene)
    fringes = {(f.axis, f.period_px) for f in scene.frames if f.kind == "fringe"}
    return min(mm_per_rad(calibration, period, axis) for axis, period in fringes)
