"""Where light paths should go: learnt directions and numbers of paths, one set for each tile of the camera's image.

Nearly all the noise of a fringe image is indirect light. Most surfaces stand open: on a plate one bounce in thirty
meets a neighbour, the others leave for the sky, and that one lands on any phase of the fringe. So a quick look around
from every tile finds the directions in which something stands, and part of the paths is drawn from those. They are
weighed together with the paths that the BSDF draws (balance heuristic: Veach and Guibas 1995), which is unbiased
whatever was learnt, because it was learnt from other random numbers. The same look tells how much a tile has to gain,
and how many places in a pixel direct light needs. docs/light.md has the measurements behind this.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render import sampling
from render.light import Light
from render.optics import Optics
from render.variant import dr, mi

# Tiles along the longer side of the image; fewer for small images, so that a tile has some pixels to learn from.
TILES = 40
SMALLEST_TILE_PX = 4
# Cells of the sphere along its height and around it: equal solid angles.
CELLS = 32
# Of four paths, how many are drawn from the table: fewer under a sky, which only the others find.
OF_FOUR, OF_FOUR_UNDER_SKY = 3, 2
# Most paths a tile may get, relative to the mean, and fewest.
MOST, FEWEST = 4.0, 0.125
# From this scatter of direct light within a tile on, relative to its mean, edges and grain want many places in a pixel.
BUSY = 0.1


@dataclass(frozen=True)
class Guide:
    """What was learnt, by tile."""

    tile_px: int
    columns: int
    """Tiles in a row."""
    cumulative: Any
    """(tile, cell) as one array: chance of a cell or one before it, Float; all 0 where nothing stands around."""
    share: Any
    """(tile,): relative number of paths, 1 on average over tiles, Float."""
    busy: Any
    """(tile,): 1 where direct light varies inside it, UInt32."""
    aimed: int
    """Of four paths, how many are drawn from a tile's table, if it has one."""

    def tile(self, row: Any, column: Any) -> Any:
        """Number of the tile that holds a pixel."""
        return row // self.tile_px * self.columns + column // self.tile_px

    def of_four(self, tile: Any) -> Any:
        """How many of four paths to draw from the tile's table."""
        last = dr.gather(mi.Float, self.cumulative, (tile + 1) * CELLS**2 - 1)
        return dr.select(last > 0, mi.UInt32(self.aimed), 0)

    def sample(self, tile: Any, pair: Any, other: Any, active: Any) -> Any:
        """World direction drawn for a tile: `pair` chooses the cell and its azimuth, `other` the height in the cell."""
        cell = dr.binary_search(
            0,
            CELLS**2 - 1,
            lambda i: dr.gather(mi.Float, self.cumulative, tile * CELLS**2 + i, active) <= pair.x,
        )
        return _direction(cell, mi.Point2f(pair.y, other))

    def density(self, tile: Any, direction: Any, active: Any) -> Any:
        """Density per solid angle with which `sample` draws a world direction."""
        row = mi.UInt32(dr.clip((direction.z + 1) * (CELLS / 2), 0, CELLS - 0.5))
        turn = dr.atan2(direction.y, direction.x) * (CELLS / (2 * dr.pi))
        column = mi.UInt32(dr.clip(dr.select(turn < 0, turn + CELLS, turn), 0, CELLS - 0.5))
        cell = row * CELLS + column
        at = tile * CELLS**2 + cell
        below = dr.gather(mi.Float, self.cumulative, at - 1, active & (cell > 0))
        chance = dr.gather(mi.Float, self.cumulative, at, active) - below
        return chance * (CELLS**2 / (4 * dr.pi))


def _direction(cell: Any, inside: Any) -> Any:
    row = cell // CELLS
    z = dr.fma(mi.Float(row) + inside.y, 2 / CELLS, -1)
    sine, cosine = dr.sincos((mi.Float(cell - row * CELLS) + inside.x) * (2 * dr.pi / CELLS))
    radius = dr.safe_sqrt(1 - z * z)
    return mi.Vector3f(radius * cosine, radius * sine, z)


