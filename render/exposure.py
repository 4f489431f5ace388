"""Linear light becomes raw frames: any patterns, sensor and exposures, without tracing again."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.chip_image import Image
from render.exposure_time import exposure_times_ms
from render.laser_speckle import speckled
from render.motion import conveyed, height_slope
from render.projector.pattern_span import channel_weights, plane_weights
from render.rolling_shutter import Rows, Seen, pictures_seen
from render.rolling_shutter import radiance as rolled_radiance
from render.sensor_stages import LineNoise, Noise, digital_numbers, fixed_pattern
from render.transport import Transport
from render.unsteady_light import STEADY, is_steady
from scenes.acquisition.patterns import Patterns
from scenes.acquisition.sensor import Sensor
from scenes.files.stack import Stack
from scenes.rig.devices import Pinhole
from scenes.rig.projectors import Camera
from scenes.scene import Exposures, Sampling
from scenes.scene_files import dumps
from scenes.support import mapped
from scenes.support.errors import RenderError, SceneError

# Pixels a thread computes at once: their numbers stay in its cache.
BLOCK = 1 << 15
# Added to seeds for the second camera, whose noise is its own: beyond the seeds of data sets.
SECOND_CHIP = 2**40


def expose(
    transport: Transport,
    seed: int = 0,
    sensor: Sensor | None = None,
    exposures: Exposures | Sequence[float] | None = None,
    patterns: Patterns | None = None,
    direct_only: bool = False,
    noise: bool = True,
    progress: Callable[[float], None] | None = None,
    chip_seed: int | None = None,
    subpixels: int = 1,
    slope: Transport | None = None,
    steady: bool | None = None,
    moved: Iterable[Transport] | None = None,
) -> Stack:
    """Take the pictures: every exposure of every frame of every projector, in the order of `Scene.frames`.

    Parameters
    ----------
    transport
        Traced light, radiance in W/(m^2 sr).
    seed
        Seed of the noise, 0 or more. The same seed gives the same stack, whatever the number of threads.
    sensor, exposures, patterns
        Replace the scene's; exposures may be times in ms. Patterns must be in the span of the traced ones: any number
        of steps, any amplitude and any subset of the traced periods is, for a linear projector.
    direct_only
        Leave interreflections out. Exposure times stay those of all light, so that nothing else changes.
    noise
        False: each sample is its mean and all pixels are alike; clipping and rounding stay.
    progress
        Called with the share that is done, from 0 to 1, frame by frame.
    chip_seed
        Seed of the sensor's fixed pattern; None: `seed`. Pictures taken with one chip share it.
    subpixels
        Traced pixels along each side of a pixel of the sensor, which the frames have: trace at `camera.resolution`
        times this to blur edges more exactly (`render.blur.point_spread`).
    slope
        Of `render.height_slope`, for a scene with `vibration_um`; None: traced here, twice as costly as the transport.
    steady
        Leave out vibration, conveyor, fluctuation, flicker, speckle and bit planes; None: without `noise` leave out what is
        random of them.
    moved
        Of `render.conveyed`, for a scene with `conveyor_um`; None: traced here, each picture as it is taken.

    Returns
    -------
    Stack
        Frames (exposure, frame, row, col) in DN, in the sensor's type; those of a second camera last. `scene` is the TOML with the replacements above;
        `exposure_ms` are the times used.

    Raises
    ------
    RenderError
        For patterns outside the span, impossible exposure times or `subpixels`, or seeds below 0.
    TooLargeError
        For more frames than memory and disk hold.

    Notes
    -----
    Frames of more than a GiB are written to a temporary file as they are made (`scenes.support.mapped`).

    Examples
    --------
    >>> import scenes, render
    >>> transport = render.trace(scenes.load("step", {"camera.resolution": [64, 48]}), samples=2)
    >>> render.expose(transport, exposures=[1.0, 4.0]).frames.shape
    (2, 12, 48, 64)
    """
    chip_seed = seed if chip_seed is None else chip_seed
    for name, value in (("seed", seed), ("chip_seed", chip_seed)):
        if not isinstance(value, (int, np.integer)) or value < 0:
            raise RenderError(f"{name} = {value!r}: use a whole number, 0 or more")
    scene = transport.scene
    scene = scene.model_copy(
        update={
            "sensor": sensor or scene.sensor,
            "patterns": patterns or scene.patterns,
            "exposures": _exposures(exposures) or scene.exposures,
            "camera": _coarser(scene.camera, subpixels),
            "second_camera": scene.second_camera and _coarser(scene.second_camera, subpixels),
            "sampling": Sampling(
                samples=transport.samples, depth=1 if direct_only else transport.depth
            ),
        }
    )
    shown = [
        (p, row)
        for p in range(len(scene.projectors))
        for row in channel_weights(transport, p, scene.patterns)
    ]
    image = Image.of(transport, scene.sensor, subpixels)
    times_ms = exposure_times_ms(image, transport.labels, shown, scene.exposures, scene.sensor)
    still = is_steady(scene) or steady is True
    steady = still or (not noise if steady is None else steady)
    views = [transport] if transport.second is None else [transport, transport.second]
    height, width = image.ambient.shape
    shape = (len(times_ms), len(views) * len(shown), height * width)
    frames = mapped.array(
        shape,
        scene.sensor.dtype,
        f"{shape[0]} exposures of {shape[1]} frames of {width} x {height} pixels",
        "take fewer exposures at a time, or a smaller camera.resolution",
    )
    planes = [
        w
        for p in range(0 if still else len(scene.projectors))
        for w in plane_weights(transport, p, scene.patterns)
    ]

    # Both cameras of a pair take a picture at one moment.
    seen, rolled = pictures_seen(scene, seed, times_ms, shown, planes, still, not steady)
    projectors = [projector for projector, _ in shown]
    for number, view in enumerate(views):
        own = seed + number * SECOND_CHIP
        rising = None
        if scene.vibration_um and not steady:
            change = height_slope(view) if number or slope is None else slope
            rising = Image.of(change, scene.sensor, subpixels, direct_only)

        def at_work(light: Transport, rising: Image | None = rising, own: int = own) -> Image:
            image = Image.of(light, scene.sensor, subpixels, direct_only)
            image = replace(image, slope=rising)
            speckles = not steady and any(p.speckle_contrast for p in scene.projectors)
            return speckled(image, scene, own) if speckles else image

        pictures: Iterator[Image] | None = None
        if any(scene.conveyor_um) and not still:
            order = [p for p in projectors for _ in times_ms]
            lights = conveyed(view, order) if number or not moved else moved
            pictures = map(at_work, lights)
        _fill(
            frames[:, number * len(shown) : (number + 1) * len(shown)],
            at_work(view),
            pictures,
            seen,
            rolled,
            times_ms,
            scene.sensor,
            (own, chip_seed + number * SECOND_CHIP) if noise else None,
            _shared(progress, number, len(views)),
        )
    return Stack(
        frames.reshape(*shape[:2], height, width),
        scene.frames,
        times_ms,
        scene.sensor,
        scene.calibration(),
        dumps(scene),
        int(seed) if noise else None,
        identity=transport.identity,
    )


def _shared(
    progress: Callable[[float], None] | None, number: int, count: int
) -> Callable[[float], None] | None:
    """Progress of one of several cameras as that of all."""
    return progress and (lambda share: progress((number + share) / count))


def _fill(
    frames: NDArray[Any],
    image: Image,
    pictures: Iterator[Image] | None,
    seen: Sequence[Sequence[Seen]],
    rolled: Sequence[Sequence[Rows]],
    times_ms: Sequence[float],
    sensor: Sensor,
    seeds: tuple[int, int] | None,
    progress: Callable[[float], None] | None,
) -> None:
    """Write digital numbers into `frames` (exposure, frame, pixel).

    `pictures` are those of a moving scene, exposure by exposure of each frame; `seen` is what each picture (frame,
    exposure) sees, and `rolled` its rows, empty where all see the same; `seeds` are (noise, chip), None for no noise.
    """
    count = image.ambient.size
    chip = None if seeds is None else fixed_pattern(sensor, seeds[1], image.shape)

    def take(frame: int) -> None:
        streams = [seeds and Noise.of(seeds[0], e, frame) for e in range(len(times_ms))]
        lines = [
            seeds and LineNoise.of(sensor, seeds[0], e, frame, image.shape)
            for e in range(len(times_ms))
        ]
        here = [next(pictures, None) if pictures else image for _ in times_ms]
        for start in range(0, count, BLOCK):
            pixels = slice(start, min(start + BLOCK, count))
            first = seen[frame][0]
            calm = image.radiance(first.projector, first.weights, pixels)
            for e, (time_ms, stream) in enumerate(zip(times_ms, streams, strict=True)):
                line = lines[e]
                now = seen[frame][e]
                there = here[e]
                if there is None:
                    raise RenderError("moved has fewer lights than pictures: give one for each")
                if rolled:
                    radiance = rolled_radiance(there, rolled[frame][e], pixels)
                elif there is image and now.moment == STEADY:
                    radiance = calm
                else:
                    radiance = there.radiance(now.projector, now.weights, pixels, now.moment)
                frames[e, frame, pixels] = digital_numbers(
                    radiance,
                    time_ms,
                    sensor,
                    stream,
                    chip[pixels] if chip else None,
                    line[pixels] if line else None,
                )

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # NumPy releases the interpreter lock while it draws and computes. The loop re-raises errors.
        try:
            # A moving scene is traced as its pictures are taken, in their order.
            run = map if pictures else pool.map
            for done, _ in enumerate(run(take, range(len(seen))), 1):
                mapped.release_pages(frames)
                if progress:
                    progress(done / len(seen))
        except BaseException:
            # After an interrupt the remaining frames are not needed.
            pool.shutdown(cancel_futures=True)
            raise


def _coarser(camera: Camera, subpixels: int) -> Camera:
    """The camera with that many times fewer pixels and the same field of view."""
    columns, rows = camera.resolution
    if subpixels < 1 or columns % subpixels or rows % subpixels:
        raise RenderError(
            f"subpixels = {subpixels}: use a whole number that divides the traced camera.resolution {columns} x {rows}"
        )
    coarse = {"resolution": (columns // subpixels, rows // subpixels)}
    if isinstance(camera, Pinhole):
        coarse["calibrated_at"] = camera.calibrated_at or camera.resolution
    return camera.model_copy(update=coarse) if subpixels > 1 else camera


def _exposures(given: Exposures | Sequence[float] | None) -> Exposures | None:
    if given is None or isinstance(given, Exposures):
        return given
    try:
        return Exposures(times_ms=tuple(given))
    except (TypeError, SceneError):
        raise RenderError(
            f"exposures = {given!r}: give Exposures or a list of times in ms, each above 0"
        ) from None
