"""A board with its paste: everything drawn, and every deposit, bridge, smear and speck shaped and placed in the world.

Each pad and each pair of neighbours has its own random numbers, from the board's seed and the pads' ids. So a
deposit is the same in every region of the board.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import TypeAdapter

from scenes.board.board import Board, GerberBoard, Stackup
from scenes.board.defects import PadDefects, draw_defects
from scenes.board.pad_layout import Layout, Pad, disk, rounded
from scenes.board.paste import Form, Paste, area_ratio, deposit, shoulder
from scenes.board.warp import WarpedPlane
from scenes.shapes.heightfield import Heightfield, Tessellation, tessellate
from scenes.support.distribution import draw

Floats = NDArray[np.float64]

# Streams of random numbers; 0 is the board's layers.
PRINT, PAD, PAIR = 1, 2, 3
FIELD = 5
# A bridge or smear starts this far inside a deposit, under its shoulder.
EMBEDDED_MM = 0.06
# A smear thins to this share of its height at its end.
THINNED = 1.0 / 3.0
STRIP_EDGE_MM = 0.03


@dataclass(frozen=True, eq=False)
class Deposit:
    """What was printed on one pad, world coordinates; heights count from the pad's surface."""

    pad: Pad
    aperture: shapely.Polygon
    """The nominal opening in the world."""
    defects: PadDefects
    area_ratio: float
    efficiency: float
    """Transfer efficiency by the area ratio."""
    field: Heightfield | None
    """None: no paste left the aperture."""
    tail: Heightfield | None = None
    tail_volume_mm3: float = 0.0
    """Of the part of the smear beyond the deposit."""
    speck: Heightfield | None = None

    @property
    def footprint(self) -> shapely.Polygon:
        """Outline of the deposit in the world; empty where none is."""
        if self.field is None:
            return shapely.Polygon()
        outer, *holes = (self.field.xy_mm[rim] for rim in self.field.rims)
        return shapely.Polygon(outer, holes)


@dataclass(frozen=True, eq=False)
class PasteBridge:
    """Paste between two deposits."""

    pads: tuple[int, int]
    field: Heightfield | None
    """None: the deposits themselves touch."""
    ends_mm: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    """Where it leaves the first pad's deposit and meets the second's."""
    volume_mm3: float = 0.0
    """Of the part between the deposits."""


@dataclass(frozen=True, eq=False)
class Print:
    """A printed board; world coordinates put the region's middle at the origin and the laminate at z = 0."""

    layout: Layout
    stackup: Stackup
    stencil_mm: float
    deposits: tuple[Deposit, ...]
    bridges: tuple[PasteBridge, ...]
    warp: WarpedPlane
    """Added to all heights of the board and its paste."""


@dataclass(frozen=True)
class _Registration:
    """Pose of the stencil on the board."""

    stencil_mm: float
    shift_mm: tuple[float, float]
    turn_rad: float


def printed(board: Board) -> Print:
    """The board with everything drawn from its seed: deposits and bridges in world coordinates, mm.

    The last print is cached: light, truth and labels of a sample all use the same one.
    """
    return _printed(board.model_dump_json(), _stamps(board))


@lru_cache(maxsize=1)
def _printed(board_json: str, stamps: tuple[tuple[str, int, int], ...]) -> Print:
    board: Board = TypeAdapter(Board).validate_json(board_json)
    layout = artwork(board)
    rng, paste = board.generator(PRINT), board.paste
    registration = _Registration(
        draw(paste.stencil_mm, rng),
        (draw(paste.shift_x_mm, rng), draw(paste.shift_y_mm, rng)),
        float(np.deg2rad(draw(paste.turn_deg, rng))),
    )
    made = [_deposit(board, layout, pad, registration) for pad in layout.pads]
    tree = shapely.STRtree([deposit.footprint for deposit in made])
    deposits = {deposit.pad.id: _lifted(deposit, made, tree) for deposit in made}
    return Print(
        layout,
        board.stackup(),
        registration.stencil_mm,
        tuple(deposits.values()),
        tuple(_bridges(board, deposits)),
        board.warped_plane(),
    )


