"""Paste per pad as an inspection machine measures it: volume, area, height and offset from a height map.

A machine knows the board's artwork (where pads are) and not what was printed. Heights count from a reference plane: a
robust fit to the bare board around the pad, moved up by the known step from solder mask to pad; or, where a scan of the
unprinted board is given, the pad's own surface. Heights above the threshold are paste, and count from the plane up.
The default of 40 um is usual in the field: it excludes mask, tracks and noise, and removes shoulders, most of all of small
and flat deposits (`evaluation.inspection.pad_limits.threshold_shares` gives how much, exactly).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy import ndimage

from decode import Reconstruction
from evaluation.inspection.board_view import AROUND_MM, CLEAR_MM, BoardView, Floats, Mask
from evaluation.scoring.feature_fits import robust_fit
from scenes.board.warp import WarpedPlane
from scenes.labels.pad_truth import BoardTruth, PadTruth
from scenes.support.errors import ScoreError

THRESHOLD_MM = 0.04
REACH_MM = 0.25
DOUBLINGS = 4
# A plane has three coefficients; fewer pixels than this make a poor one.
PLANE_PIXELS = 50
# Fewer heights give no reliable median.
BARE_PIXELS = 9
# More do not improve a robust fit.
PLANE_MAX_PIXELS = 4000


@dataclass(frozen=True)
class PadMeasure:
    """One pad as measured; the figures are None where too little of it was measured."""

    pad: int
    """Id, as in the artwork."""
    name: str
    coverage: float
    """Share of the aperture's pixels with a valid height."""
    reference_mm: float | None
    """World z of the reference plane at the pad's centre."""
    volume_mm3: float | None = None
    area_mm2: float | None = None
    mean_height_mm: float | None = None
    """Volume over area; 0 where nothing is above the threshold."""
    peak_height_mm: float | None = None
    """Highest median of 3 x 3 pixels, which noise in single pixels does not raise."""
    offset_x_mm: float | None = None
    """Centre of volume against the aperture's centroid; None where nothing is above the threshold."""
    offset_y_mm: float | None = None
    bridged_to: tuple[int, ...] = ()
    """Pads that paste above the threshold connects it with."""
    bare: bool = False
    """Not measured, but known to have no paste: it is as bright as metal (see `measure_pads`)."""


def measure_pads(
    rec: Reconstruction,
    board: BoardTruth,
    *,
    threshold_mm: float = THRESHOLD_MM,
    bare: Reconstruction | None = None,
    reach_mm: float = REACH_MM,
    min_coverage: float = 0.5,
) -> tuple[PadMeasure, ...]:
    """Measure every pad of a board from a calibrated reconstruction.

    Parameters
    ----------
    rec
        Heights (row, col), mm, with a calibration.
    board
        Only what a machine is taught is used: apertures, and the step from mask to pad.
    threshold_mm
        Height above the pad from which paste counts, mm, 0 or more.
    bare
        The same view of the unprinted board, if there is one: heights then count from the pads' own surface.
    reach_mm
        A pad owns the pixels nearer to it than to any other pad and within this distance, mm.
    min_coverage
        Share of an aperture's pixels with a valid height that a measurement needs, above 0, at most 1.

    Returns
    -------
    tuple of PadMeasure
        One per pad, in the order of `board`: mm, mm2 and mm3.

    Raises
    ------
    ScoreError
        For a parameter out of range, a board without pads, or a reconstruction without calibration.

    Notes
    -----
    Invalid pixels take the height of the nearest valid one. A pad with less than `min_coverage`, or without bare board
    near it, is not measured. Such a pad is `bare` where most of its aperture is saturated, as light from a mirror is and
    from grains is not, while the median of what was measured in it, `BARE_PIXELS` or more, stays below the threshold:
    overexposed paste would be above it there.
    """
    if not board.pads:
        raise ScoreError("the board has no pads in its region: there is nothing to measure")
    if threshold_mm < 0.0 or reach_mm <= 0.0 or not 0.0 < min_coverage <= 1.0:
        raise ScoreError(
            f"threshold_mm = {threshold_mm}, reach_mm = {reach_mm}, min_coverage = {min_coverage}: the threshold must "
            "be 0 or more, the reach above 0, the coverage above 0 and at most 1"
        )
    view = BoardView.of(rec, board, reach_mm)
    ground = None if bare is None else BoardView.of(bare, board, reach_mm)
    height = np.full(view.shape, np.nan)
    planes: dict[int, Floats] = {}
    for pad in board.pads:
        plane = _reference(view, ground, pad, board)
        if plane is not None:
            planes[pad.pad] = plane
            mine = view.owner == pad.pad
            height[mine] = view.filled[mine] - _at(plane, view.xy[mine])
    above = height > threshold_mm
    smooth = ndimage.median_filter(np.where(np.isfinite(height), height, 0.0), size=3)
    # Filled-in heights must not join separate pieces.
    bridges = _bridges(above & view.valid, view)
    return tuple(
        _measure(pad, view, planes.get(pad.pad), above, height, smooth, bridges, min_coverage)
        for pad in board.pads
    )


