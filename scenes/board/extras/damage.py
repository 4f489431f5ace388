"""Faults of the bare board: scratches through the mask, residue, and mask that missed its copper."""

from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.board_settings import BoardBase
from scenes.board.defects import Residue, Scratch
from scenes.board.gerber.strokes import Segment, stroke_of_disk
from scenes.board.layers import Stackup
from scenes.board.pad_layout import Area, Damage, Layout, Pad
from scenes.support.distribution import Quantity, draw

Floats = NDArray[np.float64]

# Streams of random numbers; those of prints are in `scenes.board.printing`.
SCRATCH, RESIDUE = 7, 8
# A residue's outline: its corners, and the share of the radius that each of its waves has.
CORNERS, WAVES = 96, (0.25, 0.15, 0.1)
SMALLEST_MM2 = 1e-4


def damaged(board: BoardBase, layout: Layout, stackup: Stackup) -> Layout:
    """The artwork with its mask where it was printed, and with scratches and residue near its pads."""
    defects = board.defects
    drawn = defects.scratch.probability > 0.0 or defects.residue.probability > 0.0
    if not (drawn or np.any(stackup.mask_shift_mm)):
        return layout
    openings, covered = _shifted(layout, stackup.mask_shift_mm)
    drilled = shapely.union_all([hole.outline for hole in layout.holes if not hole.tented])
    masked = layout.board.difference(openings.union(drilled))
    found = []
    for pad in layout.pads:
        rng = board.generator(SCRATCH, pad.id)
        if rng.random() < defects.scratch.probability:
            outline = _scratch(defects.scratch, pad, rng).intersection(masked)
            found.append(Damage("scratch", pad.id, outline))
    clean = layout.board.difference(shapely.union_all([drilled, *(d.outline for d in found)]))
    for pad in layout.pads:
        rng = board.generator(RESIDUE, pad.id)
        if rng.random() < defects.residue.probability:
            outline = _spill(defects.residue, pad, rng).intersection(clean)
            found.append(Damage("residue", pad.id, outline))
    seen = tuple(mark for mark in (*found, *covered) if mark.outline.area > SMALLEST_MM2)
    return replace(layout, openings=openings, damage=seen)


def _shifted(layout: Layout, by_mm: tuple[float, float]) -> tuple[Area, list[Damage]]:
    """The mask's openings where they are, and the copper that they should have left bare and do not."""
    if not np.any(by_mm):
        return layout.openings, []
    moved = shapely.transform(layout.openings, lambda xy: xy + np.asarray(by_mm))
    openings = moved.intersection(layout.board)
    bare = shapely.get_parts(layout.copper.intersection(layout.openings))
    first: dict[int, int] = {}
    if layout.pads:
        pad, piece = shapely.STRtree(bare).query([p.outline for p in layout.pads], "intersects")
        first = {
            int(k): layout.pads[int(p)].id for p, k in zip(pad[::-1], piece[::-1], strict=True)
        }
    lost = shapely.difference(bare, openings)
    return openings, [Damage("mask-shift", first.get(k, 0), area) for k, area in enumerate(lost)]


def _scratch(settings: Scratch, pad: Pad, rng: np.random.Generator) -> shapely.Polygon:
    length, width = draw(settings.length_mm, rng), draw(settings.width_mm, rng)
    angle = np.deg2rad(draw(settings.direction_deg, rng))
    along = length / 2.0 * np.array([np.cos(angle), np.sin(angle)])
    middle = _near(pad, settings.distance, rng)
    (ax, ay), (bx, by) = middle - along, middle + along
    line = Segment((float(ax), float(ay)), (float(bx), float(by)))
    return shapely.Polygon(stroke_of_disk(line, width / 2.0))


def _spill(settings: Residue, pad: Pad, rng: np.random.Generator) -> shapely.Polygon:
    """A lobed outline of the drawn radius' area."""
    radius = draw(settings.radius_mm, rng)
    middle = _near(pad, settings.distance, rng)
    angle = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    reach = 1.0 + sum(
        share * np.cos(k * angle + phase)
        for k, (share, phase) in enumerate(
            zip(WAVES, rng.uniform(0.0, 2.0 * np.pi, 3), strict=True), 2
        )
    )
    outline = shapely.Polygon(reach[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    scale = radius * np.sqrt(np.pi / outline.area)
    return shapely.transform(outline, lambda xy: scale * xy + middle)


def _near(pad: Pad, distance: Quantity, rng: np.random.Generator) -> Floats:
    """A place in a drawn direction from a pad's middle; the distance is relative to half its longer side."""
    x0, y0, x1, y1 = pad.aperture.bounds
    away, angle = draw(distance, rng) * max(x1 - x0, y1 - y0) / 2.0, rng.uniform(0.0, 2.0 * np.pi)
    place: Floats = np.asarray(pad.centre_mm) + away * np.array([np.cos(angle), np.sin(angle)])
    return place
