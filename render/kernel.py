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
from render.guide import AIMED, GROUP, Guide, axes
from render.light import Light
from render.optics import Optics
from render.variant import dr, mi

# Of the samples of smooth direct light: places lie opposite in pairs, few of them hold its phase.
FEW_PLACES_OF, FEWEST_PLACES = 4, 4

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
    paths: Any
    """Paths that go on from them, spread evenly."""
    of_plain: Any
    """How many of each GROUP of paths the BSDF draws: the first ones, so that no pixel is without."""
    aimed: Any
    """The share of all its paths that are drawn from the tile's table: exactly, whatever their number."""


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
        """Mean radiance of rows: ambient, then direct and total of each channel, projector by projector."""
        shape = (rows.stop - rows.start, width)
        columns = dr.opaque(mi.UInt32, width)
        index = dr.arange(mi.UInt32, shape[0] * width) + dr.opaque(mi.UInt32, rows.start * width)
        row = index // columns
        column = index - row * columns
        corner = mi.Point2f(column, row)
        plan = self._plan(row, column, sampling.stream(seed, index), samples)
        numbers = sum(len(light.channels) for light in self.lights)

        def none() -> Any:
            return dr.zeros(mi.UInt32, len(index))

        def zeros() -> list[Any]:
            return [dr.zeros(mi.Float, len(index)) for _ in range(numbers)]

        def one_place(
            n: Any, credit: Any, done: Any, first: Any, later: Any, glow: Any
        ) -> tuple[Any, ...]:
            si, gains = self._look(corner, plan.key, n)
            active = si.is_valid()
            first = [a + b for a, b in zip(first, gains, strict=True)]
            if self.depth == 1 and self.ambient is None:
                return n + 1, credit, done, first, later, glow
            # Whole paths from the account of all, so many per place.
            credit += plan.paths
            until = done + credit // plan.places
            credit %= plan.places
            if self.ambient is not None:
                glow += dr.select(active, 0, self.ambient * mi.Float(until - done))

            def one_path(k: Any, later: Any, glow: Any) -> tuple[Any, ...]:
                gains, sky = self._path(si, plan, k)
                later = [a + b for a, b in zip(later, gains, strict=True)]
                return k + 1, later, glow + sky

            _, later, glow = dr.while_loop(
                (mi.UInt32(done), later, glow),
                lambda k, *_: active & (k < until),
                one_path,
                label="paths",
            )
            return n + 1, credit, until, first, later, glow

        *_, first, later, glow = dr.while_loop(
            (none(), none(), none(), zeros(), zeros(), dr.zeros(mi.Float, len(index))),
            lambda n, *_: n < plan.places,
            one_place,
            label="places",
        )
        images = [glow / plan.paths]
        for once, more in zip(first, later, strict=True):
            direct = once / plan.places
            images += [direct, direct + more / plan.paths]
        dr.eval(images)
        return (image.numpy().reshape(shape) for image in images)

    def _plan(self, row: Any, column: Any, key: Any, samples: int) -> Plan:
        """Where pixels look, and how often."""
        tile = self.guide.tile(row, column)
        most = dr.opaque(mi.UInt32, samples)
        places = most
        optics = (self.camera, *(light.optics for light in self.lights))
        if all(device.lens is None for device in optics):
            few = max(FEWEST_PLACES, samples // FEW_PLACES_OF)
            # One without its opposite would shift the phase of direct light.
            few = min(samples, few + few % 2)
            busy = dr.gather(mi.Bool, self.guide.busy, tile)
            places = dr.select(busy, most, dr.opaque(mi.UInt32, few))
        share = dr.gather(mi.Float, self.guide.share, tile)
        paths = dr.maximum(1, mi.UInt32(share * mi.Float(most) + 0.5))
        of_plain = dr.select(
            dr.gather(mi.Bool, self.guide.aimed, tile), mi.UInt32(GROUP - AIMED), GROUP
        )
        plain = paths // GROUP * of_plain + dr.minimum(paths % GROUP, of_plain)
        return Plan(key, tile, places, paths, of_plain, mi.Float(paths - plain) / mi.Float(paths))

    def _look(self, corner: Any, key: Any, n: Any) -> tuple[Any, list[Any]]:
        """First vertex through place number `n` of a pixel, and what every channel adds there."""

        def draw(dimension: Any) -> Any:
            return sampling.point(key, mi.UInt32(dimension), n)

        within = sampling.pixel_point(key, n)
        if self.footprint is not None:
            within = (within - 0.5) * self.footprint + 0.5
        pupil = None if self.camera.lens is None else draw(1)
        si = self._intersect(mi.Ray3f(*self.camera.ray(corner + within, pupil)), True, True)
        return si, self._gains(si, mi.Float(1), draw, 2, si.is_valid())

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
            # Pairs of dimensions: the pixel's, the camera's pupil, one for each projector's, two to leave the
            # first vertex. A later vertex has one for each projector's pupil, then which lobe and where to.
            dimension = 4 + len(self.lights) + (vertex - 1) * (2 + len(self.lights))
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
        turn = number % GROUP
        aimed = turn >= plan.of_plain
        # Each of the two counts its own paths, so that each is stratified.
        own = number // GROUP * dr.select(aimed, GROUP - plan.of_plain, plan.of_plain)
        own += dr.select(aimed, turn - plan.of_plain, turn)
        first = 2 + len(self.lights)
        pair, other = (sampling.point(plan.key, mi.UInt32(first + d), own) for d in range(2))
        bsdf, context, frame = si.bsdf(), mi.BSDFContext(), axes(si)
        sample, onward = bsdf.sample(context, si, other.x, pair, ~aimed)
        drawn = self.guide.sample(plan.tile, pair, aimed)
        world = dr.select(aimed, frame.to_world(drawn), si.to_world(sample.wo))
        way = dr.select(aimed, drawn, frame.to_local(world))
        value, likely = bsdf.eval_pdf(context, si, si.to_local(world), aimed)
        value = dr.select(aimed, value.x, onward.x * sample.pdf)
        likely = dr.select(aimed, likely, sample.pdf)
        plain = 1 - plan.aimed
        density = self.guide.density(plan.tile, way, plan.aimed > 0)
        mixed = dr.fma(plan.aimed, density, plain * likely)
        # No table holds a mirror's one direction.
        delta = ~aimed & mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        weight = dr.select(delta, onward.x / plain, dr.select(value > 0, value / mixed, 0))
        return si.spawn_ray(world), weight

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
