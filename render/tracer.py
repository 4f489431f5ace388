"""Light transport in one pass: a camera pixel's response to every basis channel of every projector at once."""

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.kernel import Pass
from render.light import Light
from render.optics import Optics, optics
from render.surfaces import Surfaces, shared
from render.survey import Tiles, survey
from render.transport import Transport
from render.variant import dr, mi, use
from scenes.basis import Basis, basis
from scenes.errors import RenderError
from scenes.memory import room_for
from scenes.scene import MOST_SAMPLES, Scene

# Numbers a tile may return at once: 64 MB of float32. Smaller tiles start more kernels, larger ones gain nothing.
TILE_NUMBERS = 1 << 24
# Memory per pixel while labels are found, as measured.
LABEL_BYTES = 24
# Between tiles progress is told and an interrupt is heard. Starting one costs some 15 ms.
TILE_S = 1.0
FIRST_TILE_PATHS = 1 << 21


def trace(
    scene: Scene,
    seed: int = 0,
    samples: int | None = None,
    depth: int | None = None,
    footprint: float = 1.0,
    progress: Callable[[float], None] | None = None,
    surfaces: Surfaces | None = None,
) -> Transport:
    """Trace the scene's light transport once, for all its patterns.

    Each pixel looks through `samples` places (None: the scene's), or a quarter of them where direct light is smooth and
    no device has a lens; they lie in pairs opposite about the pixel's centre, which makes the phase of direct light
    nearly free of noise. Multiples of 8 are best. Light of up to `depth` surface vertices (None: the scene's; 1: direct
    light only) is followed by a quarter as many paths to as many again, on average over the image: the fewer, the
    better a quick look around tells where they should go, and most of them where most light is indirect.

    The same seed gives the same bits on one machine. `footprint` narrows the pixels about their centres, 0 to points:
    to see what their width costs. `progress` is called every second or so with the share that is done.
    `surfaces` are the scene's, made before.

    Raises `RenderError` for impossible `samples`, `depth`, `seed` or `footprint`, and for light beyond float32,
    `TooLargeError` for more pixels and channels than memory holds.
    """
    samples = scene.sampling.samples if samples is None else samples
    depth = scene.sampling.depth if depth is None else depth
    for name, value, low, high in (
        ("samples", samples, 1, MOST_SAMPLES),
        ("depth", depth, 1, MOST_SAMPLES),
        ("seed", seed, 0, 2**32 - 1),
    ):
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise RenderError(f"{name} = {value!r}: needs a whole number from {low} to {high}")
    if not 0.0 <= footprint <= 1.0:
        raise RenderError(f"footprint = {footprint}: needs a number from 0 to 1")
    use()
    bases = tuple(basis(scene.patterns, p, p.resolution) for p in scene.projectors)
    width, height = scene.camera.resolution
    images = 2 * len(bases) * max(len(b.channels) for b in bases) + 1
    # Beside the images a tile thrice (kernel, copies), and what finding labels takes. Dr.Jit, out of memory, crashes.
    tile = min(TILE_NUMBERS, images * width * height)
    tiles = Tiles.of(scene.camera.resolution, samples)
    with room_for(
        4 * (images * width * height + 3 * tile) + LABEL_BYTES * width * height + tiles.memory,
        f"tracing {width} x {height} pixels of {images} channels (2 x projectors x channels + 1)",
        "lower camera.resolution, or trace fewer periods or axes at a time",
    ):
        return _traced(
            scene,
            shared(scene, surfaces),
            bases,
            tiles,
            (samples, depth, footprint),
            seed,
            progress,
        )


def _traced(
    scene: Scene,
    surfaces: Surfaces,
    bases: tuple[Basis, ...],
    tiles: Tiles,
    paths: tuple[int, int, float],
    seed: int,
    progress: Callable[[float], None] | None,
) -> Transport:
    samples, depth, footprint = paths
    mi_scene = surfaces.mi_scene
    camera = optics(scene.camera)
    lights = [Light(p, optics(p), b.channels) for p, b in zip(scene.projectors, bases, strict=True)]
    glow = scene.ambient.radiance_w_m2_sr
    sky = dr.opaque(mi.Float, glow) if glow > 0 else None
    pass_ = Pass(
        mi_scene,
        camera,
        lights,
        sky,
        depth,
        None if footprint == 1.0 else dr.opaque(mi.Float, footprint),
        survey(mi_scene, camera, lights, tiles, seed, depth, sky),
    )
    width, height = scene.camera.resolution
    channels = [len(b.channels) for b in bases]
    total = np.zeros((len(bases), max(channels), height, width), np.float32)
    direct = np.zeros_like(total)
    ambient = np.zeros((height, width), np.float32)
    most = max(1, TILE_NUMBERS // (width * (2 * sum(channels) + 1)))
    # Tiles change nothing but this: a lane knows its pixel, not its tile. The first one tells what a row costs.
    rows = min(most, max(1, FIRST_TILE_PATHS // (width * samples)))
    bottom = 0
    while bottom < height:
        start = time.perf_counter()
        part = slice(bottom, min(bottom + rows, height))
        images = pass_.radiance(part, width, samples, seed)
        ambient[part] = next(images)
        for p, count in enumerate(channels):
            for c in range(count):
                direct[p, c, part], total[p, c, part] = next(images), next(images)
        bottom = part.stop
        if progress:
            progress(bottom / height)
        for image in (
            ambient,
            *direct.reshape(-1, height, width),
            *total.reshape(-1, height, width),
        ):
            if not np.isfinite(image[part]).all():
                raise RenderError(
                    "light is so strong or so far away that numbers of 32 bits do not hold it: bring irradiance_w_m2, "
                    "reference_mm and ambient.radiance_w_m2_sr to what a device emits"
                )
        faster = TILE_S / max(time.perf_counter() - start, 1e-3)
        rows = min(most, max(1, int(rows * min(faster, 4.0))))
    ids = [scene.labels.index(part.label) + 1 for part in surfaces.parts]
    label = _labels(mi_scene, camera, ids, (height, width))
    return Transport(
        total, direct, ambient, label, scene.labels, bases, scene, seed, samples, depth
    )


def _labels(
    mi_scene: Any, camera: Optics, ids: Sequence[int], shape: tuple[int, int]
) -> NDArray[np.uint16]:
    """What each pixel's centre sees, (row, col): the id of the part, 0 for nothing."""
    index = dr.arange(mi.UInt32, shape[0] * shape[1])
    row = index // shape[1]
    centre = mi.Point2f(index - row * shape[1], row) + 0.5
    # The middle of the square is the middle of the pupil: the chief ray.
    ray = mi.Ray3f(*camera.ray(centre, mi.Point2f(0.5)))
    hit = mi_scene.ray_intersect_preliminary(ray, coherent=True)
    found = dr.zeros(mi.UInt32, len(index))
    for surface in mi_scene.shapes():
        number = int(surface.id().removeprefix("part_"))
        found[hit.shape == mi.ShapePtr(surface)] = ids[number]
    label: NDArray[np.uint16] = found.numpy().reshape(shape).astype(np.uint16)
    return label