def learn(
    scene: Any,
    camera: Optics,
    lights: Sequence[Light],
    size: tuple[int, int],
    seed: int,
    under_sky: bool,
) -> Guide:
    """Look once from every tile into every cell of the sphere; `size` is the image's columns and rows."""
    width, height = size
    tile_px = max(SMALLEST_TILE_PX, -(-max(size) // TILES))
    rows, columns = -(-height // tile_px), -(-width // tile_px)
    lane = dr.arange(mi.UInt32, rows * columns * CELLS**2)
    tile = lane // CELLS**2
    # Another stream than any pixel's of the pass proper.
    key = sampling.stream(seed ^ 0x6A09E667, lane)
    inside, where, pupil = (sampling.point(key, mi.UInt32(d), mi.UInt32(0)) for d in range(3))
    row = tile // columns
    place = (mi.Point2f(tile - row * columns, row) + inside) * tile_px
    place = dr.minimum(place, mi.Point2f(width, height) - 1e-3)
    eye = scene.ray_intersect(mi.Ray3f(*camera.ray(place, pupil)), mi.RayFlags.All, True)
    active = eye.is_valid()
    bsdf, context = eye.bsdf(), mi.BSDFContext()
    way = _direction(lane - tile * CELLS**2, where)
    around = bsdf.eval(context, eye, eye.to_local(way), active).x
    met = active & (around > 0)
    met &= scene.ray_test(eye.spawn_ray(way), met)
    direct = mi.Float(0)
    for light in lights:
        source, irradiance, _, lit = light.connect(eye.p, pupil)
        lit &= active
        value = bsdf.eval(context, eye, eye.to_local(dr.normalize(source - eye.p)), lit).x
        lit &= value > 0
        lit &= ~scene.ray_test(eye.spawn_ray_to(source), lit)
        direct += dr.select(lit, value * irradiance, 0)
    table = _blurred(dr.select(met, around, 0).numpy().reshape(rows, columns, CELLS, CELLS))
    table = table.reshape(rows * columns, CELLS**2)
    lit = direct.numpy().reshape(rows * columns, CELLS**2)
    mean, scatter = lit.mean(axis=1), lit.std(axis=1)
    total = table.sum(axis=1)
    cumulative = np.cumsum(table, axis=1, dtype=np.float64)
    # A row ends on exactly 1, or is 0 throughout.
    cumulative /= np.where(total > 0, cumulative[:, -1], 1)[:, None]
    return Guide(
        tile_px,
        columns,
        mi.Float(cumulative.astype(np.float32).ravel()),
        mi.Float(_shares(total, mean).astype(np.float32)),
        mi.UInt32((scatter > BUSY * mean).astype(np.uint32)),
        OF_FOUR_UNDER_SKY if under_sky else OF_FOUR,
    )


def _shares(around: NDArray[np.float32], direct: NDArray[np.float32]) -> NDArray[np.float64]:
    """Relative numbers of paths: as the expected noise of the phase, indirect light over direct light.

    In proportion to the noise itself, not to its square: equal noise everywhere would spend all on a few dark pixels.
    """
    need = around / np.maximum(direct, 0.05 * direct.mean() + 1e-30)
    share = np.ones(len(need))
    if not need.any():
        return share
    scale = 1.0
    for _ in range(30):
        share = np.clip(need * scale, FEWEST, MOST)
        scale /= share.mean()
    return share


def _blurred(table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights 1 2 1 along every axis: one look a cell says little by itself. Azimuth is a circle."""
    for axis in range(4):
        if axis == 3:
            table = np.roll(table, 1, 3) + 2 * table + np.roll(table, -1, 3)
        else:
            wide = np.pad(table, [(int(a == axis),) * 2 for a in range(4)], "edge")
            wide = np.moveaxis(wide, axis, 0)
            table = np.moveaxis(wide[:-2] + 2 * wide[1:-1] + wide[2:], 0, axis)
    return table
