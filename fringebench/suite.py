"""The cases a decoder is tried on: one by formula, the others rendered, small enough to run beside a team's own tests."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import decode
import evaluation
import render
import scenes
from fringebench.progress import Steps
from scenes.errors import DecodeError
from scenes.patterns import Axis
from scenes.rig import Projection

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Name -> shipped scene and what is changed of it. Small images, few paths: light's own noise is the same in every repeat.
RENDERED: dict[str, tuple[str, dict[str, object]]] = {
    "highlight": (
        "chapter-trap",
        {
            "camera.resolution": [200, 150],
            "sampling.samples": 16,
            # The chapter's one exposure, and what would have saved it.
            "exposures.times_ms": [5.0, 13.5, 54.0],
        },
    ),
    "solder": ("solder", {"camera.resolution": [200, 150], "sampling.samples": 16}),
    "grains": (
        "solder-grains",
        # Of fewer samples single bright pixels at the edge of gross errors come and go with the sensor's noise.
        {"camera.resolution": [160, 120], "sampling.samples": 64, "sampling.depth": 2},
    ),
    "ink-solder": ("ink-solder", {"camera.resolution": [160, 120], "sampling.samples": 16}),
}
SWEEP = "sweep"
CASES = (SWEEP, *RENDERED)

# The sweep: a plane, in bands of rows whose fringes peak at these multiples of saturation, and again at half the light.
SWEEP_RATIOS = (0.9, 1.1, 1.25, 1.5, 1.75)
SWEEP_RELATIVE = (0.5, 1.0)
SWEEP_CONTRAST = 0.8
SWEEP_SIGMA_DN = 1.5
SWEEP_HEIGHT_MM = 2.0
BAND_ROWS = 16
# Sigma of a pixel for which the frames predict none, for decoders that claim none either: a phase noise of 1/20 rad.
UNKNOWN_RAD = 0.05


@dataclass(frozen=True, eq=False)
class Case:
    """One thing to decode, as often as wanted, and what should come out."""

    name: str
    stack: Callable[[int], scenes.Stack]
    """The stack with that seed's noise."""
    height_mm: Floats
    """(row, col) truth, NaN where the camera sees nothing."""
    regions: dict[str, Mask]
    unlit: Mask
    sigma_mm: Floats
    """(row, col) what the frames predict, for decoders that claim no sigma."""
    mm_per_rad: float
    """Height per phase of the finest fringe, median over the image."""


def fingerprint(names: tuple[str, ...]) -> str:
    """Of what the cases are made of: figures of suites with different ones do not compare."""
    return hashlib.sha256("\n".join(map(_made_of, names)).encode()).hexdigest()[:16]


def _made_of(name: str) -> str:
    if name == SWEEP:
        return repr([SWEEP_RATIOS, SWEEP_RELATIVE, SWEEP_CONTRAST, SWEEP_SIGMA_DN, SWEEP_HEIGHT_MM])
    # Words change no light, and neither does a key that a later version adds with its default.
    scene = scenes.load(*RENDERED[name]).model_dump(
        mode="json", exclude_defaults=True, exclude={"name", "description"}
    )
    return json.dumps(scene, sort_keys=True)


def suite(names: tuple[str, ...] = CASES, steps: Steps | None = None) -> tuple[Case, ...]:
    """Make the cases: trace the scenes, and find their truth."""
    steps = steps or Steps()
    made = []
    for name in names:
        with steps.step(f"prepare {name}"):
            made.append(_sweep() if name == SWEEP else _rendered(name))
    return tuple(made)


def _rendered(name: str) -> Case:
    source, overrides = RENDERED[name]
    scene = scenes.load(source, overrides)
    surfaces = render.surfaces(scene)
    transport = render.trace(scene, surfaces=surfaces)
    truth = render.truth(scene, transport, surfaces)
    lit = truth.lit
    regions = {label: evaluation.scored(truth, label) for label in truth.labels}
    per_rad = mm_per_rad(scenes.Calibration.of(scene), finest_px(scene))
    return Case(
        name,
        lambda seed: render.expose(transport, seed=seed),
        truth.height_mm.astype(np.float64),
        regions,
        np.logical_not(lit),
        predicted_sigma_mm(render.expose(transport, noise=False), per_rad),
        per_rad,
    )


