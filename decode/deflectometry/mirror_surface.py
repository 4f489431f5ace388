"""From where the pixels see the screen to slopes and heights, with their standard deviations."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.deflectometry.edges import BORDER_PX
from decode.deflectometry.integration import Integration, Patches
from decode.deflectometry.reflection import Floats, Looks, Rays, meeting, normals, slopes
from decode.reason import Reason
from scenes.support.errors import DecodeError

# Rays that pass the camera's by more than this many standard deviations belong to different points.
MAX_MISS_SIGMAS = 8.0
# One position: heights are final when they change less, after at most so many rounds; each shrinks the change at least
# tenfold where the screen is farther away than the surface is wide.
CONVERGED_MM, ROUNDS = 1e-7, 30
# Samples of noise for the standard deviation of integrated heights: it is then known to 9 %.
SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Measured:
    """Figures of the pixels that see the screen, (..., pixel)."""

    height_mm: Floats
    sigma_mm: Floats
    slope: Floats
    slope_sigma: Floats
    reason: NDArray[np.uint8]


def nothing(count: int) -> Measured:
    one, pair = np.full(count, np.nan), np.full((2, count), np.nan)
    reason = np.full(count, Reason.NO_HEIGHT, np.uint8)
    return Measured(one, one.copy(), pair, pair.copy(), reason)


def two_positions(rays: Rays, looks: Looks) -> Measured:
    """Slopes and heights of each pixel by itself."""

    def figures(at: Floats) -> Floats:
        """Height, slopes, and by how much the two rays miss each other, (quantity, pixel)."""
        near, far = looks.points(at)
        distance, gap = meeting(rays, near, far)
        point = rays.points(distance)
        tilted = slopes(normals(rays, point, (near, far)))
        return np.concatenate([point[None, :, 2], tilted, gap[None]])

    value, noise = figures(looks.coordinates_px), looks.deviation(figures)
    reason = np.where(np.isfinite(value).all(axis=0), Reason.OK, Reason.NO_HEIGHT)
    with np.errstate(invalid="ignore"):
        missed = ~(np.abs(value[3]) <= MAX_MISS_SIGMAS * noise[3])
    reason = np.where(missed, Reason.NO_HEIGHT, reason)
    return Measured(value[0], noise[0], value[1:3], noise[1:3], reason.astype(np.uint8))


def integrated(
    rays: Rays, looks: Looks, good: NDArray[np.bool_], known: tuple[int, int, float] | None
) -> Measured:
    """Heights by integration: of two positions about their own heights, of one from the known point."""
    two = None
    if known is None:
        two = two_positions(rays, looks)
        kept = two.reason == Reason.OK
        anchor, weight = two.height_mm, _inner(good, kept) / two.sigma_mm**2
    else:
        kept, anchor, weight = _from(known, good)
    if not kept.any():
        assert two is not None
        return two
    result = nothing(kept.size)
    if two is not None:
        result.reason[:] = two.reason
    mask = np.zeros_like(good)
    mask[good] = kept
    patches = Patches.of(mask)
    rays = Rays(rays.origin_mm[kept], rays.direction[kept])
    looks = looks.of(kept)
    coordinates, sigma = looks.coordinates_px, looks.sigma_px
    anchor, weight = anchor[kept], weight[kept]
    distance = rays.distance_at(anchor)
    if two is not None:
        distance = meeting(rays, *looks.points(coordinates))[0]

    def mirrored(at: Floats, where: Floats | None = None) -> tuple[Floats, Floats]:
        """Normals, and heights that two positions measure themselves, of coordinates."""
        targets = looks.points(at)
        if where is None:
            where = rays.points(meeting(rays, *targets)[0])
        return normals(rays, where, targets), where[:, 2]

    for _ in range(ROUNDS):
        normal, _ = mirrored(coordinates, None if two is not None else rays.points(distance))
        surface = Integration(patches, rays, normal)
        before, distance = distance, surface.distances(anchor, weight)
        if two is not None or np.abs(distance - before).max() < CONVERGED_MM:
            break
    else:
        raise DecodeError(
            "integrated heights do not settle: the known point's height may be far from the surface's"
        )
    point = rays.points(distance)
    where = None if two is not None else point

    rng = np.random.default_rng(0)
    change, shift = [], []
    for sample in range(SAMPLES + 1):
        # The last one is no noise.
        error = sigma * rng.standard_normal(sigma.shape) if sample < SAMPLES else looks.edge_px
        moved, height = mirrored(coordinates + error, where)
        change.append(moved - normal)
        shift.append(height - anchor if two is not None else np.zeros_like(height))
    noise = surface.noise(point, np.stack(change, axis=-1), np.stack(shift, axis=-1), weight)
    square = (noise * rays.direction[:, 2:]) ** 2
    result.height_mm[kept] = point[:, 2]
    result.sigma_mm[kept] = np.sqrt(square[:, :-1].mean(axis=-1) + square[:, -1])
    result.slope[:, kept] = slopes(normal)
    result.slope_sigma[:, kept] = looks.deviation(lambda at: slopes(mirrored(at, where)[0]))
    result.reason[kept] = Reason.OK
    return result


def _inner(good: NDArray[np.bool_], kept: NDArray[np.bool_]) -> Floats:
    """Share with which kept ones of the good pixels set their patch's height, (good pixel,): 1 away from borders, where blur
    mixes a pixel with its neighbours. Patches without such a pixel are set by all of theirs, whose share of 1e-6 does not count
    elsewhere.
    """
    mask = np.zeros_like(good)
    mask[good] = kept
    inner = ndimage.binary_erosion(mask, iterations=BORDER_PX)
    return np.where(inner[good], 1.0, 1e-6)


def _from(
    known: tuple[int, int, float], good: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Of the good pixels: which are in the known point's patch, its height, and the weight that fixes it alone."""
    row, column, height = int(known[0]), int(known[1]), float(known[2])
    rows, columns = good.shape
    inside = 0 <= row < rows and 0 <= column < columns
    if not (inside and good[row, column]):
        raise DecodeError(
            f"known_point names the pixel in row {row}, column {column}, which "
            + (
                "sees no image of the screen"
                if inside
                else f"is outside the {columns} x {rows} image"
            )
            + ": name one on the mirroring surface"
        )
    at = int(np.flatnonzero(np.flatnonzero(good) == row * columns + column)[0])
    patch = Patches.of(good).patch
    weight = np.zeros(patch.size)
    weight[at] = 1.0
    return patch == patch[at], np.full(patch.size, height), weight