def artwork(board: Board) -> Layout:
    """The board's layout. Gerber files are read again only when they change: a data set shares one board."""
    ignored = {"seed", "layers", "warp", "paste", "defects"}
    if board.region is not None and board.region.centre_mm is None:
        ignored.remove("seed")
    plain = board.model_copy(
        update={
            name: type(board).model_fields[name].get_default(call_default_factory=True)
            for name in ignored
        }
    )
    return _artwork(plain.model_dump_json(), _stamps(board))


@lru_cache(maxsize=8)
def _artwork(board_json: str, stamps: tuple[tuple[str, int, int], ...]) -> Layout:
    board: Board = TypeAdapter(Board).validate_json(board_json)
    return board.layout()


def _stamps(board: Board) -> tuple[tuple[str, int, int], ...]:
    """Name, size and time of every file the layout could depend on."""
    if not isinstance(board, GerberBoard):
        return ()
    given = [path for path in board.files.model_dump().values() if path]
    folder = board.folder
    files = [path if folder is None else folder / path for path in given]
    files += sorted(folder.iterdir()) if folder and folder.is_dir() else []
    return tuple(
        (str(path), path.stat().st_size, path.stat().st_mtime_ns)
        for path in map(Path, files)
        if path.is_file()
    )


@lru_cache(maxsize=1024)
def _tessellated(outline: bytes, step_mm: float) -> Tessellation:
    """Boards repeat a few apertures many times."""
    return tessellate(shapely.from_wkb(outline), step_mm)


def _deposit(board: Board, layout: Layout, pad: Pad, registration: _Registration) -> Deposit:
    paste = board.paste
    rng = board.generator(PAD, pad.id, 0)
    edge, wall, scoop, ear, rough = (
        draw(q, rng)
        for q in (paste.edge_mm, paste.wall, paste.scoop, paste.dog_ear, paste.roughness)
    )
    volume = draw(paste.volume, rng)
    offset = np.array([draw(paste.offset_x_mm, rng), draw(paste.offset_y_mm, rng)])
    turn = float(np.deg2rad(draw(paste.rotation_deg, rng)))
    slump = draw(paste.slump_mm, rng)
    defects = draw_defects(board.defects, board.generator(PAD, pad.id, 1))

    slant = _slant(pad.aperture)
    # In the aperture's own axes, so that slump widens a slanted opening equally on all sides.
    opening = rounded(shapely.transform(pad.aperture, lambda xy: _turned(xy, -slant)))
    low, high = np.array(opening.bounds).reshape(2, 2)
    half = (high - low) / 2
    stroke = _turned(np.eye(2)["xy".index(paste.stroke)], -slant)
    centre = np.asarray(pad.centre_mm) - layout.centre_mm
    ratio = area_ratio(pad.aperture, registration.stencil_mm)
    transfer = paste.transfer
    reach = np.abs(stroke) @ half, np.abs(stroke[::-1]) @ half
    efficiency = transfer.efficiency(ratio, float((reach[1] - reach[0]) / (reach[0] + reach[1])))
    deviate = np.sqrt(1.0 - transfer.neighbours) * board.generator(PAD, pad.id, 3).standard_normal()
    if transfer.neighbours:
        field_ = transfer.common(pad.centre_mm, board.generator(FIELD))
        deviate += np.sqrt(transfer.neighbours) * field_
    volume *= transfer.factor(ratio, float(deviate))
    aperture = shapely.transform(pad.aperture, lambda xy: xy + centre)
    volume *= defects.volume * pad.aperture.area * registration.stencil_mm * efficiency
    speck = _speck(defects, centre, half) if defects.speck else None
    if volume <= 0.0:
        return Deposit(pad, aperture, _none_left(defects), ratio, efficiency, None, speck=speck)

    stretch = (1.0 + slump / half) * np.sqrt(defects.area)
    shaped = deposit(
        _tessellated(opening.wkb, paste.fine_step_mm),
        volume,
        (float(stretch[0]), float(stretch[1])),
        Form(
            edge,
            wall,
            scoop,
            ear,
            rough,
            (float(stroke[0]), float(stroke[1])),
            defects.peak_mm,
            defects.peak_width_mm,
            defects.peak_at,
        ),
        paste,
        board.generator(PAD, pad.id, 2),
    )
    offset = offset + 2.0 * float(half.min()) * np.asarray(defects.shift)
    xy = _turned(shaped.xy_mm, slant + turn + defects.rotation_rad) + offset + centre
    xy = _turned(xy, registration.turn_rad) + registration.shift_mm
    field = Heightfield(xy, shaped.faces, shaped.rims, shaped.height_mm)
    whole = Deposit(pad, aperture, defects, ratio, efficiency, field, speck=speck)
    if defects.tail is None:
        return whole
    tail, volume = _tail(defects, whole.footprint, 2.0 * float(half.min()), paste)
    return replace(whole, tail=tail, tail_volume_mm3=volume)


