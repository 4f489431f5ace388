"""The kernel of the one pass: a camera pixel's response to every basis channel of every projector.

One lane follows one pixel's paths one after the other; loops inside the kernel run over places in the pixel, paths
from each, and bounces, and the channels add up in registers, so memory does not grow with the number of samples. Every
vertex looks to each projector (a delta light: nothing else can find it). Paths leave the first vertex by its BSDF or in
directions that `render.pathtracer.guide` has learnt, later ones by their BSDF.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.pathtracer import sampling
from render.pathtracer.fringe_pairs import paired
from render.pathtracer.guide import AIMED, GROUP, Guide, axes
from render.plugins.lens import Optics
from render.plugins.projector_light import Light
from render.plugins.screen_light import Lights
from render.plugins.variant import dr, mi

# Of the samples of smooth direct light: places lie opposite in pairs, few of them hold its phase.
FEW_PLACES_OF, FEWEST_PLACES = 4, 4
# Deeper paths than this are not cut: from vertex ROULETTE_FROM on they go on by chance, and count for more
# if they do (Russian roulette: Arvo and Kirk 1990, "Particle transport and image synthesis"). At most this share goes on.
DEEPEST_CUT, ROULETTE_FROM, SURVIVES = 8, 3, 0.5

# From one of a light's pairs of dimensions to its next: a screen needs three, which no other use of a path reaches.
FURTHER = 1 << 16

Draw = Callable[[Any], Any]
"""A pair of random numbers, Point2f, of the current sample, by its number of pair of dimensions."""


@dataclass(frozen=True)
class LanePlan:
    """What each lane does: all paths of one pixel, or one block of them."""

    corner: Any
    """Upper left corner of the lane's pixel, Point2f."""
    key: Any
    """Key of its random numbers."""
    tile: Any
    places: Any
    """Points of the pixel that it looks through."""
    paths: Any
    """Paths that go on from these, spread evenly."""
    of_plain: Any
    """How many of each GROUP of paths the BSDF draws: the first ones, so that every lane has some."""
    aimed: Any
    """The share of the lane's paths that are drawn from the tile's table: exactly, whatever their number."""


