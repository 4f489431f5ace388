"""Render noise, the noise of light paths: what a trace reached, and how it compares with the sensor's noise."""

from collections.abc import Mapping
from typing import Any

import evaluation
import render
import scenes
from fringebench.gate.cases import mm_per_rad

# Above this share of the sensor's noise, errors of a region are noticeably the simulation's own.
NOTICEABLE = 0.5


def figures(transport: render.Transport) -> dict[str, Any] | None:
    """What the trace was asked to reach and what it reached, with samples; None if samples were given instead.

    That is `render.RenderNoise` or `render.PhaseError` as data, the latter with the height error in mm.
    """
    error = transport.phase_error
    if transport.render_noise is not None:
        return transport.render_noise.to_dict() | {"samples": transport.samples}
    if error is None:
        return None
    found = error.to_dict() | {"samples": transport.samples, "height_mm": None}
    if error.reached_rad is not None:
        found["height_mm"] = error.reached_rad * _mm_per_rad(transport.scene)
    return found


def describe(light: Mapping[str, Any]) -> str:
    """`figures` in one line."""
    if "target" in light:
        return _describe_ratio(light)
    work = f"{light['passes']} passes, {light['samples']} samples per pixel"
    if light["reached_rad"] is None:
        return f"render noise: no pixel shows a fringe ({work})"
    limit = "below" if light["met"] else "not below"
    return (
        f"render noise: {light['reached_rad']:.2g} rad, {1e3 * light['height_mm']:.2g} µm of height, in 95 % of lit "
        f"pixels; {limit} the {light['target_rad']:.2g} rad requested ({work})"
    )


def _describe_ratio(light: Mapping[str, Any]) -> str:
    known = [ratio for ratio in light["reached"].values() if ratio is not None]
    cut = max(light.get("cut", {}).values(), default=None)
    work = f"{light['samples']} light paths per pixel"
    if cut is not None:
        work = f"light beyond sampling.depth: {cut:.1g}; {work}"
    if not known:
        return f"render noise: no label has a pixel that can be measured ({work})"
    limit = "within" if light["met"] else "more than"
    return f"render noise: up to {max(known):.2g} of the sensor's noise; {limit} the {light['target']:.2g} requested ({work})"


def describe_regions(score: evaluation.Score) -> str | None:
    """The worst region's render noise in one line, with the remedy where it is noticeable; None where it is not known."""
    known = {
        label: region.render_to_sensor_noise
        for label, region in score.regions.items()
        if region.render_to_sensor_noise is not None
    }
    if not known:
        return None
    if score.light is not None and "target" in score.light:
        return describe(score.light)
    worst = max(known, key=lambda label: known[label])
    said = f"render noise: up to {known[worst]:.2g} of the sensor's noise ({worst})"
    if known[worst] <= NOTICEABLE:
        return said
    return (
        f"warning: {said}: errors there are partly the simulation's own, which no camera has; trace with --render-noise "
        f"{NOTICEABLE:g}"
    )


def _mm_per_rad(scene: scenes.Scene) -> float:
    """Height per phase of the finest fringe along the more sensitive axis, which decoding uses."""
    calibration = scene.calibration()
    fringes = {(f.axis, f.period_px) for f in scene.frames if f.kind == "fringe"}
    return min(mm_per_rad(calibration, period, axis) for axis, period in fringes)
