"""Paste and dirt next to the deposits: smears, bridges and foreign bodies."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.board import Board
from scenes.board.defects import PadDefects
from scenes.board.deposits import Deposit, PasteBridge
from scenes.board.pad_layout import disk
from scenes.board.paste import Paste, shoulder
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import tessellate
from scenes.support.distribution import draw

Floats = NDArray[np.float64]

# Stream of random numbers of a pair of pads; the others are in `scenes.board.printing`.
PAIR = 3
# A bridge or smear starts this far inside a deposit, under its shoulder.
EMBEDDED_MM = 0.06
# A smear thins to this share of its height at its end.
THINNED = 1.0 / 3.0
STRIP_EDGE_MM = 0.03


def smear_tail(
    defects: PadDefects, footprint: shapely.Polygon, width_mm: float, paste: Paste
) -> tuple[Heightfield, float]:
    """A smear from the deposit's rim outwards, and the volume of its part beyond the rim."""
    tail = defects.tail
    assert tail is not None
    middle = shapely.get_coordinates(footprint.point_on_surface())[0]
    along = np.array([np.cos(tail.direction_rad), np.sin(tail.direction_rad)])
    reach = 2.0 * float(np.hypot(*np.ptp(np.array(footprint.bounds).reshape(2, 2), axis=0)))
    ray = shapely.LineString([middle, middle + reach * along]).intersection(footprint)
    rim = float(((shapely.get_coordinates(ray) - middle) @ along).max())
    start = middle + max(rim - EMBEDDED_MM, 0.0) * along
    end = middle + (rim + tail.length_mm) * along
    field = _strip(start, end, tail.width * width_mm, tail.height_mm, THINNED, paste)
    return field, field.part_volume_mm3(_outline(field).difference(footprint))


def foreign_body(defects: PadDefects, centre: Floats, half: Floats) -> Heightfield:
    """A rounded body next to or on a pad."""
    speck = defects.speck
    assert speck is not None
    middle = centre + float(half.max()) * np.asarray(speck.at)
    mesh = tessellate(
        disk(float(middle[0]), float(middle[1]), speck.radius_mm), speck.radius_mm / 8
    )
    height = speck.height_mm * shoulder(mesh.depth_mm, speck.radius_mm, 0.1)
    return Heightfield(mesh.xy_mm, mesh.faces, mesh.rims, height)


def lifted(deposits: Iterable[Deposit], bridges: Iterable[PasteBridge]) -> list[Deposit]:
    """The deposits with their specks raised onto the highest paste below them, smears and bridges included."""
    deposits = list(deposits)
    paste = [f for d in deposits for f in (d.field, d.tail) if f]
    paste += [bridge.field for bridge in bridges if bridge.field]
    tree = shapely.STRtree([_outline(field) for field in paste])
    return [replace(d, speck=_raised(d.speck, paste, tree)) if d.speck else d for d in deposits]


def _raised(speck: Heightfield, paste: Sequence[Heightfield], tree: shapely.STRtree) -> Heightfield:
    centre, radius = speck.xy_mm.mean(axis=0), np.sqrt(speck.area_mm2 / np.pi)
    ground = 0.0
    for field in (paste[i] for i in tree.query(_outline(speck), "intersects")):
        below = field.height_mm[np.linalg.norm(field.xy_mm - centre, axis=1) <= radius]
        ground = max(ground, float(below.max(initial=0.0)))
    return replace(speck, height_mm=speck.height_mm + ground)


