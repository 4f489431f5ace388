"""A quick look around before the pass: what a `Guide` learns from, and how many paths each tile is given.

Every tile of the image looks once into every cell of the hemisphere, from a few surface points, and weighs what it
sees: the BSDF towards the cell, times the projectors' light that a surface there sends back.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.pathtracer import sampling
from render.pathtracer.guide import (
    AIMED,
    CELLS,
    COLUMNS,
    ENTRIES,
    GROUP,
    ROWS,
    Guide,
    axes,
    direction,
)
from render.plugins.lens import Optics
from render.plugins.projector_light import Draw, Light
from render.plugins.screen_light import Lights
from render.plugins.variant import dr, mi

# A tile's side in pixels is this over the root of the samples: looking then costs a like share of any pass. In small
# images, where it costs nothing, so many tiles lie along the longer side.
TILE_PX_OF_ONE_SAMPLE = 96
FEWEST_TILES = 20
SMALLEST_TILE_PX = 4
# Looks in memory at once, 64 byte each.
MOST_TILES = 1 << 13
LOOK_BYTES = 64
# Surface points a tile looks from.
POINTS = 32
SOLID_ANGLE = 2 * np.pi / CELLS
# Light of later bounces, relative to the mean of what surfaces send back: a dark surface in sight is not nothing.
LATER = 0.5
# A table must halve the variance: its paths, which all meet something, cost up to twice as much. And paths must scatter
# by their mean without it: of quiet light, as of an even sky, the few looks know no variance but their own noise.
WORTH = 0.5
QUIET = 1.0
# Pairs must cancel more than they cost: of the indirect light so much, times the root of the number of projectors, comes from
# further than half a fringe. On paste (0.41) they gain a tenth, with four projectors (0.45) and in grains (0.12) they lose.
FAR = 0.3
# Most and fewest paths of a tile, relative to the mean.
MOST, FEWEST = 4.0, 0.25
# Fewest paths per sample of a tile that sees light but is given no table.
UNAIMED = 0.5
# Paths per sample on average, at least, and so many more than would reach the noise of plain ones, one a sample.
LEAST, SAFETY = 0.25, 1.5
# Paths of a pixel on average, at least, unless it has fewer samples: of one or two none could be aimed.
FEWEST_PATHS = 4
# From this scatter of direct light within a tile on, relative to its mean, and of normals, edges and grain need many
# places in a pixel.
BUSY = 0.1

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class TileGrid:
    """The image cut into squares."""

    width: int
    height: int
    side: int
    samples: int

    @staticmethod
    def of(size: tuple[int, int], samples: int) -> "TileGrid":
        """Tiles of an image of columns and rows."""
        side = min(TILE_PX_OF_ONE_SAMPLE / samples**0.5, max(size) / FEWEST_TILES)
        side = max(side, SMALLEST_TILE_PX, (size[0] * size[1] / MOST_TILES) ** 0.5)
        return TileGrid(*size, int(np.ceil(side)), samples)

    @property
    def rows(self) -> int:
        return -(-self.height // self.side)

    @property
    def columns(self) -> int:
        return -(-self.width // self.side)

    @property
    def count(self) -> int:
        return self.rows * self.columns

    @property
    def memory(self) -> int:
        """Bytes that a survey takes."""
        return LOOK_BYTES * CELLS * self.count


@dataclass(frozen=True)
class _Seen:
    """What the looks found."""

    value: Floats
    """(tile, cell): BSDF towards the cell times cosine, 0 where no light can come from."""
    likely: Floats
    """(tile, cell): density with which the BSDF draws that direction."""
    back: Floats
    """(tile, cell): radiance that comes back from there, 1 for the brightest."""
    far: Floats
    """(tile, cell): 1 where a look ends further than half a fringe away, else 0."""


def survey(
    scene: Any, camera: Optics, lights: Lights, tiles: TileGrid, seed: int, depth: int, sky: Any
) -> Guide:
    """Look around from every tile and learn; `sky` is the ambient radiance or None."""
    # Streams of their own: what is learnt must not depend on the paths it will guide.
    eye, direct = _points(scene, camera, lights, tiles, seed ^ 0x6A09E667)
    flags = eye.bsdf().flags()
    # One direction or another side, which no table holds.
    odd = mi.has_flag(flags, mi.BSDFFlags.Delta) | mi.has_flag(flags, mi.BSDFFlags.Transmission)
    odd = (eye.is_valid() & odd).numpy().reshape(tiles.count, POINTS).any(axis=1)
    lit = _relative(direct.numpy().reshape(tiles.count, POINTS))
    mean = lit.mean(axis=1)
    part = dr.reinterpret_array(mi.UInt32, eye.shape).numpy().reshape(tiles.count, POINTS)
    busy = (lit.std(axis=1) > BUSY * mean) | _edged(eye, part) | _bordered(tiles, mean, part) | odd
    if depth == 1 and sky is None:
        none = mi.UInt32(0)
        share, aimed = dr.zeros(mi.Float, tiles.count), dr.zeros(mi.Bool, tiles.count)
        return Guide(tiles.side, tiles.columns, share, mi.Bool(busy), aimed, none, none, False)
    seen = _looks(scene, lights, tiles, eye, seed ^ 0x3C6EF372, depth, sky)
    light = seen.value * (seen.back + LATER * _mean_of_some(seen.back))
    table = _blurred(light.reshape(tiles.rows, tiles.columns, ROWS, COLUMNS)).reshape(light.shape)
    whole = table.sum(axis=1, dtype=np.float64)
    # A look says nothing about the table it made itself: its part of the blur, 1/16, is left out.
    others = np.maximum(table - 16 * light, 0) / np.maximum(whole, 1e-30)[:, None] / SOLID_ANGLE
    sent = _sent(seen)
    plain = _spread(seen, seen.likely, sent)
    mixed = _spread(seen, AIMED / GROUP * others + (1 - AIMED / GROUP) * seen.likely, sent)
    aimed = (whole > 0) & ~odd & (mixed < WORTH * plain) & (plain > QUIET * sent**2)
    # Noise of the phase: indirect light over direct light.
    dark = np.maximum(mean, 0.05 * _mean_of_some(mean) + 1e-30)
    counts, entries = _entries(table, whole)
    return Guide(
        tiles.side,
        tiles.columns,
        mi.Float(
            _shares(
                whole / dark,
                np.sqrt(plain) / dark,
                np.sqrt(mixed) / dark,
                aimed,
                odd,
                tiles.samples,
            )
        ),
        mi.Bool(busy),
        mi.Bool(aimed),
        mi.UInt32(entries.ravel()),
        mi.UInt32(counts.ravel()),
        _pay(seen, len(lights)),
    )


def _points(
    scene: Any, camera: Optics, lights: Lights, tiles: TileGrid, seed: int
) -> tuple[Any, Any]:
    """Surface points that tiles see, (tile, point) in one axis, and their direct light."""
    lane = dr.arange(mi.UInt32, tiles.count * POINTS)
    tile = lane // POINTS
    key = sampling.stream(seed, tile)

    def draw(number: int) -> Any:
        return sampling.point(key, mi.UInt32(number), lane - tile * POINTS)

    inside, pupil = draw(0), draw(1)
    row = tile // tiles.columns
    place = (mi.Point2f(tile - row * tiles.columns, row) + inside) * tiles.side
    place = dr.minimum(place, mi.Point2f(tiles.width, tiles.height) - 1e-3)
    eye = scene.ray_intersect(mi.Ray3f(*camera.ray(place, pupil)), mi.RayFlags.All, True)
    direct = _lit(scene, lights, eye, lambda n: draw(2 + n), eye.is_valid())
    dr.eval(eye, direct)
    return eye, direct


def _edged(eye: Any, part: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """(tile,): whether surfaces end there: two parts of one paint may look alike, yet have phases of their own."""
    normal = np.array(dr.select(eye.is_valid(), eye.n, 0)).reshape(3, *part.shape)
    together = np.sqrt((normal.mean(axis=2) ** 2).sum(axis=0))
    # Unit vectors that scatter by s have a mean 1 - s^2 / 2 long.
    edged: NDArray[np.bool_] = part.min(axis=1) != part.max(axis=1)
    edged |= (part.max(axis=1) > 0) & (together < 1 - BUSY**2 / 2)
    return edged


def _bordered(tiles: TileGrid, mean: Floats, part: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """(tile,): whether a neighbour is another part, or as much brighter as makes a tile of both busy.

    An edge that runs just inside a tile's border, as edges level with the image do, cuts off less than its points see.
    """
    shape = (tiles.rows, tiles.columns)
    found = np.zeros(shape, np.bool_)
    whole = part.min(axis=1) == part.max(axis=1)
    for axis in range(2):
        here = np.moveaxis(found, axis, 0)
        light = np.moveaxis(mean.reshape(shape), axis, 0)
        one, first = (np.moveaxis(a.reshape(shape), axis, 0) for a in (whole, part[:, 0]))
        # Half the difference over the mean: the scatter of two.
        apart = np.abs(light[1:] - light[:-1]) > BUSY * (light[1:] + light[:-1])
        apart |= one[1:] & one[:-1] & (first[1:] != first[:-1])
        here[1:] |= apart
        here[:-1] |= apart
    return found.ravel()


def _looks(
    scene: Any, lights: Lights, tiles: TileGrid, eye: Any, seed: int, depth: int, sky: Any
) -> _Seen:
    lane = dr.arange(mi.UInt32, tiles.count * CELLS)
    tile = lane // CELLS
    cell = lane - tile * CELLS
    # Every point looks into every row once; neighbouring cells are looked into from different points.
    point = (cell + cell // COLUMNS * 7) % POINTS
    eye = dr.gather(mi.SurfaceInteraction3f, eye, tile * POINTS + point)
    key = sampling.stream(seed, lane)

    def draw(number: int) -> Any:
        return sampling.point(key, mi.UInt32(number), mi.UInt32(0))

    inside = draw(0)
    way = axes(eye).to_world(direction(cell, inside))
    value, likely = eye.bsdf().eval_pdf(mi.BSDFContext(), eye, eye.to_local(way), eye.is_valid())
    active = eye.is_valid() & (value.x > 0)
    seen = scene.ray_intersect(eye.spawn_ray(way), mi.RayFlags.All, False, active)
    met = active & seen.is_valid()
    back = mi.Float(0) if depth == 1 else _lit(scene, lights, seen, lambda n: draw(1 + n), met)
    if sky is None:
        active = met
    else:
        back = dr.select(met, back, sky)
    far = met & False
    for light in lights:
        if isinstance(light, Light) and light.halves is not None:
            far |= met & (seen.t > light.half_fringe(seen.p))
    value, likely, back = (dr.select(active, a, 0) for a in (value.x, likely, back))
    far = dr.select(far, mi.Float(1), 0)
    dr.eval(value, likely, back, far)
    shape = (tiles.count, CELLS)
    value, likely, back, far = (a.numpy().reshape(shape) for a in (value, likely, back, far))
    return _Seen(value, likely, _relative(back), far)


def _lit(scene: Any, lights: Lights, si: Any, draw: Draw, active: Any) -> Any:
    """White light of all projectors that a surface sends back to where the ray came from, once scattered."""
    found = [light.arrive(scene, si, draw, active) for light in lights]
    return sum((radiance for each in found for radiance, _, _ in each), mi.Float(0))


def _pay(seen: _Seen, lights: int) -> bool:
    """Whether pairs of vertices are worth their rays."""
    light = seen.value * seen.back
    return bool((light * seen.far).sum() > FAR * lights**0.5 * light.sum())


def _sent(seen: _Seen) -> NDArray[np.float64]:
    """(tile,): indirect light that is sent on to the camera: the mean of a path, however drawn."""
    sent: NDArray[np.float64] = (seen.value * seen.back).sum(axis=1, dtype=np.float64) * SOLID_ANGLE
    return sent


def _spread(seen: _Seen, density: Floats, sent: NDArray[np.float64]) -> NDArray[np.float64]:
    """(tile,): variance of one path drawn with that density, (tile, cell); `sent` is its mean."""
    light = seen.value * seen.back
    square = np.divide(light * light, density, out=np.zeros_like(light), where=density > 0)
    spread: NDArray[np.float64] = np.maximum(
        square.sum(axis=1, dtype=np.float64) * SOLID_ANGLE - sent**2, 0
    )
    return spread


def _entries(
    table: Floats, whole: NDArray[np.float64]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """A guide's counts and entries; none for tiles around which there is nothing."""
    has = whole > 0
    cumulative = np.cumsum(table, axis=1, dtype=np.float64) / np.where(has, whole, 1)[:, None]
    ends = np.zeros((len(table), CELLS + 1), np.uint32)
    ends[:, 1:] = cumulative * ENTRIES + 0.5
    ends[:, -1] = np.where(has, ENTRIES, 0)
    counts = np.diff(ends, axis=1)
    packed = np.arange(CELLS, dtype=np.uint32) | (ends[:, :-1] << 10) | (counts << 20)
    entries = np.zeros((len(table), ENTRIES), np.uint32)
    entries[has] = np.repeat(packed.ravel(), counts.ravel()).reshape(-1, ENTRIES)
    return counts, entries