def _none_left(defects: PadDefects) -> PadDefects:
    """An aperture too small to release any paste is a missing deposit too."""
    kept = tuple(name for name in defects.classes if name == "contamination")
    return PadDefects(("missing", *kept), volume=0.0, speck=defects.speck)


def _slant(aperture: shapely.Polygon) -> float:
    """Angle of the aperture's own axes: those of its smallest enclosing rectangle, unless upright fits as well."""
    box = shapely.oriented_envelope(aperture)
    if box.area > (1.0 - 1e-6) * shapely.envelope(aperture).area:
        return 0.0
    start, end = shapely.get_coordinates(box)[:2]
    return float(np.arctan2(*(end - start)[::-1]) % (np.pi / 2))


def _turned(xy: Floats, angle_rad: float) -> Floats:
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turned: Floats = xy @ np.array([[cos, sin], [-sin, cos]])
    return turned


def _tail(
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


def _speck(defects: PadDefects, centre: Floats, half: Floats) -> Heightfield:
    """A rounded body next to or on a pad."""
    speck = defects.speck
    assert speck is not None
    middle = centre + float(half.max()) * np.asarray(speck.at)
    mesh = tessellate(
        disk(float(middle[0]), float(middle[1]), speck.radius_mm), speck.radius_mm / 8
    )
    height = speck.height_mm * shoulder(mesh.depth_mm, speck.radius_mm, 0.1)
    return Heightfield(mesh.xy_mm, mesh.faces, mesh.rims, height)


def _lifted(deposit_: Deposit, all_: Sequence[Deposit], tree: shapely.STRtree) -> Deposit:
    """The deposit with its speck raised onto the highest paste below it."""
    speck, ground = deposit_.speck, 0.0
    if speck is None:
        return deposit_
    centre, radius = speck.xy_mm.mean(axis=0), np.sqrt(speck.area_mm2 / np.pi)
    for field in (all_[i].field for i in tree.query(_outline(speck), "intersects")):
        assert field is not None
        below = field.height_mm[np.linalg.norm(field.xy_mm - centre, axis=1) <= radius]
        ground = max(ground, float(below.mean()) if len(below) else 0.0)
    raised = Heightfield(speck.xy_mm, speck.faces, speck.rims, speck.height_mm + ground)
    return replace(deposit_, speck=raised)


def _bridges(board: Board, deposits: Mapping[int, Deposit]) -> list[PasteBridge]:
    """Deposits that touch, and the bridges drawn between neighbours."""
    settings = board.defects.bridge
    there = [d for d in deposits.values() if d.field is not None]
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
        ends = _gap(footprints[i], footprints[j], width, float(rng.random()))
        along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        start, end = ends[0] - EMBEDDED_MM * along, ends[1] + EMBEDDED_MM * along
        field = _strip(start, end, width, height, 1.0, board.paste)
        between = _outline(field).difference(shapely.union_all([footprints[i], footprints[j]]))
        bridges.append(
            PasteBridge((a.pad.id, b.pad.id), field, _pair(ends), field.part_volume_mm3(between))
        )
    return bridges


def _gap(
    a: shapely.Polygon, b: shapely.Polygon, width_mm: float, where: float
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
    if any(len(hit) == 0 for hit in hits) or hits[0].max() >= hits[1].min():
        # Hollow outlines may not face each other there.
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