def drawn_bridges(board: Board, deposits: Iterable[Deposit]) -> list[PasteBridge]:
    """Deposits that touch, and the bridges drawn between neighbours."""
    settings = board.defects.bridge
    there = [d for d in deposits if d.field is not None]
    if len(there) < 2:
        return []
    footprints = np.array([d.footprint for d in there])
    apertures = np.array([d.aperture for d in there])
    near = shapely.STRtree(apertures).query(
        apertures, predicate="dwithin", distance=settings.longest_mm
    )
    touch = shapely.STRtree(footprints).query(footprints, predicate="intersects")
    touching = {(int(i), int(j)) for i, j in touch.T if i < j}
    bridges = [PasteBridge((there[i].pad.id, there[j].pad.id), None) for i, j in sorted(touching)]
    if settings.probability == 0.0:
        return bridges
    for i, j in sorted((int(i), int(j)) for i, j in near.T if i < j):
        a, b = there[i], there[j]
        rng = board.generator(PAIR, a.pad.id, b.pad.id)
        if rng.random() >= settings.probability or (i, j) in touching:
            continue
        width, height = draw(settings.width_mm, rng), draw(settings.height_mm, rng)
        where = float(rng.random())
        ends = _gap(footprints[i], footprints[j], width, where, settings.longest_mm)
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        start, end = ends[0] - EMBEDDED_MM * along, ends[1] + EMBEDDED_MM * along
        field = _strip(start, end, width, height, 1.0, board.paste)
        between = _outline(field).difference(shapely.union_all([footprints[i], footprints[j]]))
        bridges.append(
            PasteBridge((a.pad.id, b.pad.id), field, _pair(ends), field.part_volume_mm3(between))
        )
    return bridges


def _gap(
    a: shapely.Polygon, b: shapely.Polygon, width_mm: float, where: float, longest_mm: float
) -> tuple[Floats, Floats]:
    """Ends of a line across the gap between two footprints, along the direction in which it is narrowest.

    `where` in [0, 1] places it along the stretch over which they face each other.
    """
    shortest = shapely.get_coordinates(shapely.shortest_line(a, b))
    along = (shortest[1] - shortest[0]) / np.linalg.norm(shortest[1] - shortest[0])
    across = np.array([-along[1], along[0]])
    spans = [shapely.get_coordinates(p) @ across for p in (a, b)]
    low = max(span.min() for span in spans) + width_mm / 2
    high = min(span.max() for span in spans) - width_mm / 2
    lateral = low + where * (high - low) if high > low else (low + high) / 2
    centre = float(shortest[0] @ along)
    line = shapely.LineString(
        [lateral * across + (centre + reach) * along for reach in (-100.0, 100.0)]
    )
    hits = [shapely.get_coordinates(line.intersection(p)) @ along for p in (a, b)]
    long = any(len(hit) == 0 for hit in hits) or hits[1].min() - hits[0].max() > longest_mm
    if long or hits[0].max() >= hits[1].min():
        # Hollow outlines may not face each other there, and those at right angles gape.
        return shortest[0], shortest[1]
    return lateral * across + hits[0].max() * along, lateral * across + hits[1].min() * along


def _strip(
    start: Floats, end: Floats, width_mm: float, height_mm: float, thinned: float, paste: Paste
) -> Heightfield:
    """A straight ridge of paste with rounded flanks, its height falling to `thinned` of it at its end."""
    length = float(np.linalg.norm(end - start))
    mesh = tessellate(shapely.box(0.0, -width_mm / 2, length, width_mm / 2), paste.fine_step_mm)
    edge = min(STRIP_EDGE_MM, width_mm / 2)
    fall = 1.0 - (1.0 - thinned) * mesh.xy_mm[:, 0] / length
    height = height_mm * fall * shoulder(mesh.depth_mm, edge, 0.3)
    along = (end - start) / length
    xy = mesh.xy_mm @ np.array([along, [-along[1], along[0]]]) + start
    return Heightfield(xy, mesh.faces, mesh.rims, height)


def _pair(ends: tuple[Floats, Floats]) -> tuple[tuple[float, float], tuple[float, float]]:
    (ax, ay), (bx, by) = ends
    return (float(ax), float(ay)), (float(bx), float(by))


def _outline(field: Heightfield) -> shapely.Polygon:
    return shapely.Polygon(field.xy_mm[field.rims[0]])
