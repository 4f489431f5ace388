"""A board with its paste: everything drawn, and every deposit, bridge, smear and speck shaped and placed in the world.

Each pad and each pair of neighbours has its own random numbers, from the board's seed and the pads' ids. So a
deposit is the same in every region of the board.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from string import digits

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import TypeAdapter

from scenes.board.board import Board
from scenes.board.defects import PadDefects, draw_defects
from scenes.board.deposits import Deposit, Print
from scenes.board.extras.damage import damaged
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.layers import Legend
from scenes.board.pad_layout import Layout, Pad, area_ratio, rounded
from scenes.board.paste import Form, deposit
from scenes.board.stray_paste import drawn_bridges, foreign_body, lifted, smear_tail
from scenes.shapes.tessellation import Tessellation, tessellate
from scenes.support.distribution import draw

Floats = NDArray[np.float64]

# Streams of random numbers; 0 is the board's layers.
PRINT, PAD = 1, 2
FIELD = 5
# Rounding that takes less of the area than this is that of a circle's polygon, not of corners.
LEAST_CORNER = 1e-3


@dataclass(frozen=True)
class _Registration:
    """Pose of the stencil on the board."""

    stencil_mm: float
    shift_mm: tuple[float, float]
    turn_rad: float
    stretch: float


def printed(board: Board) -> Print:
    """The board with everything drawn from its seed: deposits and bridges in world coordinates, mm.

    The last print is cached: light, truth and labels of a sample all use the same one.
    """
    return _printed(board.model_dump_json(), _stamps(board))


@lru_cache(maxsize=1)
def _printed(board_json: str, stamps: tuple[tuple[str, int, int], ...]) -> Print:
    board: Board = TypeAdapter(Board).validate_json(board_json)
    stackup = board.stackup()
    layout = damaged(board, artwork(board), stackup)
    rng, paste = board.generator(PRINT), board.paste
    registration = _Registration(
        draw(paste.stencil_mm, rng),
        (draw(paste.shift_x_mm, rng), draw(paste.shift_y_mm, rng)),
        float(np.deg2rad(draw(paste.turn_deg, rng))),
        draw(paste.stretch, rng),
    )
    made = [_deposit(board, layout, pad, registration) for pad in layout.pads]
    bridges = drawn_bridges(board, made)
    return Print(
        layout,
        stackup,
        registration.stencil_mm,
        tuple(lifted(made, bridges)),
        tuple(bridges),
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
    if plain.legend:  # Its height does not change where it is.
        plain = plain.model_copy(update={"legend": Legend()})
    return _artwork(plain.model_dump_json(), _stamps(board))


@lru_cache(maxsize=8)
def _artwork(board_json: str, stamps: tuple[tuple[str, int, int], ...]) -> Layout:
    board: Board = TypeAdapter(Board).validate_json(board_json)
    return board.layout()


def _stamps(board: Board) -> tuple[tuple[str, int, int], ...]:
    """Name, size and time of every file the layout could depend on."""
    if not isinstance(board, GerberBoard):
        return ()
    given = [*board.files.model_dump(exclude={"drill"}).values(), *board.files.drill]
    folder = board.folder
    files = [path if folder is None else folder / path for path in given if path]
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
    transfer = paste.transfer_to(pad.part or (pad.name, pad.name.rstrip(digits)))
    reach = np.abs(stroke) @ half, np.abs(stroke[::-1]) @ half
    efficiency = transfer.efficiency(ratio, float((reach[1] - reach[0]) / (reach[0] + reach[1])))
    deviate = np.sqrt(1.0 - transfer.neighbours) * board.generator(PAD, pad.id, 3).standard_normal()
    if transfer.neighbours:
        field_ = transfer.common(pad.centre_mm, board.generator(FIELD))
        deviate += np.sqrt(transfer.neighbours) * field_
    volume *= transfer.factor(ratio, float(deviate))
    aperture = shapely.transform(pad.aperture, lambda xy: xy + centre)
    volume *= defects.volume * pad.aperture.area * registration.stencil_mm * efficiency
    speck = foreign_body(defects, centre, half) if defects.speck else None
    if volume <= 0.0:
        return Deposit(pad, aperture, _none_left(defects), ratio, efficiency, None, speck=speck)

    stretch = (1.0 + slump / half) * np.sqrt(defects.area)
    shaped = deposit(
        _tessellated(_blunt(opening, paste.corner_mm).wkb, paste.fine_step_mm),
        volume,
        (float(stretch[0]), float(stretch[1])),
        Form(
            edge,
            wall,
            scoop,
            ear,
            rough,
            (float(stroke[0]), float(stroke[1])),
            slump,
            defects.peak_mm,
            defects.peak_width_mm,
            defects.peak_at,
        ),
        paste,
        board.generator(PAD, pad.id, 2),
    )
    offset = offset + 2.0 * float(half.min()) * np.asarray(defects.shift)
    xy = _turned(shaped.xy_mm, slant + turn + defects.rotation_rad) + offset
    xy = xy + (1.0 + registration.stretch) * centre
    xy = _turned(xy, registration.turn_rad) + registration.shift_mm
    field = replace(shaped, xy_mm=xy)
    whole = Deposit(pad, aperture, defects, ratio, efficiency, field, speck=speck)
    if defects.tail is None:
        return whole
    tail, volume = smear_tail(defects, whole.footprint, 2.0 * float(half.min()), paste)
    return replace(whole, tail=tail, tail_volume_mm3=volume)


def _blunt(opening: shapely.Polygon, corner_mm: float) -> shapely.Polygon:
    """The opening with its corners rounded; as it is where it has none, or would fall into pieces."""
    low, high = np.array(opening.bounds).reshape(2, 2)
    radius = min(corner_mm, float((high - low).min()) / 4)
    blunt = opening.buffer(-radius).buffer(radius, quad_segs=4)
    lost = 1.0 - blunt.area / opening.area
    return blunt if blunt.geom_type == "Polygon" and LEAST_CORNER < lost < 0.1 else opening


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
