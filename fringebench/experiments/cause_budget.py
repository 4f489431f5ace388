"""Error budget of a scene: each cause is switched off and on, and the scene traced, exposed, decoded and scored."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import evaluation
import render
import scenes
from evaluation.scoring.error_budget import Causes, ErrorBudget, variants
from evaluation.scoring.error_budget import budget as add_up
from fringebench.progress import StepProgress, Steps
from render.light_noise import height_noise_mm
from scenes.acquisition.sensor import Emva, Sensor, without_blur
from scenes.rig.devices import EVEN
from scenes.support.errors import DecodeError, FringebenchError

Floats = NDArray[np.float64]

CAUSES = (
    "noise",
    "quantisation",
    "saturation",
    "interreflection",
    "defocus",
    "footprint",
    "psf",
    "projector-pixels",
    "gamma",
    "projector-quantisation",
    "vignetting",
    "vibration",
    "source",
    "speckle",
    "bit-planes",
    "conveyor",
    "rolling-shutter",
)
# Causes that are in traced light, and causes that differ from picture to picture.
OPTICAL = frozenset(CAUSES[4:6] + CAUSES[7:11])
TRACED = OPTICAL | {"interreflection"}
RANDOM = frozenset({"noise", "vibration", "source", "speckle", "bit-planes", "conveyor"})
EXPOSED = RANDOM | {"rolling-shutter"}
# Electrons; a full well that no light fills.
BOTTOMLESS_E = 1e12


def budget(
    scene: scenes.Scene, seed: int = 0, repeats: int = 4, steps: Steps | None = None, **choices: Any
) -> ErrorBudget:
    """Switch causes off one at a time, and on one at a time, and measure the height errors of each region.

    Causes are ``noise`` (of the sensor, with its fixed pattern), ``quantisation`` (rounding to digital numbers),
    ``saturation`` (clipping; without it the longest exposure is used everywhere, so it interacts with noise),
    ``interreflection`` (light that met more than one surface), ``psf`` (the camera's blur), ``vibration`` (of the scene),
    ``source`` (fluctuation of the projectors, flicker of ambient light), ``speckle`` (of coherent projectors), ``defocus`` (lenses of camera and projectors),
    ``bit-planes`` (of micromirror devices, where an exposure is no whole number of frames), ``conveyor`` (motion along x and y), ``rolling-shutter`` (rows that see the next pattern), ``footprint`` (the width of a pixel; without it only the ray of its centre counts), ``projector-pixels`` (squares, gaps
    and blur of the projector), ``gamma`` and ``projector-quantisation`` (its tone curve and bits) and ``vignetting`` (of all
    devices). The sensor's non-linearity counts as saturation. Causes that the scene does not have are left out. Exposure
    times are always those of the complete scene. `choices` are options of `decode.reconstruct`.

    Render noise is a cause of its own (``render-noise``). Raises `FringebenchError` for fewer than 1 repeat.
    """
    if repeats < 1:
        raise FringebenchError(f"repeats = {repeats}: needs 1 or more")
    scene.calibration().require_projectors("an error budget")
    # An invalid option is reported before light is traced, not after.
    decode.Options.of(choices).rule()
    steps = steps or Steps()
    causes = [cause for cause in CAUSES if has_cause(scene, cause)]
    lights: dict[Causes, render.Transport] = {}
    slopes: dict[Causes, render.Transport] = {}
    moved: dict[Causes, list[render.Transport]] = {}
    noise: dict[Causes, NDArray[np.float32]] = {}
    surfaces = render.surfaces(scene)
    truth = None
    errors: dict[Causes, Floats] = {}
    times: Sequence[float] = ()
    for on in variants(causes):
        optical: Causes = on & TRACED
        if optical not in lights:
            name = "trace light with " + (", ".join(sorted(optical)) or "ideal optics")
            with steps.step(name) as done:
                lights[optical] = _trace(scene, on, seed, done, surfaces)
        if "vibration" in on and optical not in slopes:
            with steps.step("trace how light changes with height"):
                footprint = float("footprint" in on)
                slopes[optical] = render.height_slope(lights[optical], surfaces, footprint)
        if truth is None:  # the first variant has everything on
            truth = render.truth(scene, lights[optical], surfaces)
            times = render.expose(lights[optical], seed=seed, steady=True).exposure_ms
        seen: Causes = on & (TRACED | {"psf"})
        if truth.render_noise_mm is not None and seen not in noise:
            own = height_noise_mm(_behind(lights[optical], on), truth.xyz_mm, truth.lit_by)
            assert own is not None
            noise[seen] = own
        if "conveyor" in on and optical not in moved:
            with steps.step("trace light of each picture"):
                lit = [frame.projector for frame in scene.frames for _ in times]
                footprint = float("footprint" in on)
                moved[optical] = list(render.conveyed(lights[optical], lit, surfaces, footprint))
        with steps.step("decode with " + (", ".join(sorted(on)) or "nothing against it")):
            slope = slopes.get(optical) if "vibration" in on else None
            pictures = moved.get(optical) if "conveyor" in on else None
            errors[on] = np.stack(
                [
                    _error_mm(
                        _expose(lights[optical], slope, pictures, on, times, seed + i),
                        truth,
                        choices,
                    )
                    for i in range(repeats if on & RANDOM else 1)
                ]
            )
    assert truth is not None
    regions = {label: evaluation.scored(truth, label) for label in truth.labels}
    absent = [cause for cause in CAUSES if cause not in causes]
    own_noise = {on: noise[on & (TRACED | {"psf"})] for on in errors} if noise else None
    return add_up(scene.name, causes, errors, regions, absent, own_noise)


def has_cause(scene: scenes.Scene, cause: str) -> bool:
    """Whether switching the cause off changes the scene."""
    if cause == "interreflection":
        return scene.sampling.depth > 1
    if cause == "quantisation":
        return scene.sensor.bits > 0
    if cause == "psf":
        return without_blur(scene.sensor) != scene.sensor
    if cause in ("noise", "saturation", "footprint"):
        return True
    return without_causes(scene, frozenset({cause})) != scene


def without_causes(scene: scenes.Scene, off: Causes) -> scenes.Scene:
    """The scene without the causes of its devices, of ambient light and of vibration that are off."""
    devices: dict[str, dict[str, Any]] = {"defocus": {"lens": None}, "vignetting": dict(EVEN)}
    emission = devices | {
        "gamma": {"gamma": 1.0},
        "projector-quantisation": {"bits": 0},
        "source": {"fluctuation": 0.0},
        "speckle": {"speckle_contrast": 0.0},
        "bit-planes": {"frame_ms": None},
    }

    def changes(known: dict[str, dict[str, Any]]) -> dict[str, Any]:
        return {key: value for c in off & known.keys() for key, value in known[c].items()}

    projectors = []
    for projector in scene.projectors:
        changed = projector.model_copy(update=changes(emission))
        if changed.frame_ms is not None and not changed.bits:
            # Planes need bits: as many as hardly round.
            changed = changed.model_copy(update={"bits": 16})
        if projector.pixelated:
            # Pixels stay where gamma and bits, which ask for them, are off.
            squares = "projector-pixels" not in off
            if changed.pixelated != squares:
                changed = changed.model_copy(update={"pixels": squares})
        projectors.append(changed)
    ambient = scene.ambient
    if "source" in off:
        ambient = ambient.model_copy(update={"flicker_depth": 0.0})
    sensor = scene.sensor
    if "rolling-shutter" in off and isinstance(sensor, Emva) and sensor.row_time_us:
        sensor = sensor.model_copy(update={"row_time_us": 0.0})
    return scene.model_copy(
        update={
            "camera": scene.camera.model_copy(update=changes(devices)),
            "projectors": tuple(projectors),
            "ambient": ambient,
            "sensor": sensor,
            "vibration_um": 0.0 if "vibration" in off else scene.vibration_um,
            "conveyor_um": (0.0, 0.0) if "conveyor" in off else scene.conveyor_um,
        }
    )


def _trace(
    scene: scenes.Scene, on: Causes, seed: int, done: StepProgress, surfaces: render.Surfaces
) -> render.Transport:
    changed = without_causes(scene, OPTICAL - on)
    if "interreflection" not in on:
        direct = changed.sampling.model_copy(update={"depth": 1})
        changed = changed.model_copy(update={"sampling": direct})
    footprint = float("footprint" in on)
    return render.trace(changed, seed=seed, footprint=footprint, progress=done, surfaces=surfaces)


def _behind(transport: render.Transport, on: Causes) -> render.Transport:
    """The light as the sensor of these causes sees it: with or without blur."""
    if "psf" in on:
        return transport
    scene = transport.scene
    return replace(transport, scene=scene.model_copy(update={"sensor": without_blur(scene.sensor)}))


def _expose(
    transport: render.Transport,
    slope: render.Transport | None,
    moved: list[render.Transport] | None,
    on: Causes,
    times: Sequence[float],
    seed: int,
) -> scenes.Stack:
    scene = transport.scene
    scene = without_causes(scene, EXPOSED - on)
    transport = replace(transport, scene=scene)
    sensor = _behind(transport, on).scene.sensor
    clips, rounds = "saturation" in on, "quantisation" in on
    used = sensor if clips else _unlimited(sensor)
    if not rounds:
        used = used.model_copy(update={"bits": 0})
    stack = render.expose(
        transport,
        seed=seed,
        sensor=used,
        exposures=times,
        noise="noise" in on,
        steady=not on & RANDOM,
        slope=slope,
        moved=moved,
    )
    frames = stack.frames
    if clips and not rounds:
        frames = np.clip(frames, 0.0, sensor.full_scale_dn).astype(np.float32)
    if rounds and not clips and sensor.bits:
        frames = np.rint(frames).astype(np.float32)
    # The decoder believes the sensor it was given, but for the saturation that is switched off.
    return scenes.Stack(
        frames,
        stack.patterns,
        stack.exposure_ms,
        sensor if clips else used,
        stack.calibration,
        stack.scene,
        stack.seed,
    )


def _unlimited(sensor: Sensor) -> Sensor:
    changes: dict[str, float] = {"bits": 0}
    if isinstance(sensor, Emva):
        changes["full_well_e"] = BOTTOMLESS_E
    return sensor.model_copy(update=changes)


def _error_mm(stack: scenes.Stack, truth: scenes.Truth, choices: dict[str, Any]) -> Floats:
    try:
        return evaluation.height_error_mm(decode.reconstruct(stack, **choices), truth)
    except DecodeError as error:
        if "no pixel could be decoded" not in str(error):
            raise
        return np.full(truth.height_mm.shape, np.nan)
