"""Granular solder paste: alloy spheres of a standard powder, packed at random, partly sunk in flux.

Paste is about half metal by volume (90 % by mass of an alloy seven times as dense as flux). The spheres rise out of
the flux by part of their size; a camera sees many small mirrors.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal, Self

import numpy as np
import trimesh
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt, PositiveFloat, model_validator
from scipy.spatial import cKDTree

from scenes.support.errors import MeshError
from scenes.support.frozen import Frozen

Floats = NDArray[np.float64]

# Main range of diameters in micrometres and the largest there may be: IPC J-STD-005A, table 3-2. At least 80 % of the
# mass is in the range, less than 1 % above it.
POWDERS_UM = {3: (25.0, 45.0, 50.0), 4: (20.0, 38.0, 40.0), 5: (15.0, 25.0, 30.0)}
POWDERS_UM |= {6: (5.0, 15.0, 20.0), 7: (2.0, 11.0, 15.0)}
# The standard gives a range, not a law. Taken here: mass log-normal in the diameter, as atomised powder is, 0.5 % above
# the range and 5 % below it.
QUANTILE_ABOVE, QUANTILE_BELOW = 2.576, 1.645

# Spheres deeper than this many largest diameters below the top are never seen.
LAYERS = 2.5
# Spheres push each other apart until none overlaps by more than this part of the smallest radius.
TOUCH = 1e-3
MAX_PUSHES = 500
PUSHES_A_SEARCH = 8
MAX_SPHERES = 200_000


@dataclass(frozen=True)
class Powder:
    """Diameters of one powder type: log-normal by mass, cut off at `largest_um`."""

    median_um: float
    """By mass."""
    spread: float
    """Standard deviation of the logarithm."""
    largest_um: float

    @classmethod
    def of_type(cls, kind: int) -> "Powder":
        """J-STD-005 powder type, 3 to 7."""
        low, high, largest = POWDERS_UM[kind]
        spread = float(np.log(high / low)) / (QUANTILE_ABOVE + QUANTILE_BELOW)
        return cls(low * float(np.exp(QUANTILE_BELOW * spread)), spread, largest)

    def diameters_um(self, count: int, rng: np.random.Generator) -> Floats:
        """Random diameters (count,) of spheres in um, none above `largest_um`.

        `median_um` is the median by volume. By number the distribution is log-normal too, with the median ``median_um
        exp(-3 spread^2)`` (Hatch & Choate 1929).
        """
        median = self.median_um * np.exp(-3.0 * self.spread**2)
        drawn: Floats = median * np.exp(self.spread * rng.standard_normal(count))
        while (too_large := drawn > self.largest_um).any():
            drawn[too_large] = median * np.exp(
                self.spread * rng.standard_normal(int(too_large.sum()))
            )
        return drawn


@dataclass(frozen=True)
class Packing:
    """Spheres that do not overlap, in mm."""

    centres_mm: Floats
    """(sphere, 3)."""
    radii_mm: Floats
    """(sphere,)."""


class Grains(Frozen):
    """The grains of a paste deposit that rise above its flux; the flux is a separate object, a box `bed_mm` high.

    Grains fill the block `size_mm` x `height_mm` on z = 0 and reach neither through its sides nor its top. Those wholly
    below `bed_mm` are left out. Each is an icosphere with a sphere's volume, so volumes are right at any subdivision; with
    ``smooth = true`` its highlights are a sphere's too.
    """

    kind: Literal["grains"] = "grains"
    size_mm: tuple[PositiveFloat, PositiveFloat]
    height_mm: PositiveFloat
    """Top of the block: thickness as printed."""
    bed_mm: PositiveFloat
    """Level of the flux."""
    powder: Literal[3, 4, 5, 6, 7] = 4
    """J-STD-005 type: 3 is 25-45 um, 4 is 20-38 um, 5 is 15-25 um."""
    metal_fraction: Annotated[float, Field(gt=0.0, le=0.55)] = 0.5
    """By volume."""
    seed: NonNegativeInt = 0
    subdivisions: Annotated[int, Field(ge=0, le=4)] = 1
    """Of an icosahedron: 20 x 4^n triangles a grain."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        largest = POWDERS_UM[self.powder][2] * 1e-3
        if min(*self.size_mm, self.height_mm) < 2 * largest:
            raise ValueError(
                f"a block of {list(self.size_mm)} x {self.height_mm} mm is too small for type {self.powder} grains of "
                f"up to {largest} mm: each side needs twice that"
            )
        if not self.bed_mm < self.height_mm:
            raise ValueError(
                f"bed_mm {self.bed_mm} leaves no grain visible: keep it below height_mm = {self.height_mm}"
            )
        return self

    def packing(self) -> Packing:
        """The grains that rise above the bed, the same for the same fields."""
        depth = min(self.height_mm, LAYERS * POWDERS_UM[self.powder][2] * 1e-3)
        whole = pack(
            (*self.size_mm, depth), Powder.of_type(self.powder), self.metal_fraction, self.seed
        )
        centres = whole.centres_mm + np.array(
            [-self.size_mm[0] / 2, -self.size_mm[1] / 2, self.height_mm - depth]
        )
        out = centres[:, 2] + whole.radii_mm > self.bed_mm
        return Packing(centres[out], whole.radii_mm[out])

    def volume_mm3(self) -> float:
        """Exact volume of paste, flux and metal: the bed, and of every grain the cap above it.

        The printed envelope is ``size x size x height_mm``; the rest is air.
        """
        grains = self.packing()
        above = np.clip(
            grains.centres_mm[:, 2] + grains.radii_mm - self.bed_mm, 0.0, 2 * grains.radii_mm
        )
        caps = np.pi * above**2 * (3 * grains.radii_mm - above) / 3
        return float(self.size_mm[0] * self.size_mm[1] * self.bed_mm + caps.sum())

    def mesh(self) -> trimesh.Trimesh:
        """The grains as triangles."""
        grains = self.packing()
        if not len(grains.radii_mm):
            raise MeshError(
                f"no grain rises above the flux at bed_mm = {self.bed_mm}: lower it or use another seed"
            )
        ball = trimesh.creation.icosphere(subdivisions=self.subdivisions)
        corners = ball.vertices * (4 / 3 * np.pi / ball.volume) ** (1 / 3)
        vertices = grains.centres_mm[:, None] + grains.radii_mm[:, None, None] * corners
        first = np.arange(len(vertices)) * len(corners)
        faces = ball.faces + first[:, None, None]
        return trimesh.Trimesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), process=False)