def _shares(
    need: NDArray[np.float64],
    plain: NDArray[np.float64],
    mixed: NDArray[np.float64],
    aimed: NDArray[np.bool_],
    odd: NDArray[np.bool_],
    samples: int,
) -> Floats:
    """(tile,): paths per sample, in proportion to the need; `plain` and `mixed` are a path's noise without and with.

    In proportion to the noise itself, not to its square: equal noise everywhere would spend all on a few dark pixels.
    Fewer in all where tables help, but never so few that the image gets noisier than by plain paths, one a sample.
    """
    need = np.where(odd, 0, need)
    before = plain[~odd].sum()
    after = np.where(aimed, mixed, plain)[~odd].sum()
    least = min(max(LEAST, FEWEST_PATHS / samples), 1)
    mean = np.clip(SAFETY * (after / max(before, 1e-30)) ** 2, least, 1)
    share = np.ones(len(need))
    if need.any():
        scale = 1.0
        # Clipping changes the mean, so the scale is found step by step.
        for _ in range(30):
            share = np.clip(need * scale, FEWEST, MOST)
            scale /= share[~odd].mean()
    share *= mean
    share = np.where(~aimed & (plain > 0), np.maximum(share, UNAIMED), share)
    result: Floats = np.where(odd, 1, share).astype(np.float32)
    return result


def _relative(light: Floats) -> Floats:
    """Light from 0 to 1 for the brightest. Where float32 does not hold it, it counts for nothing: the pass refuses it."""
    light = np.where(np.isfinite(light), light, 0)
    brightest = light.max(initial=0)
    return light / brightest if brightest > 0 else light


def _mean_of_some(values: Floats) -> np.float32:
    """Mean of those that are not 0."""
    some = values[values > 0]
    return np.float32(some.mean() if some.size else 0)


def _blurred(table: Floats) -> Floats:
    """Weights 1 2 1 along every axis: one look a cell says little by itself. Azimuth, the last, is a circle."""
    for axis in range(4):
        if axis == 3:
            table = np.roll(table, 1, 3) + 2 * table + np.roll(table, -1, 3)
        else:
            wide = np.pad(table, [(int(a == axis),) * 2 for a in range(4)], "edge")
            wide = np.moveaxis(wide, axis, 0)
            table = np.moveaxis(wide[:-2] + 2 * wide[1:-1] + wide[2:], 0, axis)
    return table
