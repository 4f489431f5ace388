"""An error budget of a scene: every cause switched off and on, traced, exposed, decoded, and held against the truth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
import evaluation
import render
import scenes
from evaluation.budget import Budget, Causes, variants
from evaluation.budget import budget as add_up
from fringebench.progress import Report, Steps
from scenes.errors import DecodeError, FringebenchError
from scenes.sensor import Emva, Sensor

Floats = NDArray[np.float64]

# Causes in the light, which need another trace, and causes in the sensor.
OPTICAL = ("defocus", "gamma", "footprint")
CAUSES = ("noise", "quantisation", "saturation", "interreflection", *OPTICAL)
# A full well that no light here fills.
BOTTOMLESS_E = 1e12


def budget(
    scene: scenes.Scene,
    seed: int = 0,
    repeats: int = 4,
    steps: Steps | None = None,
    **choices: Any,
) -> Budget:
    """Switch causes off one at a time, and on one at a time, and see what each does to each region's heights.

    ``noise``: the sensor's, fixed pattern included. ``quantisation``: rounding to digital numbers. ``saturation``: clipping;
    without it the longest exposure serves everywhere, so that it interacts with noise. ``interreflection``: light of more than one surface.
    ``defocus``: the lenses of camera and projectors. ``gamma``: the projector's gamma and bit depth. ``footprint``: a
    pixel's width; without it only its centre's ray counts. Causes that the scene does not have are left out. Exposure times
    are those of the scene as it is. `choices` go to `decode.reconstruct`.

    Light paths' own noise counts as interreflection where that is on. Raises `FringebenchError` for fewer than 1 repeat.
    """
    if repeats < 1:
        raise FringebenchError(f"repeats = {repeats}: needs 1 or more")
    # What cannot be decoded with is told before light is traced, not after.
    decode.Options.of(choices).rule()
    steps = steps or Steps()
    causes = [cause for cause in CAUSES if _has(scene, cause)]
    lights: dict[Causes, render.Transport] = {}
    surfaces = render.surfaces(scene)
    truth = None
    errors: dict[Causes, Floats] = {}
    times: Sequence[float] = ()
    for on in variants(causes):
        optical: Causes = on & frozenset(OPTICAL)
        if optical not in lights:
            name = "trace light with " + (", ".join(sorted(optical)) or "ideal optics")
            with steps.step(name) as done:
                lights[optical] = _trace(scene, on, seed, done, surfaces)
        if truth is None:  # the first variant has everything on
            truth = render.truth(scene, lights[optical], surfaces)
            times = render.expose(lights[optical], seed=seed).exposure_ms
        with steps.step("decode with " + (", ".join(sorted(on)) or "nothing against it")):
            runs = repeats if "noise" in on else 1
            errors[on] = np.stack(
                [
                    _error_mm(_expose(lights[optical], on, times, seed + i), truth, choices)
                    for i in range(runs)
                ]
            )
    assert truth is not None
    regions = {label: evaluation.scored(truth, label) for label in truth.labels}
    absent = [cause for cause in CAUSES if cause not in causes]
    return add_up(scene.name, causes, errors, regions, absent)


def _has(scene: scenes.Scene, cause: str) -> bool:
    if cause == "interreflection":
        return scene.sampling.depth > 1
    if cause == "quantisation":
        return scene.sensor.bits > 0
    if cause == "defocus":
        return any(device.lens for device in (scene.camera, *scene.projectors))
    if cause == "gamma":
        return any(projector.pixelated for projector in scene.projectors)
    return True


def _trace(
    scene: scenes.Scene, on: Causes, seed: int, done: Report, surfaces: render.Surfaces
) -> render.Transport:
    camera, projectors = scene.camera, scene.projectors
    if "defocus" not in on:
        camera = camera.model_copy(update={"lens": None})
        projectors = tuple(p.model_copy(update={"lens": None}) for p in projectors)
    if "gamma" not in on:
        projectors = tuple(p.model_copy(update={"gamma": 1.0, "bits": 0}) for p in projectors)
    changed = scene.model_copy(update={"camera": camera, "projectors": projectors})
    footprint = float("footprint" in on)
    return render.trace(changed, seed=seed, footprint=footprint, progress=done, surfaces=surfaces)


def _expose(
    transport: render.Transport, on: Causes, times: Sequence[float], seed: int
) -> scenes.Stack:
    sensor = transport.scene.sensor
    clips, rounds = "saturation" in on, "quantisation" in on
    used = sensor if clips else _unlimited(sensor)
    if not rounds:
        used = used.model_copy(update={"bits": 0})
    stack = render.expose(
        transport,
        seed=seed,
        sensor=used,
        exposures=times,
        direct_only="interreflection" not in on,
        noise="noise" in on,
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