@lru_cache(maxsize=8)
def pack(
    size_mm: tuple[float, float, float], powder: Powder, fraction: float, seed: int
) -> Packing:
    """Spheres of a powder in the box [0, size], filling `fraction` of it, by pushing overlapping ones apart.

    They stay inside the sides and below the top; they may reach through the bottom, below which there are more grains.
    Cached: tracing and truth use the same one. Raises `MeshError` where they do not fit, or are too many.
    """
    rng = np.random.default_rng(seed)
    size = np.asarray(size_mm)
    volume = fraction * float(np.prod(size)) * 1e9
    # Mean volume of a log-normal cube, by number.
    mean = np.pi / 6 * powder.median_um**3 * np.exp(-4.5 * powder.spread**2)
    count = int(1.3 * volume / mean) + 100
    if count > MAX_SPHERES:
        raise MeshError(
            f"a paste of {size_mm} mm needs some {count} grains to a depth of {size_mm[2]} mm, more than the "
            f"{MAX_SPHERES} allowed: make it smaller, or its powder coarser"
        )
    diameters = powder.diameters_um(count, rng)
    filled = np.cumsum(np.pi / 6 * diameters**3)
    radii = diameters[: int(np.searchsorted(filled, volume)) + 1] * 0.5e-3
    lowest = np.stack([radii, radii, np.zeros_like(radii)], axis=1)
    highest = size - radii[:, None]
    centres = lowest + (highest - lowest) * rng.random((len(radii), 3))
    for _ in range(MAX_PUSHES):
        pairs = cKDTree(centres).query_pairs(2.1 * radii.max(), output_type="ndarray")
        reach = radii[pairs].sum(axis=1)
        apart = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
        if not (reach - apart > TOUCH * radii.min()).any():
            # What little is left goes from the radii, so that volumes add up exactly.
            return _separate(centres, radii, pairs, reach - apart)
        near = apart < reach + 0.1 * radii.max()
        pairs, reach = pairs[near], reach[near]
        # Neighbours stay the same for a few small moves.
        for _ in range(PUSHES_A_SEARCH):
            between = centres[pairs[:, 0]] - centres[pairs[:, 1]]
            apart = np.sqrt(np.einsum("ij,ij->i", between, between))
            # A little more than half the overlap each: what only touches comes free of its neighbours sooner.
            strength = 0.55 * np.maximum(reach - apart, 0.0) / np.maximum(apart, 1e-12)
            for axis in range(3):
                push = between[:, axis] * strength
                centres[:, axis] += np.bincount(pairs[:, 0], push, len(radii))
                centres[:, axis] -= np.bincount(pairs[:, 1], push, len(radii))
            np.clip(centres, lowest, highest, out=centres)
    raise MeshError(
        f"grains filling {fraction:.0%} of {size_mm} mm could not be freed of overlaps: lower metal_fraction"
    )


def _separate(centres: Floats, radii: Floats, pairs: NDArray[np.intp], overlap: Floats) -> Packing:
    shrunk = np.zeros(len(radii))
    for side in (0, 1):
        np.maximum.at(shrunk, pairs[:, side], overlap / 2)
    return Packing(centres, radii - np.maximum(shrunk, 0.0))