def _sweep() -> Case:
    rows = BAND_ROWS * len(SWEEP_RATIOS)
    scene = scenes.load("chapter", {"camera.resolution": [240, rows]})
    calibration = scenes.Calibration.of(scene)
    frames = scene.frames
    camera, light = calibration.camera.projection(), calibration.projectors[0].projection()
    column = column_px(camera, light, SWEEP_HEIGHT_MM)
    sensor = scenes.SimpleSensor(bits=8, sigma_dn=SWEEP_SIGMA_DN)
    peak = np.repeat(SWEEP_RATIOS, BAND_ROWS)[:, None] * sensor.saturation_dn
    mean = peak / (1.0 + SWEEP_CONTRAST)
    fringes = np.stack(
        [
            mean
            * (
                1.0
                + SWEEP_CONTRAST
                * np.cos(2 * np.pi * column / frame.period_px + frame.phase_shift_rad)
            )
            for frame in frames
        ]
    )

    light_dn = np.multiply.outer(SWEEP_RELATIVE, fringes)

    def stack(seed: int | None) -> scenes.Stack:
        noise: Floats | float = 0.0
        if seed is not None:
            noise = SWEEP_SIGMA_DN * np.random.default_rng([seed, 1]).standard_normal(
                light_dn.shape
            )
        counts = np.clip(np.rint(light_dn + noise), 0, sensor.full_scale_dn).astype(np.uint8)
        return scenes.Stack(counts, frames, SWEEP_RELATIVE, sensor, calibration, seed=seed)

    bands = np.repeat(np.arange(len(SWEEP_RATIOS)), BAND_ROWS)[:, None]
    shape = column.shape
    regions = {
        f"ratio-{ratio:.2f}": np.broadcast_to(bands == i, shape)
        for i, ratio in enumerate(SWEEP_RATIOS)
    }
    per_rad = mm_per_rad(calibration, finest_px(scene))
    return Case(
        SWEEP,
        stack,
        np.full(shape, SWEEP_HEIGHT_MM),
        regions,
        np.zeros(shape, np.bool_),
        predicted_sigma_mm(stack(None), per_rad),
        per_rad,
    )


def finest_px(scene: scenes.Scene) -> float:
    """Period of the finest fringe."""
    return min(frame.period_px for frame in scene.frames if frame.kind == "fringe")


def column_px(
    camera: Projection, light: Projection, height_mm: float, axis: Axis = "column"
) -> Floats:
    """Projector column (or row) that a plane at that height shows each camera pixel, (row, col)."""
    origin, direction = camera.rays(camera.pixel_centres())
    distance = (height_mm - origin[..., 2]) / direction[..., 2]
    pixels, _ = light.project(origin + distance[..., None] * direction)
    column: Floats = pixels[..., 0 if axis == "column" else 1]
    return column


def mm_per_rad(calibration: scenes.Calibration, period_px: float, axis: Axis = "column") -> float:
    """Height per radian of phase along an axis, about the middle of the working volume, median over the image."""
    camera, light = calibration.camera.projection(), calibration.projectors[0].projection()
    low, high = calibration.height_range_mm
    middle, small = (low + high) / 2, (high - low) * 1e-3
    shift = column_px(camera, light, middle + small, axis) - column_px(
        camera, light, middle - small, axis
    )
    return float(abs(2 * small / np.nanmedian(shift)) * period_px / (2 * np.pi))


def predicted_sigma_mm(noiseless: scenes.Stack, per_rad: float) -> Floats:
    """(row, col) standard deviation that the frames allow, by decoding them without noise; `UNKNOWN_RAD` where that fails."""
    unknown = UNKNOWN_RAD * per_rad
    try:
        clean = decode.reconstruct(noiseless)
    except DecodeError:
        return np.full(noiseless.frames.shape[2:], unknown)
    known = clean.valid & np.isfinite(clean.sigma_mm)
    return np.where(known, clean.sigma_mm, unknown)
