"""Linear light becomes raw frames: any patterns, sensor and exposures, without tracing again."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.sensor import Floats, Noise, digital_numbers, fixed_pattern
from render.transport import Transport
from scenes import mapped
from scenes.basis import RANK_TOLERANCE, Basis, basis
from scenes.calibration import Calibration
from scenes.errors import RenderError, SceneError, nearest
from scenes.load import dumps
from scenes.patterns import Patterns
from scenes.scene import AutoExposure, Exposures, Sampling
from scenes.sensor import Sensor
from scenes.stack import Stack

# Pixels worked on at once by a thread: their numbers stay in its cache.
BLOCK = 1 << 15
# A pattern's part outside the traced basis that is no more than the rounding which the basis itself leaves out.
RESIDUE = 10 * RANK_TOLERANCE


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
) -> Stack:
    """Take the pictures: every exposure of every frame of every projector, in the order of `Scene.frames`.

    `sensor`, `exposures` (or times in ms) and `patterns` replace the scene's. Patterns must lie in the span of the
    traced ones; any number of steps, amplitude or subset of the traced periods does for a linear projector.
    `direct_only` leaves interreflections out but keeps the exposure times of all light, so that nothing else changes.
    Without `noise` each sample is its mean, and pixels are all alike; clipping and rounding stay. `seed` is the
    noise's; the same seed gives the same stack, whatever the number of threads. `chip_seed` is the sensor's own, its fixed
    pattern's (None: `seed`): pictures of one chip share it. `progress` is called with the share that is done, frame by
    frame.

    The stack's `scene` is the TOML with these replacements; its `exposure_ms` are the times taken. Frames of more than a
    GiB leave memory as they are made, for a file without a name (`scenes.mapped`).

    Raises `RenderError` for patterns outside the span, and for exposure times that cannot be, `TooLargeError` for more
    frames than memory and disk hold.

    >>> import scenes, render
    >>> transport = render.trace(scenes.load("step", {"camera.resolution": [64, 48]}), samples=2)
    >>> render.expose(transport, exposures=[1.0, 4.0]).frames.shape
    (2, 12, 48, 64)
    """
    chip_seed = seed if chip_seed is None else chip_seed
    for name, value in (("seed", seed), ("chip_seed", chip_seed)):
        if not isinstance(value, (int, np.integer)) or value < 0:
            raise RenderError(f"{name} = {value!r}: needs a whole number from 0 up")
    scene = transport.scene
    scene = scene.model_copy(
        update={
            "sensor": sensor or scene.sensor,
            "patterns": patterns or scene.patterns,
            "exposures": _exposures(exposures) or scene.exposures,
            "sampling": Sampling(
                samples=transport.samples, depth=1 if direct_only else transport.depth
            ),
        }
    )
    shown = [
        (p, row)
        for p in range(len(scene.projectors))
        for row in _weights(transport, p, scene.patterns)
    ]
    times_ms = _times_ms(transport, shown, scene.exposures, scene.sensor)
    light = transport.direct if direct_only else transport.total
    height, width = transport.ambient.shape
    shape = (len(times_ms), len(shown), height * width)
    frames = mapped.array(
        shape,
        scene.sensor.dtype,
        f"{shape[0]} exposures of {shape[1]} frames of {width} x {height} pixels",
        "take fewer exposures at a time, or a smaller camera.resolution",
    )
    seeds = (seed, chip_seed) if noise else None
    _fill(frames, transport, light, shown, times_ms, scene.sensor, seeds, progress)
    return Stack(
        frames.reshape(*shape[:2], height, width),
        scene.frames,
        times_ms,
        scene.sensor,
        Calibration.of(scene),
        dumps(scene),
        int(seed) if noise else None,
    )


def _fill(
    frames: NDArray[Any],
    transport: Transport,
    light: NDArray[np.float32],
    shown: Sequence[tuple[int, Floats]],
    times_ms: Sequence[float],
    sensor: Sensor,
    seeds: tuple[int, int] | None,
    progress: Callable[[float], None] | None,
) -> None:
    """Digital numbers into (exposure, frame, pixel); without seeds (noise, chip), without noise."""
    count = transport.ambient.size
    chip = None if seeds is None else fixed_pattern(sensor, seeds[1], count)

    def take(frame: int) -> None:
        streams = [seeds and Noise.of(seeds[0], e, frame) for e in range(len(times_ms))]
        for start in range(0, count, BLOCK):
            pixels = slice(start, start + BLOCK)
            radiance = _radiance(transport, light, *shown[frame], pixels)
            for e, (time_ms, stream) in enumerate(zip(times_ms, streams, strict=True)):
                frames[e, frame, pixels] = digital_numbers(
                    radiance, time_ms, sensor, stream, chip[pixels] if chip else None
                )

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # NumPy lets go of the interpreter while it draws and computes; the loop lets errors through.
        try:
            for done, _ in enumerate(pool.map(take, range(len(shown))), 1):
                mapped.let_go(frames)
                if progress:
                    progress(done / len(shown))
        except BaseException:
            # An interrupt need not wait for frames that nobody will see.
            pool.shutdown(cancel_futures=True)
            raise


def _exposures(given: Exposures | Sequence[float] | None) -> Exposures | None:
    if given is None or isinstance(given, Exposures):
        return given
    try:
        return Exposures(times_ms=tuple(given))
    except (TypeError, SceneError):
        raise RenderError(
            f"exposures = {given!r}: give Exposures or a list of times in ms, each above 0"
        ) from None


def _radiance(
    transport: Transport,
    light: NDArray[np.float32],
    projector: int,
    weights: Floats,
    pixels: slice | NDArray[np.intp],
) -> Floats:
    """Radiance (pixel,) of one frame at some pixels in row order, ambient light included."""
    channels = light[projector].reshape(light.shape[1], -1)
    radiance = transport.ambient.reshape(-1)[pixels].astype(np.float64)
    for channel in np.flatnonzero(weights):
        radiance += weights[channel] * channels[channel, pixels]
    return radiance


def _times_ms(
    transport: Transport,
    shown: Sequence[tuple[int, Floats]],
    exposures: Exposures,
    sensor: Sensor,
) -> tuple[float, ...]:
    if exposures.times_ms is not None:
        return exposures.times_ms
    assert exposures.auto is not None
    unit_ms = auto_exposure_ms(transport, shown, exposures.auto, sensor)
    return tuple(unit_ms * relative for relative in exposures.relative)


def auto_exposure_ms(
    transport: Transport,
    shown: Sequence[tuple[int, Floats]],
    auto: AutoExposure,
    sensor: Sensor,
) -> float:
    """Time that brings the label's mean or peak, free of noise and clipping, to `level_dn` (black level included).

    The digital number of a radiance is linear in time, so this is a division. `shown` is each frame's projector and
    channel weights. Raises `RenderError` where no time can do it.
    """
    what = f"exposures.auto: label '{auto.label}'"
    if auto.label not in transport.labels:
        raise RenderError(f"{what} is not in the scene: {nearest(auto.label, transport.labels)}")
    seen = np.flatnonzero(transport.label == transport.labels.index(auto.label) + 1)
    if not seen.size:
        raise RenderError(
            f"{what} is seen by no pixel, so no time can be found for it: choose a label in view, or give times_ms"
        )
    if not sensor.black_level_dn < auto.level_dn <= sensor.saturation_dn:
        raise RenderError(
            f"exposures.auto: level_dn {auto.level_dn:g} cannot be reached: choose one above the black level "
            f"{sensor.black_level_dn:g} and up to saturation {sensor.saturation_dn:g}"
        )
    frames = (_radiance(transport, transport.total, p, row, seen) for p, row in shown)
    if auto.statistic == "mean":
        level = float(np.mean([frame.mean() for frame in frames]))
    else:
        level = max(float(np.percentile(frame, 99.0)) for frame in frames)
    if not level > 0:
        raise RenderError(
            f"{what} is dark: no light reaches the camera from it; light it, choose another label, or give times_ms"
        )
    per_ms = float(sensor.mean_dn(level, 1.0)) - sensor.black_level_dn
    return (auto.level_dn - sensor.black_level_dn) / per_ms


def _weights(transport: Transport, projector: int, patterns: Patterns) -> Floats:
    """Weights (frame, channel) that make the patterns of one projector from its traced channels."""
    traced = transport.bases[projector]
    if patterns == transport.scene.patterns:
        return traced.weights
    device = transport.scene.projectors[projector]
    wanted = basis(patterns, device, device.resolution)
    weights: Floats = wanted.weights @ _in_terms_of(traced, wanted)
    for i, frame in enumerate(patterns.frames()):
        missing = _missing(wanted, traced, wanted.weights[i], weights[i])
        if missing:
            raise RenderError(
                f"projector {projector} cannot show frame {i} ({frame.kind}, {frame.axis}, {frame.period_px:g} px, "
                f"step {frame.step}): it needs {missing}, which was not traced (traced: {_names(traced)}); "
                "trace the scene again with these patterns"
            )
    return weights


def _in_terms_of(traced: Basis, wanted: Basis) -> Floats:
    """Each wanted channel as a combination of traced ones, (wanted, traced): least squares for tables."""
    terms = np.zeros((len(wanted.channels), len(traced.channels)))
    for i, want in enumerate(wanted.channels):
        for j, have in enumerate(traced.channels):
            if want.kind == have.kind == "table" and want.axis == have.axis:
                # Tables of one axis are orthogonal, and their mean square is 1.
                terms[i, j] = np.mean(np.multiply(want.values, have.values))
            else:
                terms[i, j] = want == have
    return terms


def _missing(wanted: Basis, traced: Basis, asked: Floats, made: Floats) -> str:
    """What of a frame the traced channels lack, in words; empty if nothing."""
    for channel, weight in zip(wanted.channels, asked, strict=True):
        if weight and channel.kind != "table" and channel not in traced.channels:
            return f"channel '{channel.name}'"
    ask, make = _table(wanted, asked), _table(traced, made)
    if np.linalg.norm(ask - make) > RESIDUE * np.linalg.norm(ask):
        return "a table of projector pixels outside the span of the traced ones"
    return ""


def _table(basis: Basis, weights: Floats) -> Floats:
    """A frame's emitted projector pixels as far as tables make it."""
    terms = [
        weight * np.array(channel.values)
        for channel, weight in zip(basis.channels, weights, strict=True)
        if channel.kind == "table" and weight
    ]
    return np.sum(terms, axis=0) if terms else np.zeros(1)


def _names(basis: Basis) -> str:
    tables = sum(channel.kind == "table" for channel in basis.channels)
    names = [channel.name for channel in basis.channels if channel.kind != "table"]
    return ", ".join(names + ([f"{tables} tables of pixels"] if tables else []))
