"""The kernel of the one pass: a camera pixel's response to every basis channel of every projector.

One lane follows one pixel's paths one after the other; loops inside the kernel run over places in the pixel, paths
from each, and bounces, and the channels add up in registers, so memory does not grow with the number of samples. Every
vertex looks to each projector (a delta light: nothing else can find it). Paths leave the first vertex by its BSDF or in
directions that `render.guide` has learnt, later ones by their BSDF.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render import sampling
from render.guide import Guide
from render.light import Light
from render.optics import Optics
from render.variant import dr, mi

# Direct light needs few places in a pixel, for they lie opposite in pairs; indirect light needs many paths.
PATHS_A_PLACE = 4
FEWEST_PLACES = 4

Draw = Callable[[Any], Any]
"""A pair of random numbers, Point2f, of the current sample, by its number of pair of dimensions."""


@dataclass(frozen=True)
class Plan:
    """What each pixel does."""

    key: Any
    """Of its random numbers."""
    tile: Any
    places: Any
    """Points of its square that it looks through."""
    each: Any
    """Paths that go on from each."""
    of_four: Any
    """How many of four paths are drawn from the tile's table."""
    aimed: Any
    """The share of all its paths that are."""


@dataclass(frozen=True)
class Pass:
    """Everything a kernel reads."""

    scene: Any
    camera: Optics
    lights: Sequence[Light]
    ambient: Any
    """Radiance, or None."""
    depth: int
    footprint: Any
    """Width of a pixel, or None: all of it."""
    guide: Guide

    def radiance(
        self, rows: slice, width: int, samples: int, seed: int
    ) -> Iterator[NDArray[np.float32]]:
        """Mean radiance of a tile: ambient, then direct and total of each channel, projector by projector."""
        shape = (rows.stop - rows.start, width)
        columns = dr.opaque(mi.UInt32, width)
        index = dr.arange(mi.UInt32, shape[0] * width) + dr.opaque(mi.UInt32, rows.start * width)
        row = index // columns
        column = index - row * columns
        corner = mi.Point2f(column, row)
        key = sampling.stream(seed, index)
        plan = self._plan(row, column, key, samples)
        numbers = sum(len(light.channels) for light in self.lights)

        def zeros() -> list[Any]:
            return [dr.zeros(mi.Float, len(index)) for _ in range(numbers)]

        def one_place(n: Any, first: Any, later: Any, glow: Any) -> tuple[Any, ...]:
            within = sampling.pixel_point(key, n)
            if self.footprint is not None:
                within = (within - 0.5) * self.footprint + 0.5
            place = corner + within

            def draw(dimension: Any) -> Any:
                return sampling.point(key, mi.UInt32(dimension), n)

            pupil = None if self.camera.lens is None else draw(1)
            si = self._intersect(
                mi.Ray3f(*self.camera.ray(place, pupil)), coherent=True, active=True
            )
            active = si.is_valid()
            gains = self._gains(si, mi.Float(1), draw, 2, active)
            first = [a + b for a, b in zip(first, gains, strict=True)]
            if self.ambient is not None:
                glow += dr.select(active, 0, self.ambient * mi.Float(plan.each))
            elif self.depth == 1:
                return n + 1, first, later, glow

            def one_path(k: Any, later: Any, glow: Any) -> tuple[Any, ...]:
                # Paths of one place are spread over the whole sequence.
                gains, sky = self._path(si, plan, k * plan.places + n)
                later = [a + b for a, b in zip(later, gains, strict=True)]
                return k + 1, later, glow + sky

            _, later, glow = dr.while_loop(
                (mi.UInt32(0), later, glow),
                lambda k, *_: active & (k < plan.each),
                one_path,
                label="paths",
            )
            return n + 1, first, later, glow

        _, first, later, glow = dr.while_loop(
            (dr.zeros(mi.UInt32, len(index)), zeros(), zeros(), dr.zeros(mi.Float, len(index))),
            lambda n, *_: n < plan.places,
            one_place,
            label="places",
        )
        paths = plan.places * plan.each
        images = [glow / paths]
        for once, more in zip(first, later, strict=True):
            direct = once / plan.places
            images += [direct, direct + more / paths]
        dr.eval(images)
        return (image.numpy().reshape(shape) for image in images)

    def _plan(self, row: Any, column: Any, key: Any, samples: int) -> Plan:
        """Where pixels look, and how often."""
        tile = self.guide.tile(row, column)
        most = dr.opaque(mi.UInt32, samples)
        places = most
        optics = (self.camera, *(light.optics for light in self.lights))
        if all(device.lens is None for device in optics):
            few = max(min(samples, FEWEST_PLACES), samples // PATHS_A_PLACE)
            busy = dr.gather(mi.UInt32, self.guide.busy, tile) == 1
            places = dr.select(busy, most, dr.opaque(mi.UInt32, few))
        share = dr.gather(mi.Float, self.guide.share, tile)
        each = dr.maximum(1, mi.UInt32(share * mi.Float(most) / mi.Float(places) + 0.5))
        of_four = self.guide.of_four(tile)
        # Exactly as many as are drawn, whatever the number of paths.
        paths = places * each
        aimed = (paths >> 2) * of_four + dr.minimum(paths & 3, of_four)
        return Plan(key, tile, places, each, of_four, mi.Float(aimed) / mi.Float(paths))

    def _path(self, si: Any, plan: Plan, number: Any) -> tuple[list[Any], Any]:
        """Channels of a path's vertices after its first one `si`, and its ambient radiance."""
        ray, weight = self._leave(si, plan, number)

        def draw(dimension: Any) -> Any:
            return sampling.point(plan.key, mi.UInt32(dimension), number)

        deepest = dr.opaque(mi.UInt32, self.depth)
        later = [mi.Float(0) for light in self.lights for _ in light.channels]

        def bounce(vertex: Any, active: Any, onward: Any, later: Any, sky: Any) -> tuple[Any, ...]:
            ray, weight = onward
            si = self._intersect(ray, coherent=False, active=active)
            if self.ambient is not None:
                sky = dr.select(active & ~si.is_valid(), dr.fma(weight, self.ambient, sky), sky)
            active = active & si.is_valid() & (vertex < deepest)
            # Pairs of dimensions: the pixel's, the camera's pupil, one for each projector's, three to leave the
            # first vertex. A later vertex has one for each projector's pupil, then which lobe and where to.
            dimension = 5 + len(self.lights) + vertex * (2 + len(self.lights))
            gains = self._gains(si, weight, draw, dimension, active)
            later = [a + b for a, b in zip(later, gains, strict=True)]
            vertex = vertex + 1
            if self.ambient is None:
                active &= vertex < deepest
            dimension += len(self.lights)
            sample, onward = si.bsdf().sample(
                mi.BSDFContext(), si, draw(dimension).x, draw(dimension + 1), active
            )
            weight = weight * onward.x
            ray = si.spawn_ray(si.to_world(sample.wo))
            return vertex, active & (weight > 0), (ray, weight), later, sky

        *_, later, sky = dr.while_loop(
            (mi.UInt32(1), weight > 0, (ray, weight), later, mi.Float(0)),
            lambda vertex, active, *_: active,
            bounce,
            label="bounces",
        )
        return later, sky

    def _leave(self, si: Any, plan: Plan, number: Any) -> tuple[Any, Any]:
        """Ray away from a first vertex, and the path's weight along it: by the BSDF, or from the learnt directions."""
        turn = number & 3
        aimed = turn < plan.of_four
        # Each of the two counts its own paths, so that each is stratified.
        own = (number >> 2) * dr.select(aimed, plan.of_four, 4 - plan.of_four)
        own += dr.select(aimed, turn, turn - plan.of_four)
        first = 2 + len(self.lights)
        pair, other = (sampling.point(plan.key, mi.UInt32(first + d), own) for d in range(2))
        bsdf, context = si.bsdf(), mi.BSDFContext()
        sample, onward = bsdf.sample(context, si, other.x, pair, ~aimed)
        way = dr.select(
            aimed,
            self.guide.sample(plan.tile, pair, other.x, aimed),
            si.to_world(sample.wo),
        )
        value, likely = bsdf.eval_pdf(context, si, si.to_local(way), aimed)
        value = dr.select(aimed, value.x, onward.x * sample.pdf)
        likely = dr.select(aimed, likely, sample.pdf)
        plain = 1 - plan.aimed
        mixed = dr.fma(plan.aimed, self.guide.density(plan.tile, way, True), plain * likely)
        # No table holds a mirror's one direction.
        delta = ~aimed & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        weight = dr.select(delta, onward.x / plain, dr.select(value > 0, value / mixed, 0))
        return si.spawn_ray(way), weight

    def _gains(self, si: Any, weight: Any, draw: Draw, dimension: Any, active: Any) -> list[Any]:
        """What every projector's channels add at a vertex."""
        bsdf, context = si.bsdf(), mi.BSDFContext()
        gains: list[Any] = []
        for p, light in enumerate(self.lights):
            pupil = None if light.optics.lens is None else draw(dimension + p)
            source, irradiance, pixel, lit = light.connect(si.p, pupil)
            lit &= active
            value = bsdf.eval(context, si, si.to_local(dr.normalize(source - si.p)), lit)
            lit &= value.x > 0
            lit &= ~self.scene.ray_test(si.spawn_ray_to(source), lit)
            radiance = dr.select(lit, weight * value.x * irradiance, 0)
            gains += [radiance * v for v in light.channel_values(pixel, lit)]
        return gains

    def _intersect(self, ray: Any, coherent: bool, active: Any) -> Any:
        return self.scene.ray_intersect(ray, mi.RayFlags.All, coherent, active)
