"""Light transport in one pass: a camera pixel's response to every basis channel of every projector at once."""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from render.fringe_phasor import finest_fringes
from render.pathtracer.noise_of_samples import BAND, phasor_noise
from render.pathtracer.path_kernel import Pass
from render.pathtracer.pixel_centres import label_map
from render.pathtracer.tile_survey import TileGrid, survey
from render.plugins.lens import optics
from render.plugins.screen_light import light_of
from render.plugins.shared_surfaces import Surfaces, shared
from render.plugins.variant import dr, mi, use
from render.transport import Transport
from scenes.acquisition.pattern_basis import Basis, basis
from scenes.scene import MAX_SAMPLES, Scene
from scenes.scene_identity import identity
from scenes.support.errors import RenderError
from scenes.support.memory import room_for

# Numbers a tile may return at once: 64 MB of float32. Smaller tiles start more kernels, larger ones gain nothing.
TILE_NUMBERS = 1 << 24
# Memory per pixel while labels are found, as measured.
LABEL_BYTES = 24
# And while noise is measured: the nearest pixels, and two kinds of noise for each projector of two axes.
NEAREST_BYTES, NOISE_BYTES = 32, 16
# Between tiles progress is reported and interrupts are handled. Starting one costs about 15 ms.
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
    nearly free of noise (`scenes.Sampling.samples` has the figures). Light of up to `depth` surface vertices (None: the scene's; 1: direct
    light only) is followed by a quarter as many paths to as many again, on average over the image: the fewer, the
    better a quick survey finds where they should go, and most of them where most light is indirect.

    The same seed gives the same bits on one machine. `footprint` narrows the pixels about their centres, 0 to points:
    to see what their width costs. `progress` is called every second or so with the share that is done.
    `surfaces` are the scene's, made before.

    Raises `RenderError` for impossible `samples`, `depth`, `seed` or `footprint`, and for light beyond float32,
    `TooLargeError` for more pixels and channels than memory holds.
    """
    samples = scene.sampling.samples if samples is None else samples
    depth = scene.sampling.depth if depth is None else depth
    check(samples=samples, depth=depth, seed=seed, footprint=footprint)
    use()
    bases = tuple(basis(scene.patterns, p, p.resolution) for p in scene.projectors)
    width, height = scene.camera.resolution
    images = 2 * len(bases) * max(len(b.channels) for b in bases) + 1
    # In addition to the images: a tile three times (kernel, copies), and memory to find labels. Dr.Jit crashes without memory.
    tile = min(TILE_NUMBERS, images * width * height)
    tiles = TileGrid.of(scene.camera.resolution, samples)
    with room_for(
        4 * images * (width * height + min(BAND, width * height))
        + 12 * tile
        + (LABEL_BYTES + NEAREST_BYTES + NOISE_BYTES * len(bases)) * width * height
        + tiles.memory,
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
    tiles: TileGrid,
    paths: tuple[int, int, float],
    seed: int,
    progress: Callable[[float], None] | None,
) -> Transport:
    samples, depth, footprint = paths
    pass_ = set_up(scene, surfaces, bases, tiles, depth, footprint, seed)
    width, height = scene.camera.resolution
    channels = [len(b.channels) for b in bases]
    total = np.zeros((len(bases), max(channels), height, width), np.float32)
    direct = np.zeros_like(total)
    ambient = np.zeros((height, width), np.float32)
    most = max(1, TILE_NUMBERS // (width * (2 * sum(channels) + 1)))
    # Tiles change nothing but this: a lane knows its pixel, not its tile. The first one shows what a row costs.
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
        require_finite(ambient[part], direct[..., part, :], total[..., part, :])
        faster = TILE_S / max(time.perf_counter() - start, 1e-3)
        rows = min(most, max(1, int(rows * min(faster, 4.0))))
    label = label_map(pass_.scene, pass_.camera, surfaces.ids, (height, width))
    fringes = finest_fringes(scene.patterns, bases)
    noise, amplitude, correlation = (
        phasor_noise(pass_, total, label, channels, fringes, samples, seed)
        if fringes
        else (None, None, None)
    )
    return Transport(
        total,
        direct,
        ambient,
        label,
        scene.labels,
        bases,
        scene,
        seed,
        samples,
        depth,
        noise_rad=noise,
        amplitude_noise=amplitude,
        noise_correlation=correlation,
        identity=identity(scene),
    )


def set_up(
    scene: Scene,
    surfaces: Surfaces,
    bases: tuple[Basis, ...],
    tiles: TileGrid,
    depth: int,
    footprint: float,
    seed: int,
) -> Pass:
    """Everything a kernel reads, after a look around from every tile."""
    camera = optics(scene.camera)
    lights = [light_of(p, b.channels) for p, b in zip(scene.projectors, bases, strict=True)]
    glow = scene.ambient.radiance_w_m2_sr
    sky = dr.opaque(mi.Float, glow) if glow > 0 else None
    return Pass(
        surfaces.mi_scene,
        camera,
        lights,
        sky,
        depth,
        None if footprint == 1.0 else dr.opaque(mi.Float, footprint),
        survey(surfaces.mi_scene, camera, lights, tiles, seed, depth, sky),
    )


def require_finite(*images: NDArray[np.float32]) -> None:
    """`RenderError` unless float32 holds all that light."""
    for image in images:
        if not np.isfinite(image).all():
            raise RenderError(
                "light is so strong or so far away that numbers of 32 bits do not hold it: bring irradiance_w_m2, "
                "reference_mm and ambient.radiance_w_m2_sr to what a device emits"
            )


def check(*, samples: int, depth: int, seed: int, footprint: float) -> None:
    """`RenderError` for what no pass can do."""
    for name, value, low, high in (
        ("samples", samples, 1, MAX_SAMPLES),
        ("depth", depth, 1, MAX_SAMPLES),
        ("seed", seed, 0, 2**32 - 1),
    ):
        if not isinstance(value, (int, np.integer)) or not low <= value <= high:
            raise RenderError(f"{name} = {value!r}: needs a whole number from {low} to {high}")
    if not 0.0 <= footprint <= 1.0:
        raise RenderError(f"footprint = {footprint}: needs a number from 0 to 1")
