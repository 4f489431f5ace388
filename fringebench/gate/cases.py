"""The cases that a decoder is judged on: one by formula, others rendered, small enough for a team's own test suite."""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import decode
import evaluation
import render
import scenes
from fringebench.gate.cached_light import light_of
from fringebench.progress import Steps
from scenes.acquisition.patterns import Axis
from scenes.rig.projection import Projection
from scenes.support.errors import DecodeError, SceneError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# In small images the camera's blur, so many pixels wide, would be many times as wide on the surface.
SHARP: dict[str, object] = {"sensor.psf": "none"}
# A fringe is nine camera pixels wide, as in larger images.
STEP: dict[str, object] = SHARP | {
    "camera.resolution": [128, 96],
    "patterns.periods_px": [64.0, 1024.0],
}
# Name -> shipped scene and its overrides. Small images; render noise, as low as each scene states, is the same in every repeat.
RENDERED: dict[str, tuple[str, dict[str, object]]] = {
    "highlight": (
        "chapter-trap",
        {
            "camera.resolution": [200, 150],
            # The chapter's one exposure, and two that do not saturate.
            "exposures.times_ms": [5.0, 13.5, 54.0],
        },
    ),
    "solder": ("solder", SHARP | {"camera.resolution": [200, 150]}),
    "grains": ("solder-grains", SHARP | {"camera.resolution": [160, 120]}),
    "ink-solder": ("ink-solder", SHARP | {"camera.resolution": [160, 120]}),
    # One cause each, on a step.
    "defocus": ("step", STEP | {"projectors.0.lens": {"aperture_mm": 12.0, "focus_mm": 290.0}}),
    "psf": ("step", STEP | {"sensor.psf": "diffraction"}),
    "gamma": ("step", STEP | {"projectors.0.gamma": 1.1}),
    "ambient": ("step", STEP | {"ambient.radiance_w_m2_sr": 20.0}),
    "vibration": ("step", STEP | {"vibration_um": 5.0}),
}
SWEEP = "sweep"
CASES = (SWEEP, *RENDERED)

# The sweep: a plane in bands of rows whose fringes peak at these multiples of saturation, and again at half the light.
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
    """One scene to decode, with its truth.

    Parameters
    ----------
    name
        Name of the case.
    stack
        Gives the stack with the noise of a seed.
    height_mm
        (row, col) true heights, NaN where the camera sees nothing.
    regions
        (row, col) mask of each region.
    unlit
        (row, col) pixels that no projector lights.
    sigma_mm
        (row, col) standard deviation that the frames allow, for decoders that claim none.
    mm_per_rad
        Height per phase of the finest pattern, median over the image.
    made_of
        What the case is made of, as text: figures of cases that differ in it are not compared.
    """

    name: str
    stack: Callable[[int], scenes.Stack]
    height_mm: Floats
    regions: dict[str, Mask]
    unlit: Mask
    sigma_mm: Floats
    mm_per_rad: float
    made_of: str = ""


def fingerprint(cases: Sequence[Case]) -> str:
    """Digest of what the cases are made of: figures of different cases are not compared."""
    return _digest(case.made_of for case in cases)


def shipped_fingerprint() -> str:
    """The fingerprint of the shipped cases, without making them."""
    return _digest(map(_made_of, CASES))


def _digest(texts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()[:16]


def _made_of(name: str) -> str:
    """What a shipped case is made of."""
    if name == SWEEP:
        return repr([SWEEP_RATIOS, SWEEP_RELATIVE, SWEEP_CONTRAST, SWEEP_SIGMA_DN, SWEEP_HEIGHT_MM])
    return _scene_text(scenes.load(*RENDERED[name]))


def _scene_text(scene: scenes.Scene) -> str:
    """A scene as text, without its name and description, and without keys that have their default."""
    tree = scene.model_dump(mode="json", exclude_defaults=True, exclude={"name", "description"})
    return json.dumps(tree, sort_keys=True)


def suite(
    names: tuple[str, ...] = CASES, steps: Steps | None = None, cache: Path | None = None
) -> tuple[Case, ...]:
    """Make shipped cases: trace the scenes and compute their truth, or read both from the folder `cache`.

    >>> suite(("sweep",))[0].height_mm.shape
    (80, 240)
    """
    shown = {name: None if name == SWEEP else scenes.load(*RENDERED[name]) for name in names}
    return _made(shown, steps, cache)


def scene_cases(
    loaded: Sequence[scenes.Scene], steps: Steps | None = None, cache: Path | None = None
) -> tuple[Case, ...]:
    """A case of each scene: the user's own rig, patterns and surfaces; `SceneError` for two of one name."""
    names = [scene.name for scene in loaded]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"two scenes are called '{name}': give each case a name of its own")
    return _made(dict(zip(names, loaded, strict=True)), steps, cache)


