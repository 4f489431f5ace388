"""Light transport in one pass: a camera pixel's response to every basis channel of every projector at once.

One lane follows one pixel's paths one after the other; a loop inside the kernel runs over samples and bounces, and the
channels add up in registers, so memory does not grow with the number of samples. Every vertex looks to each projector
(a delta light: nothing else can find it) and the path goes on by sampling the BSDF.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render import sampling
from render.light import Light
from render.mitsuba_scene import geometry
from render.optics import Optics, optics
from render.transport import Transport
from render.variant import dr, mi, use
from scenes.basis import Basis, basis
from scenes.errors import RenderError
from scenes.memory import room_for
from scenes.meshes import parts
from scenes.scene import MOST_SAMPLES, Scene

# Numbers a tile may return at once: 64 MB of float32. Smaller tiles start more kernels, larger ones gain nothing.
TILE_NUMBERS = 1 << 24
# Memory per pixel while labels are found, as measured.
LABEL_BYTES = 24
# Between tiles progress is told and an interrupt is heard. Starting one costs some 15 ms.
TILE_S = 1.0
FIRST_TILE_PATHS = 1 << 21

Draw = Callable[[Any], Any]
"""A pair of random numbers, Point2f, of the current sample, by its number of pair of dimensions."""


def trace(
    scene: Scene,
    seed: int = 0,
    samples: int | None = None,
    depth: int | None = None,
    footprint: float = 1.0,
    progress: Callable[[float], None] | None = None,
) -> Transport:
    """Trace the scene's light transport once, for all its patterns.

    `samples` light paths per pixel (None: the scene's) of up to `depth` surface vertices (None: the scene's; 1: direct
    light only). The same seed gives the same bits on one machine. Even `samples` are best: they lie in pairs opposite
    about the pixel's centre, which makes the phase of direct light nearly free of noise. `footprint` narrows the pixels
    about their centres, 0 to points: to see what their width costs. `progress` is called every second or so with the
    share that is done.

    Raises `RenderError` for impossible `samples`, `depth`, `seed` or `footprint`, and for light beyond float32,
    `TooLargeError` for more pixels and channels
    than memory holds.
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
    with room_for(
        4 * (images * width * height + 3 * tile) + LABEL_BYTES * width * height,
        f"tracing {width} x {height} pixels of {images} channels (2 x projectors x channels + 1)",
        "lower camera.resolution, or trace fewer periods or axes at a time",
    ):
        return _traced(scene, bases, (samples, depth, footprint), seed, progress)


