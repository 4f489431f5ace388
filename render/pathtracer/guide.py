"""Where light paths leave the first surface for: learnt directions, one table for each tile of the camera's image.

Nearly all the noise of a fringe image is indirect light. Most surfaces are open: on a plate one bounce in thirty
meets a lit neighbour, the others leave for the sky, and that one lands on any phase of the fringe. `render.pathtracer.tile_survey`
looks around from every tile before the pass, and of eight paths up to seven are then drawn from what it found, the
rest by the BSDF. Both kinds are weighed together (balance heuristic: Veach and Guibas 1995, "Optimally combining
sampling techniques for Monte Carlo rendering", eq. 14; path guiding: Jensen 1995, Vorba et al. 2014).

Why this is unbiased: a guide comes from random numbers of its own, so given the guide each path's expectation is that
of ordinary importance sampling, the integral itself; and every pixel keeps at least one path that the BSDF draws, so
nothing is out of reach where a table has no entry. A bad table costs noise, never truth.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from render.plugins.variant import dr, mi

# Cells of the hemisphere above a surface, along its height and around it: equal solid angles.
ROWS, COLUMNS = 16, 32
CELLS = ROWS * COLUMNS
# A table lists cells, each as often as it is likely: one gather draws one.
ENTRIES = 512
# Of so many paths, AIMED are drawn from a table, if at all.
GROUP, AIMED = 8, 7


@dataclass(frozen=True)
class Guide:
    """What was learnt, by tile; a tile's number is `tile` of its pixels."""

    tile_px: int
    columns: int
    """Tiles in a row."""
    share: Any
    """(tile,): paths per sample that is asked for, Float."""
    busy: Any
    """(tile,): where many places in a pixel are needed, not many paths from few, Bool."""
    aimed: Any
    """(tile,): whether the table is worth using, Bool."""
    entries: Any
    """(tile, entry): a cell, the first of its entries << 10 and their number << 20, UInt32."""
    counts: Any
    """(tile, cell): number of a cell's entries, UInt32."""
    pairs: bool = False
    """Whether lit vertices bring their fellows (`render.pathtracer.fringe_pairs`)."""

    def tile(self, row: Any, column: Any) -> Any:
        """Number of the tile that holds a pixel."""
        return row // self.tile_px * self.columns + column // self.tile_px

    def sample(self, tile: Any, pair: Any, active: Any) -> Any:
        """Direction drawn for a tile, in a surface's `axes`."""
        scaled = pair.x * ENTRIES
        packed = dr.gather(mi.UInt32, self.entries, tile * ENTRIES + mi.UInt32(scaled), active)
        first, count = (packed >> 10) & 0x3FF, packed >> 20
        # What is left of the number after choosing the cell is uniform inside it.
        inside = (scaled - mi.Float(first)) / mi.Float(dr.maximum(count, 1))
        return direction(packed & 0x3FF, mi.Point2f(pair.y, inside))

    def density(self, tile: Any, way: Any, active: Any) -> Any:
        """Density per solid angle with which `sample` draws a direction in a surface's `axes`."""
        row = mi.UInt32(dr.clip(way.z * ROWS, 0, ROWS - 0.5))
        turn = dr.atan2(way.y, way.x) * (COLUMNS / (2 * dr.pi))
        turn = dr.select(turn < 0, turn + COLUMNS, turn)
        column = mi.UInt32(dr.clip(turn, 0, COLUMNS - 0.5))
        at = tile * CELLS + row * COLUMNS + column
        count = dr.gather(mi.UInt32, self.counts, at, active & (way.z > 0))
        return mi.Float(count) * (CELLS / (2 * np.pi * ENTRIES))

    def towards(self, si: Any, way: Any, tile: Any, aimed: Any, active: Any) -> tuple[Any, Any]:
        """BSDF times cosine in a direction of the world, and its density if that share is `aimed`, the rest left to the BSDF."""
        value, likely = si.bsdf().eval_pdf(mi.BSDFContext(), si, si.to_local(way), active)
        table = self.density(tile, axes(si).to_local(way), active & (aimed > 0))
        return value.x, dr.fma(aimed, table, (1 - aimed) * likely)


def direction(cell: Any, inside: Any) -> Any:
    """Unit vector of a cell, at a place inside it, a Point2f in [0, 1): around, and along its height."""
    row = cell // COLUMNS
    z = (mi.Float(row) + inside.y) * (1 / ROWS)
    turn = (mi.Float(cell - row * COLUMNS) + inside.x) * (2 * dr.pi / COLUMNS)
    sine, cosine = dr.sincos(turn)
    radius = dr.safe_sqrt(1 - z * z)
    return mi.Vector3f(radius * cosine, radius * sine, z)


def axes(si: Any) -> Any:
    """Frame that turns smoothly with a surface's normal, which looks to where the ray came from.

    Directions above a curved surface then share a table, and none of it lies below the surface.
    """
    return mi.Frame3f(dr.mulsign(mi.Vector3f(si.sh_frame.n), si.wi.z))