@dataclass(frozen=True)
class Pass:
    """Everything a kernel reads."""

    scene: Any
    camera: Optics
    lights: Lights
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
        index = dr.arange(mi.UInt32, shape[0] * width) + dr.opaque(mi.UInt32, rows.start * width)
        row, column = self._pixel(index, width)
        tile = self.guide.tile(row, column)
        places, paths = self._counts(tile, samples)
        plan = self._plan(row, column, sampling.stream(seed, index), tile, (places, paths))
        return (image.reshape(shape) for image in self._responses(plan, len(index)))

    def blocks(
        self,
        pixel: NDArray[np.uint32],
        block: NDArray[np.uint32],
        counts: tuple[NDArray[np.uint32], NDArray[np.uint32]],
        width: int,
        seed: int,
    ) -> Iterator[NDArray[np.float32]]:
        """Mean radiance of independent blocks of paths, in the order of `radiance`; each array is (lane,).

        `pixel` and `block` number each lane's pixel and its block of that pixel; `counts` are its places and its paths.
        """
        index = mi.UInt32(pixel)
        row, column = self._pixel(index, width)
        tile = self.guide.tile(row, column)
        key = sampling.block(sampling.stream(seed, index), mi.UInt32(block))
        # Memory beyond the last lane may hold zeros, and a packet of lanes divides by these, too.
        places, paths = (dr.maximum(mi.UInt32(count), 1) for count in counts)
        plan = self._plan(row, column, key, tile, (places, paths))
        return self._responses(plan, len(pixel))

    def _pixel(self, index: Any, width: int) -> tuple[Any, Any]:
        """Row and column of a pixel number."""
        columns = dr.opaque(mi.UInt32, width)
        row = index // columns
        return row, index - row * columns

    def _responses(self, plan: LanePlan, lanes: int) -> Iterator[NDArray[np.float32]]:
        """Mean radiance of each lane: ambient, then direct and total of each channel, projector by projector."""
        numbers = sum(len(light.channels) for light in self.lights)

        def none() -> Any:
            return dr.zeros(mi.UInt32, lanes)

        def zeros() -> list[Any]:
            return [dr.zeros(mi.Float, lanes) for _ in range(numbers)]

        def one_place(
            n: Any, credit: Any, done: Any, first: Any, later: Any, glow: Any
        ) -> tuple[Any, ...]:
            si, gains = self._look(plan.corner, plan.key, n)
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
            (none(), none(), none(), zeros(), zeros(), dr.zeros(mi.Float, lanes)),
            lambda n, *_: n < plan.places,
            one_place,
            label="places",
        )
        images = [glow / plan.paths]
        for once, more in zip(first, later, strict=True):
            direct = once / plan.places
            images += [direct, direct + more / plan.paths]
        dr.eval(images)
        return (image.numpy() for image in images)

    def counts(
        self, pixel: NDArray[np.uint32], width: int, samples: int
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Places and paths that `radiance` gives each of these pixels."""
        places, paths = self._counts(
            self.guide.tile(*self._pixel(mi.UInt32(pixel), width)), samples
        )
        return tuple((np.zeros(pixel.size, np.uint32) + count.numpy()) for count in (places, paths))

    def _counts(self, tile: Any, samples: int) -> tuple[Any, Any]:
        """Places and paths of each pixel of a pass of so many samples."""
        most = dr.opaque(mi.UInt32, samples)
        places = most
        if not self.lens:
            few = max(FEWEST_PLACES, samples // FEW_PLACES_OF)
            # One without its opposite would shift the phase of direct light.
            few = min(samples, few + few % 2)
            busy = dr.gather(mi.Bool, self.guide.busy, tile)
            places = dr.select(busy, most, dr.opaque(mi.UInt32, few))
        share = dr.gather(mi.Float, self.guide.share, tile)
        return places, dr.maximum(1, mi.UInt32(share * mi.Float(most) + 0.5))

    def _pupils(self) -> list[int]:
        """Of the first vertex's pairs of dimensions, those that are a place in the pupil of a lens."""
        devices = [self.camera, *(light.optics for light in self.lights)]
        return [1 + i for i, device in enumerate(devices) if device.lens is not None]

    @property
    def lens(self) -> bool:
        """Whether a device has a lens, so that direct light is noisy all over."""
        return bool(self._pupils())

    def _plan(
        self, row: Any, column: Any, key: Any, tile: Any, counts: tuple[Any, Any]
    ) -> LanePlan:
        """What lanes do that have so many places and paths."""
        places, paths = counts
        of_plain = dr.select(
            dr.gather(mi.Bool, self.guide.aimed, tile), mi.UInt32(GROUP - AIMED), GROUP
        )
        plain = paths // GROUP * of_plain + dr.minimum(paths % GROUP, of_plain)
        aimed = mi.Float(paths - plain) / mi.Float(paths)
        return LanePlan(mi.Point2f(column, row), key, tile, places, paths, of_plain, aimed)

    def _look(self, corner: Any, key: Any, n: Any) -> tuple[Any, list[Any]]:
        """First vertex through place number `n` of a pixel, and what every channel adds there."""

        def draw(dimension: int) -> Any:
            if dimension in pupils:
                return sampling.joint_point(key, 1 + pupils.index(dimension), n)
            return sampling.point(key, mi.UInt32(dimension), n)

        pupils = self._pupils()
        within = sampling.joint_point(key, 0, n) if pupils else sampling.pixel_point(key, n)
        if self.footprint is not None:
            within = (within - 0.5) * self.footprint + 0.5
        pupil = None if self.camera.lens is None else draw(1)
        si = self._intersect(mi.Ray3f(*self.camera.ray(corner + within, pupil)), True)
        return si, self._gains(si, mi.Float(1), draw, 2, si.is_valid())

    def _path(self, si: Any, plan: LanePlan, number: Any) -> tuple[list[Any], Any]:
        """Channels of a path's vertices after its first one `si`, and its ambient radiance."""
        ray, weight, likely = self._leave(si, plan, number)
        # Where a path came from: a surface, the light it carried to there, and the density of its way on.
        came = (si, mi.Float(1), likely) if self.guide.pairs else ()

        def draw(dimension: Any) -> Any:
            return sampling.point(plan.key, mi.UInt32(dimension), number)

        deepest = dr.opaque(mi.UInt32, self.depth)
        later = [mi.Float(0) for light in self.lights for _ in light.channels]

        def bounce(
            vertex: Any, active: Any, onward: Any, came: Any, later: Any, sky: Any
        ) -> tuple[Any, ...]:
            ray, weight = onward
            si = self._intersect(ray, active)
            if self.ambient is not None:
                sky = dr.select(active & ~si.is_valid(), dr.fma(weight, self.ambient, sky), sky)
            active = active & si.is_valid() & (vertex < deepest)
            # Pairs of dimensions: the pixel's, the camera's pupil, one for each projector's, two to leave the
            # first vertex. A later vertex has one for each projector's pupil, then which lobe and where to.
            dimension = 4 + len(self.lights) + (vertex - 1) * (2 + len(self.lights))
            pairs = self._pairs(plan, vertex, ray, si, came) if came else None
            gains = self._gains(si, weight, draw, dimension, active, pairs)
            later = [a + b for a, b in zip(later, gains, strict=True)]
            vertex = vertex + 1
            if self.ambient is None:
                active &= vertex < deepest
            dimension += len(self.lights)
            sample, onward = si.bsdf().sample(
                mi.BSDFContext(), si, draw(dimension).x, draw(dimension + 1), active
            )
            before, weight = weight, weight * onward.x
            if self.depth > DEEPEST_CUT:
                survives = dr.select(vertex >= ROULETTE_FROM, dr.minimum(weight, SURVIVES), 1)
                weight = dr.select(draw(dimension).y < survives, weight / survives, 0)
                before /= survives
            ray = si.spawn_ray(si.to_world(sample.wo))
            delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            came = (si, before, dr.select(delta, 0, sample.pdf)) if came else ()
            return vertex, active & (weight > 0), (ray, weight), came, later, sky

        *_, later, sky = dr.while_loop(
            (mi.UInt32(1), weight > 0, (ray, weight), came, later, mi.Float(0)),
            lambda vertex, active, *_: active,
            bounce,
            label="bounces",
        )
        return later, sky

    def _pairs(
        self, plan: LanePlan, vertex: Any, ray: Any, si: Any, came: Any
    ) -> Callable[..., Any]:
        """Makes of a light's direct light at `si` that of a pair."""
        start, before, likely = came

        def leave(way: Any, active: Any) -> tuple[Any, Any]:
            aimed = dr.select(vertex == 1, plan.aimed, 0)
            value, density = self.guide.towards(start, way, plan.tile, aimed, active)
            return before * value, density

        return partial(paired, self.scene, leave=leave, ray=ray, density=likely, si=si)

    def _leave(self, si: Any, plan: LanePlan, number: Any) -> tuple[Any, Any, Any]:
        """Ray away from a first vertex, by the BSDF or in a learnt direction, the path's weight along it, and the direction's
        density, 0 for a mirror's.
        """
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
        return si.spawn_ray(world), weight, dr.select(delta, 0, mixed)

    def _gains(
        self, si: Any, weight: Any, draw: Draw, dimension: Any, active: Any, pairs: Any = None
    ) -> list[Any]:
        """What every projector's channels add at a vertex; `pairs` adds those of its fellow."""
        gains: list[Any] = []
        for p, light in enumerate(self.lights):

            def own(number: int, first: Any = dimension + p) -> Any:
                return draw(first + number * FURTHER)

            found = light.arrive(self.scene, si, own, active, weight)
            if pairs is not None and isinstance(light, Light) and light.halves is not None:
                found = pairs(light, found=found[0])
            each = [
                [radiance * v for v in light.channel_values(pixel, lit)]
                for radiance, pixel, lit in found
            ]
            gains += [sum(values[1:], values[0]) for values in zip(*each, strict=True)]
        return gains

    def _intersect(self, ray: Any, active: Any) -> Any:
        # Not as coherent packets: at an edge their hits depend on the other rays, so on how lanes were cut into chunks.
        return self.scene.ray_intersect(ray, mi.RayFlags.All, False, active)