def _traced(
    scene: Scene,
    bases: tuple[Basis, ...],
    paths: tuple[int, int, float],
    seed: int,
    progress: Callable[[float], None] | None,
) -> Transport:
    samples, depth, footprint = paths
    surfaces = parts(scene)
    mi_scene = mi.load_dict(geometry(surfaces))
    camera = optics(scene.camera)
    pass_ = _Pass(
        mi_scene,
        camera,
        [Light(p, optics(p), b.channels) for p, b in zip(scene.projectors, bases, strict=True)],
        dr.opaque(mi.Float, glow) if (glow := scene.ambient.radiance_w_m2_sr) > 0 else None,
        depth,
        None if footprint == 1.0 else dr.opaque(mi.Float, footprint),
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
    ids = [scene.labels.index(surface.label) + 1 for surface in surfaces]
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


@dataclass(frozen=True)
class _Pass:
    """Everything a kernel reads."""

    scene: Any
    camera: Optics
    lights: Sequence[Light]
    ambient: Any
    """Radiance, or None."""
    depth: int
    footprint: Any
    """Width of a pixel, or None: all of it."""

    def radiance(
        self, rows: slice, width: int, samples: int, seed: int
    ) -> Iterator[NDArray[np.float32]]:
        """Mean radiance of a tile: ambient, then direct and total of each channel, projector by projector."""
        shape = (rows.stop - rows.start, width)
        columns = dr.opaque(mi.UInt32, width)
        index = dr.arange(mi.UInt32, shape[0] * width) + dr.opaque(mi.UInt32, rows.start * width)
        row = index // columns
        corner = mi.Point2f(index - row * columns, row)
        key = sampling.stream(seed, index)
        count = dr.opaque(mi.UInt32, samples)
        numbers = sum(len(light.channels) for light in self.lights)

        def zeros() -> list[Any]:
            return [dr.zeros(mi.Float, len(index)) for _ in range(numbers)]

        def one_sample(n: Any, first: Any, later: Any, glow: Any) -> tuple[Any, ...]:
            def draw(dimension: Any) -> Any:
                return sampling.point(key, mi.UInt32(dimension), n)

            within = sampling.pixel_point(key, n)
            if self.footprint is not None:
                within = (within - 0.5) * self.footprint + 0.5
            place = corner + within
            pupil = None if self.camera.lens is None else draw(1)
            gains, bounces, sky = self._path(mi.Ray3f(*self.camera.ray(place, pupil)), draw)
            first = [a + b for a, b in zip(first, gains, strict=True)]
            later = [a + b for a, b in zip(later, bounces, strict=True)]
            return n + 1, first, later, glow + sky

        _, first, later, glow = dr.while_loop(
            (dr.zeros(mi.UInt32, len(index)), zeros(), zeros(), dr.zeros(mi.Float, len(index))),
            lambda n, *_: n < count,
            one_sample,
            label="samples",
        )
        images = [glow]
        for direct, indirect in zip(first, later, strict=True):
            images += [direct, direct + indirect]
        images = [image / count for image in images]
        dr.eval(images)
        return (image.numpy().reshape(shape) for image in images)

    def _path(self, ray: Any, draw: Draw) -> tuple[list[Any], list[Any], Any]:
        """One path's channels from its first vertex, from its later ones, and its ambient radiance."""
        si = self._intersect(ray, coherent=True, active=True)
        active = si.is_valid()
        sky = mi.Float(0) if self.ambient is None else dr.select(active, 0, self.ambient)
        first, ray, weight = self._vertex(si, mi.Float(1), draw, mi.UInt32(0), active)
        later = [mi.Float(0) for _ in first]
        if self.depth == 1 and self.ambient is None:
            return first, later, sky
        deepest = dr.opaque(mi.UInt32, self.depth)

        def bounce(vertex: Any, active: Any, onward: Any, later: Any, sky: Any) -> tuple[Any, ...]:
            ray, weight = onward
            si = self._intersect(ray, coherent=False, active=active)
            if self.ambient is not None:
                sky = dr.select(active & ~si.is_valid(), dr.fma(weight, self.ambient, sky), sky)
            active = active & si.is_valid() & (vertex < deepest)
            gains, ray, weight = self._vertex(si, weight, draw, vertex, active)
            later = [a + b for a, b in zip(later, gains, strict=True)]
            vertex = vertex + 1
            active &= weight > 0
            if self.ambient is None:
                active &= vertex < deepest
            return vertex, active, (ray, weight), later, sky

        *_, later, sky = dr.while_loop(
            (mi.UInt32(1), active & (weight > 0), (ray, weight), later, sky),
            lambda vertex, active, *_: active,
            bounce,
            label="bounces",
        )
        return first, later, sky

    def _vertex(
        self, si: Any, weight: Any, draw: Draw, vertex: Any, active: Any
    ) -> tuple[list[Any], Any, Any]:
        """What every projector's channels add at a vertex, the ray that goes on, and the path's weight along it."""
        bsdf = si.bsdf()
        context = mi.BSDFContext()
        # Pairs of dimensions 0 and 1 are the pixel's and the camera's pupil. A vertex has two, which lobe and where to,
        # and one for each projector's pupil.
        dimension = 2 + vertex * (2 + len(self.lights))
        gains: list[Any] = []
        for p, light in enumerate(self.lights):
            pupil = None if light.optics.lens is None else draw(dimension + 2 + p)
            source, irradiance, pixel, lit = light.connect(si.p, pupil)
            wo = si.to_local(dr.normalize(source - si.p))
            if p == 0:
                value, _, sample, onward = bsdf.eval_pdf_sample(
                    context, si, wo, draw(dimension).x, draw(dimension + 1), active
                )
            else:
                value = bsdf.eval(context, si, wo, active)
            lit &= active & (value.x > 0)
            lit &= ~self.scene.ray_test(si.spawn_ray_to(source), lit)
            radiance = dr.select(lit, weight * value.x * irradiance, 0)
            gains += [radiance * v for v in light.channel_values(pixel, lit)]
        ray = si.spawn_ray(si.to_world(sample.wo))
        return gains, ray, weight * onward.x

    def _intersect(self, ray: Any, coherent: bool, active: Any) -> Any:
        return self.scene.ray_intersect(ray, mi.RayFlags.All, coherent, active)
