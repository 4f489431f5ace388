"""A stack of a rig with a screen becomes slopes and heights, with their standard deviations."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from decode.deflectometry.integration import Integration, Patches
from decode.deflectometry.reflection import (
    Floats,
    Rays,
    meeting,
    normals,
    seen_points,
    slopes,
    spread,
)
from decode.one_camera import decode_pixels, require_some
from decode.options import Options
from decode.reason import Reason
from decode.reconstruction import AxisPhase, Reconstruction
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.projectors import Screen
from scenes.support.errors import DecodeError

AXES: tuple[Axis, ...] = ("column", "row")
HEIGHTS = ("two-positions", "integration")
# Contrast of the finest fringes, relative to the screen's own, below which a surface shows no image of it. A matt surface
# mixes light of all the screen: nothing of a fringe is left but the noise of simulated light.
MIN_CONTRAST = 0.2
# The decoder's own limit of phase noise: light that would pass it with full contrast is bright enough to judge contrast.
BRIGHT_RAD = 1.0 / 8.0
# Rays that pass the camera's by more than this many standard deviations belong to different points.
MAX_MISS_SIGMAS = 8.0
# Heights this fraction of the working volume outside it are still accepted.
VOLUME_MARGIN = 0.05
# One position: heights are final when they change less, after at most so many rounds; each shrinks the change at least
# tenfold where the screen is farther away than the surface is wide.
CONVERGED_MM, ROUNDS = 1e-7, 30
# Pixels from a border that a lens's blur reaches.
BORDER_PX = 5
# Samples of noise for the standard deviation of integrated heights: it is then known to 9 %.
SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Seen:
    """Which point of each screen position every pixel sees."""

    screens: tuple[Screen, ...]
    coordinates_px: Floats
    """(screen, axis, row, col)."""
    sigma_px: Floats
    first: Reconstruction
    """Decode of the first position, for its modulation and exposure."""
    phases: dict[Axis, AxisPhase]
    reason: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Measured:
    """Figures of the pixels that see the screen, (..., pixel)."""

    height_mm: Floats
    sigma_mm: Floats
    slope: Floats
    slope_sigma: Floats
    reason: NDArray[np.uint8]


def _nothing(count: int) -> Measured:
    one, pair = np.full(count, np.nan), np.full((2, count), np.nan)
    reason = np.full(count, Reason.NO_HEIGHT, np.uint8)
    return Measured(one, one.copy(), pair, pair.copy(), reason)


def require_projectors(options: Options) -> None:
    """`DecodeError` for choices that only a screen offers."""
    if options.height in HEIGHTS or options.known_point is not None:
        raise DecodeError(
            f"height='{options.height}' and known_point measure what mirrors a screen, and the stack's calibration has none: use "
            "triangulation, reference-plane, linear or phase"
        )


def decode_mirror(stack: Stack, options: Options) -> Reconstruction:
    """Slopes and heights of a mirroring surface from a stack that shows a screen by way of it."""
    way = _way(stack, options)
    seen = _seen(stack, options)
    assert stack.calibration is not None
    image = seen.reason.shape
    good = seen.reason == Reason.OK
    camera = stack.calibration.camera.projection()
    rays = Rays(*(part[good] for part in camera.rays(camera.pixel_centres())))
    here = seen.coordinates_px[..., good], seen.sigma_px[..., good]
    found = _nothing(0)
    reason = seen.reason.copy()
    if good.any():
        if way == "two-positions":
            found = _two_positions(rays, seen.screens, *here)
        else:
            found = _integrated(rays, seen.screens, *here, good, options.known_point)
        reason[good] = _in_volume(found, stack, options)

    def whole(values: Floats) -> NDArray[np.float32]:
        result = np.full((*values.shape[:-1], *image), np.nan, np.float32)
        result[..., good] = values
        return result

    result = replace(
        seen.first,
        height_mm=whole(found.height_mm),
        sigma_mm=whole(found.sigma_mm),
        slope=whole(found.slope),
        slope_sigma=whole(found.slope_sigma),
        reason=reason,
        phases=seen.phases,
        settings=options.summary()
        | {"resolved": seen.first.settings["resolved"] | {"height": way, "axis": list(AXES)}},
    )
    if (reason == Reason.NO_IMAGE).any() and not (reason == Reason.OK).any():
        raise DecodeError(
            f"no pixel shows an image of the screen (no-image {result.reason_fractions()['no-image']:.1%}): the surface is matt, and "
            "mixes light of the whole screen; measure it with a projector"
        )
    require_some(result, options)
    return result


def _way(stack: Stack, options: Options) -> str:
    """How heights are found; `DecodeError` for choices that make no sense with a screen."""
    assert stack.calibration is not None
    known = len(stack.calibration.screens)
    if options.projector is not None and not 0 <= options.projector < known:
        raise DecodeError(
            f"projector is {options.projector}, and the screen has {known} position(s), counted from 0"
        )
    positions = known if options.projector is None else 1
    for name in ("axis", "c_px_per_mm", "reference"):
        if getattr(options, name) is not None:
            raise DecodeError(
                f"{name} is given, but the rig has a screen, whose columns and rows give slopes together: leave it out"
            )
    if options.uncertainty != "sensor":
        raise DecodeError(
            f"uncertainty='{options.uncertainty}' is for projectors, and the rig has a screen: leave it out"
        )
    way = options.height or ("two-positions" if positions == 2 else "integration")
    if way not in HEIGHTS:
        raise DecodeError(
            f"height='{way}' is for projectors, and the rig has a screen: use two-positions, or integration"
        )
    if way == "two-positions" and positions < 2:
        raise DecodeError(
            "two-positions needs the screen in two positions, and this is one: use integration with known_point"
        )
    if positions == 1 and options.known_point is None:
        raise DecodeError(
            "one position of the screen leaves the height open: give known_point (row, column, height in mm) on the surface, "
            "or a second position of the screen"
        )
    if positions == 2 and options.known_point is not None:
        raise DecodeError(
            "known_point is for one position of the screen: two measure the height themselves; leave it out"
        )
    return way


def _seen(stack: Stack, options: Options) -> Seen:
    """Decode columns and rows of each position."""
    assert stack.calibration is not None
    screens = stack.calibration.screens
    shown = range(len(screens)) if options.projector is None else [options.projector]
    black = stack.sensor.black_level_dn
    found = []
    for p in shown:
        for axis in AXES:
            # The model h = (u - x) / c with c = 1 px per mm turns the phase's noise into that of the coordinate.
            own = replace(
                options, projector=p, axis=axis, height="linear", c_px_per_mm=1.0, known_point=None
            )
            rec = decode_pixels(stack, own)
            if not rec.order_known:
                raise DecodeError(
                    f"nothing fixes the fringe order of the screen's {axis}s: show a period as wide as the screen, periods "
                    "whose beat is, or Gray code"
                )
            found.append((axis, rec, _own_reason(rec, axis, black, screens[p].contrast)))
    reason = np.zeros_like(found[0][2])
    for _, _, own_reason in found:
        reason = np.where(reason == Reason.OK, own_reason, reason)
    for _, _, own_reason in found:
        reason = np.where(
            (own_reason == Reason.NO_IMAGE) & (reason != Reason.OUTSIDE_ROI), own_reason, reason
        )
    shape = (len(shown), len(AXES), *reason.shape)
    coordinates = np.stack([rec.phases[axis].coordinate_px for axis, rec, _ in found])
    sigma = np.stack([rec.sigma_mm for _, rec, _ in found]).astype(np.float64)
    return Seen(
        tuple(screens[p] for p in shown),
        coordinates.reshape(shape),
        sigma.reshape(shape),
        found[0][1],
        {axis: rec.phases[axis] for axis, rec, _ in found[:2]},
        reason.astype(np.uint8),
    )


def _own_reason(
    rec: Reconstruction, axis: Axis, black_dn: float, contrast: float
) -> NDArray[np.uint8]:
    """The decoder's reasons, and no image where there is light but no contrast."""
    light = rec.offset_dn - black_dn
    noise_rad = rec.sigma_mm * (2.0 * np.pi / rec.phases[axis].period_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        shown = rec.modulation_dn / light / contrast
        blurred = (shown < MIN_CONTRAST) & (noise_rad * shown < BRIGHT_RAD)
    judged = np.isin(rec.reason, (Reason.OK, Reason.DARK, Reason.SHADOW, Reason.ORDER_MISMATCH))
    return np.where(blurred & judged, Reason.NO_IMAGE, rec.reason).astype(np.uint8)


def _two_positions(
    rays: Rays, screens: tuple[Screen, ...], coordinates: Floats, sigma: Floats
) -> Measured:
    def figures(at: Floats) -> Floats:
        """Height, slopes, and by how much the two rays miss each other, (quantity, pixel)."""
        near, far = seen_points(screens, at)
        distance, gap = meeting(rays, near, far)
        point = rays.points(distance)
        tilted = slopes(normals(rays, point, (near, far)))
        return np.concatenate([point[None, :, 2], tilted, gap[None]])

    value, noise = figures(coordinates), spread(figures, coordinates, sigma)
    reason = np.where(np.isfinite(value).all(axis=0), Reason.OK, Reason.NO_HEIGHT)
    with np.errstate(invalid="ignore"):
        missed = ~(np.abs(value[3]) <= MAX_MISS_SIGMAS * noise[3])
    reason = np.where(missed, Reason.NO_HEIGHT, reason)
    return Measured(value[0], noise[0], value[1:3], noise[1:3], reason.astype(np.uint8))


def _integrated(
    rays: Rays,
    screens: tuple[Screen, ...],
    coordinates: Floats,
    sigma: Floats,
    good: NDArray[np.bool_],
    known: tuple[int, int, float] | None,
) -> Measured:
    """Heights by integration: of two positions about their own heights, of one from the known point."""
    two = None
    if known is None:
        two = _two_positions(rays, screens, coordinates, sigma)
        kept = two.reason == Reason.OK
        anchor, weight = two.height_mm, _inner(good, kept) / two.sigma_mm**2
    else:
        kept, anchor, weight = _from(known, good)
    if not kept.any():
        assert two is not None
        return two
    result = _nothing(kept.size)
    if two is not None:
        result.reason[:] = two.reason
    mask = np.zeros_like(good)
    mask[good] = kept
    patches = Patches.of(mask)
    rays = Rays(rays.origin_mm[kept], rays.direction[kept])
    coordinates, sigma = coordinates[..., kept], sigma[..., kept]
    anchor, weight = anchor[kept], weight[kept]
    seen = seen_points(screens, coordinates)
    distance = rays.distance_at(anchor)
    if two is not None:
        distance = meeting(rays, *seen)[0]

    def mirrored(at: Floats, where: Floats | None = None) -> tuple[Floats, Floats]:
        """Normals, and heights that two positions measure themselves, of coordinates."""
        targets = seen_points(screens, at)
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
    for _ in range(SAMPLES):
        moved, height = mirrored(coordinates + sigma * rng.standard_normal(sigma.shape), where)
        change.append(moved - normal)
        shift.append(height - anchor if two is not None else np.zeros_like(height))
    noise = surface.noise(point, np.stack(change, axis=-1), np.stack(shift, axis=-1), weight)
    steep = rays.direction[:, 2]
    result.height_mm[kept] = point[:, 2]
    result.sigma_mm[kept] = np.sqrt(np.mean((noise * steep[:, None]) ** 2, axis=-1))
    result.slope[:, kept] = slopes(normal)
    result.slope_sigma[:, kept] = spread(
        lambda at: slopes(mirrored(at, where)[0]), coordinates, sigma
    )
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


def _in_volume(found: Measured, stack: Stack, options: Options) -> NDArray[np.uint8]:
    assert stack.calibration is not None
    low, high = options.height_range_mm or stack.calibration.height_range_mm
    margin = VOLUME_MARGIN * (high - low)
    with np.errstate(invalid="ignore"):
        outside = ~((found.height_mm >= low - margin) & (found.height_mm <= high + margin))
    return np.where(
        outside & (found.reason == Reason.OK), Reason.OUT_OF_VOLUME, found.reason
    ).astype(np.uint8)