def _made(
    shown: Mapping[str, scenes.Scene | None], steps: Steps | None, cache: Path | None
) -> tuple[Case, ...]:
    """The case of each scene by name; None: the sweep."""
    steps = steps or Steps()
    made = []
    for name, scene in shown.items():
        with steps.step(f"prepare {name}"):
            made.append(sweep() if scene is None else scene_case(name, scene, cache))
    return tuple(made)


def scene_case(name: str, scene: scenes.Scene, cache: Path | None = None) -> Case:
    """Render a scene into a case: light once, noise for each seed."""
    transport, truth = light_of(scene, cache)
    regions = {label: evaluation.scored(truth, label) for label in truth.labels}
    period_px, axis = finest(scene)
    per_rad = mm_per_rad(scene.calibration(), period_px, axis)
    return Case(
        name,
        lambda seed: render.expose(transport, seed=seed),
        truth.height_mm.astype(np.float64),
        regions,
        np.logical_not(truth.lit),
        predicted_sigma_mm(render.expose(transport, noise=False), per_rad),
        per_rad,
        _scene_text(scene),
    )


def plane_stack(scene: scenes.Scene) -> scenes.Stack:
    """A noise-free stack of a plane in the middle of a scene's working volume, by formula: something to try a decoder on."""
    calibration = scene.calibration()
    camera = calibration.camera.projection()
    middle = sum(calibration.height_range_mm) / 2.0
    top = scene.sensor.saturation_dn
    frames = []
    for frame in scene.frames:
        light = calibration.projectors[frame.projector].projection()
        column = np.nan_to_num(column_px(camera, light, middle, frame.axis))
        frames.append(top * (0.1 + 0.7 * frame.commanded(column)))
    # Exposures that depend on the light have no times yet: one represents them.
    times_ms = scene.exposures.times_ms or (1.0,)
    exposed = np.stack([np.stack(frames)] * len(times_ms))
    bits = scene.sensor.bits
    kind = np.float32 if not bits else np.uint8 if bits <= 8 else np.uint16
    counts = exposed.astype(kind) if not bits else np.rint(exposed).astype(kind)
    return scenes.Stack(counts, scene.frames, times_ms, scene.sensor, calibration)


def sweep() -> Case:
    """The case by formula: clipped fringes on a plane, without a renderer."""
    rows = BAND_ROWS * len(SWEEP_RATIOS)
    scene = scenes.load("chapter", {"camera.resolution": [240, rows]})
    calibration = scene.calibration()
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
    per_rad = mm_per_rad(calibration, *finest(scene))
    return Case(
        SWEEP,
        stack,
        np.full(shape, SWEEP_HEIGHT_MM),
        regions,
        np.zeros(shape, np.bool_),
        predicted_sigma_mm(stack(None), per_rad),
        per_rad,
        _made_of(SWEEP),
    )


def finest(scene: scenes.Scene) -> tuple[float, Axis]:
    """Period in projector pixels, and axis, of the finest pattern: a fringe, or a Gray code's cell as a quarter fringe."""
    fringes = [frame for frame in scene.frames if frame.kind == "fringe"]
    if fringes:
        frame = min(fringes, key=lambda frame: frame.period_px)
        return frame.period_px, frame.axis
    frame = min(
        (frame for frame in scene.frames if frame.kind == "gray"), key=lambda frame: frame.period_px
    )
    return 4.0 * frame.period_px, frame.axis


def column_px(
    camera: Projection, light: Projection, height_mm: float, axis: Axis = "column"
) -> Floats:
    """Projector column (or row) that each camera pixel (row, col) sees on a plane at that height."""
    pixels, _ = light.project(camera.points_at(height_mm))
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