def measured_warp(pads: Sequence[PadMeasure], board: BoardTruth) -> WarpedPlane:
    """Tilt and bow of a board, from the references of its pads.

    Parameters
    ----------
    pads
        From `measure_pads`.
    board
        The same board, for the pads' places.

    Returns
    -------
    WarpedPlane
        Least squares fit to the pads' reference heights; slopes in mm per mm, curvature per mm, world coordinates.

    Raises
    ------
    ScoreError
        Where fewer than four pads have a reference, or all are in a row.
    """
    at = {pad.pad: (pad.x_mm, pad.y_mm) for pad in board.pads}
    known = [(*at[pad.pad], pad.reference_mm) for pad in pads if pad.reference_mm is not None]
    x, y, z = np.array(known, np.float64).reshape(-1, 3).T
    terms = np.column_stack([np.ones_like(x), x, y, x * x + y * y])
    if np.linalg.matrix_rank(terms) < 4:
        raise ScoreError(
            f"{len(known)} pads with a reference do not fix tilt and bow: four are needed, not in a row"
        )
    _, slope_x, slope_y, curvature = np.linalg.lstsq(terms, z, rcond=None)[0]
    return WarpedPlane(float(slope_x), float(slope_y), float(curvature))


def _reference(
    view: BoardView, ground: BoardView | None, pad: PadTruth, board: BoardTruth
) -> Floats | None:
    """Coefficients of z = a + b (x - x0) + c (y - y0) under the pad's paste; None where there is nothing to fit."""
    if ground is not None:
        taught = (ground.owner == pad.pad) & ground.inside & ground.valid
        plane = _plane(ground, taught, pad)
        if plane is not None:
            return plane
    step = board.pad_surface_mm - board.mask_surface_mm
    shape = shapely.Polygon(pad.aperture_mm)
    around = AROUND_MM
    bare = view.valid & (view.distance_mm >= CLEAR_MM)
    for _ in range(DOUBLINGS):
        x0, y0, x1, y1 = shape.buffer(CLEAR_MM + around).bounds
        x, y = view.xy[..., 0], view.xy[..., 1]
        plane = _plane(view, bare & (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1), pad)
        if plane is not None:
            raised: Floats = plane + np.array([step, 0.0, 0.0])
            return raised
        around *= 2.0
    return None


def _plane(view: BoardView, use: Mask, pad: PadTruth) -> Floats | None:
    """A robust plane through some pixels, as a function of world x and y; None where they are too few."""
    index = np.flatnonzero(use)
    if len(index) < PLANE_PIXELS:
        return None
    index = index[:: 1 + len(index) // PLANE_MAX_PIXELS]
    x, y = (view.xy.reshape(-1, 2)[index] - (pad.x_mm, pad.y_mm)).T
    fit = robust_fit(np.column_stack([np.ones_like(x), x, y]), view.filled.ravel()[index])
    if fit is None:
        return None
    level = fit[0] - fit[1] * pad.x_mm - fit[2] * pad.y_mm
    plane: Floats = np.array([level, fit[1], fit[2]], np.float64)
    return plane


def _at(plane: Floats, xy: Floats) -> Floats:
    return np.asarray(plane[0] + xy @ plane[1:], np.float64)


def _bridges(above: Mask, view: BoardView) -> dict[int, set[int]]:
    """Pad -> pads whose apertures one connected piece of paste reaches."""
    pieces, _ = ndimage.label(above, np.ones((3, 3), np.bool_))
    inside = above & view.inside
    pairs = np.unique(np.column_stack([pieces[inside], view.owner[inside]]), axis=0)
    met: dict[int, set[int]] = {}
    for piece in np.unique(pairs[:, 0]):
        together = {int(pad) for pad in pairs[pairs[:, 0] == piece, 1]}
        for pad in together:
            met.setdefault(pad, set()).update(together - {pad})
    return met


def _bare(view: BoardView, aperture: Mask, above: Mask) -> bool:
    """Whether most of an aperture is saturated and the rest shows no paste."""
    known = aperture & view.valid
    return (
        bool(view.saturated[aperture].mean() > 0.5)
        and int(known.sum()) >= BARE_PIXELS
        and bool(above[known].mean() < 0.5)
    )


def _measure(
    pad: PadTruth,
    view: BoardView,
    plane: Floats | None,
    above: Mask,
    height: Floats,
    smooth: Floats,
    bridges: dict[int, set[int]],
    min_coverage: float,
) -> PadMeasure:
    mine = view.owner == pad.pad
    aperture = mine & view.inside
    coverage = float(view.valid[aperture].mean()) if aperture.any() else 0.0
    centre = np.array([pad.x_mm, pad.y_mm])
    reference = None if plane is None else float(_at(plane, centre))
    if plane is None or coverage < min_coverage:
        bare = plane is not None and _bare(view, aperture, above)
        return PadMeasure(pad.pad, pad.name, coverage, reference, bare=bare)
    paste = mine & above
    area = view.pixel_mm2[paste]
    share = height[paste] * area
    volume, covered = float(share.sum()), float(area.sum())
    if volume == 0.0:
        return PadMeasure(pad.pad, pad.name, coverage, reference, 0.0, 0.0, 0.0, 0.0)
    x, y = (view.xy[paste] * share[:, None]).sum(axis=0) / volume - centre
    return PadMeasure(
        pad.pad,
        pad.name,
        coverage,
        reference,
        volume,
        covered,
        volume / covered,
        float(smooth[paste].max()),
        float(x),
        float(y),
        tuple(sorted(bridges.get(pad.pad, ()))),
    )
