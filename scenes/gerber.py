"""Gerber files as polygons, read by the gerbonara library (the optional extra `board`).

Round shapes become polygons of equal area; a nanometre is the finest detail kept.
"""

import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scenes.errors import FileError, SceneError
from scenes.layout import Area, Box, Pad, disk, moved, rectangle, rounded
from scenes.paths import is_file, missing

Role = Literal["paste", "mask", "copper", "outline"]
ROLES: tuple[Role, ...] = ("paste", "mask", "copper", "outline")
Side = Literal["top", "bottom"]

# Chord error of arcs in copper, mask and outline.
ARC_MM = 0.002
# Ends of an outline's pieces this close are one point: CAD tools round to 1 um at the coarsest.
SNAP_MM = 0.002
SMALLEST_PAD_MM2 = 1e-4
# No board is larger; a nanometre is lost beyond.
FARTHEST_MM = 1e5


def layer_files(folder: Path, side: Side, given: Mapping[Role, Path]) -> dict[Role, Path]:
    """Which file of a folder is which layer: as `given`, by the X2 attribute that names its function, else by its name.

    Raises `FileError` when the folder is missing or has no paste layer.
    """
    if not folder.is_dir():
        raise FileError(
            f"board folder '{folder}' does not exist: give the folder of the Gerber files"
        )
    files = sorted(path for path in folder.iterdir() if path.is_file())
    found: dict[Role, Path] = {}
    for path in files:
        role = _declared(path, side)
        if role:
            found.setdefault(role, path)
    if len(found) < len(ROLES):
        found = _named(files, side) | found
    found |= given
    if "paste" not in found:
        raise FileError(
            f"no {side} paste layer among the {len(files)} files of '{folder}': name it under [board.files] paste = ..."
        )
    return found


def read_pads(path: Path, mirrored: bool = False) -> tuple[Pad, ...]:
    """The openings of a paste layer: each flash, and each connected piece of what is drawn otherwise.

    Flashes that overlap are one opening. Raises `FileError` for a file that is no Gerber file or holds no opening.
    """
    with _drawn(path):
        return _pads([_normal(obj, mirrored) for obj in _objects(path)], path)


def _pads(
    pieces: Sequence[tuple[tuple[Area, bool], tuple[float, float], bool]], path: Path
) -> tuple[Pad, ...]:
    flashes: list[tuple[tuple[float, float], shapely.Polygon]] = []
    drawn: list[tuple[Area, bool]] = []
    for (shape, dark), place, flash in pieces:
        if flash and dark:
            flashes += [(place, part) for part in _polygons(shape)]
        else:
            drawn.append((shape, dark))
    erased = shapely.union_all([shape for shape, dark in drawn if not dark])
    if not erased.is_empty:
        flashes = [
            (place, part)
            for place, shape in flashes
            for part in _polygons(shape.difference(erased))
        ]
    flashes = _joined(flashes)
    for part in _polygons(_painted(drawn)):
        middle = part.centroid
        flashes.append(((middle.x, middle.y), part))
    if not flashes:
        raise FileError(f"'{path}' holds no paste opening: give the board's paste layer")
    return tuple(
        Pad(i, f"P{i}", place, rounded(moved(shape, (-place[0], -place[1]))))
        for i, (place, shape) in enumerate(flashes, start=1)
    )


def read_area(path: Path, box: Box, mirrored: bool = False) -> Area:
    """What a layer paints dark within a box; `FileError` for a file that is no Gerber file."""
    with _drawn(path):
        near = [obj for obj in _objects(path) if _near(obj, box, mirrored)]
        painted = _painted([_normal(obj, mirrored)[0] for obj in near])
        return painted.intersection(shapely.box(*box))


def _near(obj: Any, box: Box, mirrored: bool) -> bool:
    """Whether an object's bounds meet a box; most of a board's copper lies outside, and polygons cost more."""
    (x0, y0), (x1, y1) = obj.bounding_box("mm")
    if mirrored:
        x0, x1 = -x1, -x0
    return bool(x0 <= box[2] and x1 >= box[0] and y0 <= box[3] and y1 >= box[1])


def read_outline(path: Path, mirrored: bool = False) -> Area:
    """The laminate inside an outline layer's lines, without its cut-outs; `FileError` if the lines enclose nothing."""
    with _drawn(path):
        lines = [
            line
            for obj in _objects(path)
            for primitive in _primitives(obj)
            for line in _centre_lines(primitive)
        ]
        return _enclosed(lines, mirrored, path)


def _enclosed(lines: Sequence[shapely.LineString], mirrored: bool, path: Path) -> Area:
    if mirrored:
        lines = [shapely.transform(line, _mirror) for line in lines]
    tidy = shapely.set_precision(shapely.MultiLineString(lines), SNAP_MM)
    faces = shapely.get_parts(shapely.polygonize([shapely.node(tidy)]))
    if not len(faces):
        raise FileError(
            f"the lines of '{path}' enclose no area: give the board's outline layer, or leave it out"
        )
    # Outline and cut-outs nest: a face is board when an odd number of rings encloses it.
    rings = [shapely.Polygon(face.exterior) for face in faces]
    inner = [face.representative_point() for face in faces]
    board = [
        face
        for face, point in zip(faces, inner, strict=True)
        if sum(ring.contains(point) for ring in rings) % 2
    ]
    return shapely.union_all(board)


@contextmanager
def _drawn(path: Path) -> Iterator[None]:
    """What cannot be drawn, of damaged files mostly, as `FileError`."""
    try:
        # what is not finite `_check_reach` has refused
        with np.errstate(all="ignore"):
            yield
    except (shapely.errors.ShapelyError, ValueError, TypeError, OverflowError) as error:
        raise FileError(
            f"'{path}' draws a shape that cannot be: {error}; export the layer again"
        ) from error


def _check_reach(primitive: Any) -> None:
    """`ValueError` for a length that no board has: GEOS crashes the process on an infinite one."""
    for value in _lengths(vars(primitive).values()):
        if not abs(value) <= FARTHEST_MM:
            raise ValueError(
                f"{type(primitive).__name__} has a length of {value:g} mm, where up to {FARTHEST_MM:g} mm can be"
            )


def _lengths(values: Iterable[Any]) -> Iterator[float]:
    for value in values:
        if isinstance(value, (list, tuple)):
            yield from _lengths(value)
        elif isinstance(value, (int, float)):
            yield float(value)


def _objects(path: Path) -> Sequence[Any]:
    try:
        from gerbonara import GerberFile
    except ImportError as error:
        raise SceneError(
            'reading Gerber files needs the gerbonara library: pip install "fringebench[board]"'
        ) from error
    if not is_file(path):
        raise FileError(f"Gerber file '{path}' {missing(path)}: check the path")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            objects: Sequence[Any] = GerberFile.open(path).objects
    except Exception as error:
        raise FileError(
            f"'{path}' cannot be read as a Gerber file ({type(error).__name__}: {error})"
        ) from error
    if not objects:
        raise FileError(f"'{path}' draws nothing: it is empty or no Gerber file")
    return objects


def _primitives(obj: Any) -> list[Any]:
    try:
        primitives = list(obj.to_primitives("mm"))
    except Exception as error:
        raise FileError(f"a Gerber object cannot be used ({error}): {str(obj)[:120]}") from error
    for primitive in primitives:
        _check_reach(primitive)
    return primitives


def _normal(obj: Any, mirrored: bool) -> tuple[tuple[Area, bool], tuple[float, float], bool]:
    """((shape, dark), place, whether it is a flash) in mm."""
    flash = type(obj).__name__ == "Flash"
    primitives = _primitives(obj)
    dark = bool(obj.polarity_dark)
    # Within one flash an aperture's own holes are painted over its body, whatever the object's polarity.
    parts = [(_polygon(p), bool(p.polarity_dark) == dark) for p in primitives]
    shape = parts[0][0] if len(parts) == 1 and parts[0][1] else _painted(parts)
    place = (0.0, 0.0)
    if flash:
        place = (float(obj.unit.convert_to("mm", obj.x)), float(obj.unit.convert_to("mm", obj.y)))
    if mirrored:
        shape, place = shapely.transform(shape, _mirror), (-place[0], place[1])
    return (shape, dark), place, flash


def _polygon(primitive: Any) -> Area:
    match type(primitive).__name__:
        case "Circle":
            return disk(primitive.x, primitive.y, primitive.r)
        case "Rectangle":
            return rectangle(primitive.x, primitive.y, primitive.w, primitive.h, primitive.rotation)
        case "Line" | "Arc":
            return shapely.union_all(
                [
                    line.buffer(primitive.width / 2, quad_segs=16)
                    for line in _centre_lines(primitive)
                ]
            )
        case "ArcPoly":
            shape = shapely.Polygon(np.concatenate([_points(s)[:-1] for s in primitive.segments]))
            # Cut-ins, by which a region has holes, touch themselves.
            return shape if shape.is_valid else shapely.make_valid(shape, method="structure")
    raise FileError(f"Gerber shape {type(primitive).__name__} is not supported")


def _centre_lines(primitive: Any) -> Iterable[shapely.LineString]:
    match type(primitive).__name__:
        case "Line":
            start, end = (primitive.x1, primitive.y1), (primitive.x2, primitive.y2)
            return [shapely.LineString([start, end])]
        case "Arc":
            arc = (primitive.clockwise, (primitive.cx, primitive.cy))
            start, end = (primitive.x1, primitive.y1), (primitive.x2, primitive.y2)
            return [shapely.LineString(_points((start, end, arc)))]
        case "ArcPoly":
            return [shapely.LineString(_points(segment)) for segment in primitive.segments]
    return []


def _points(segment: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(point, 2) along a straight or circular piece, both ends included."""
    start, end, (clockwise, centre) = segment
    if clockwise is None:
        return np.array([start, end], dtype=np.float64)
    a, b = np.subtract(start, centre), np.subtract(end, centre)
    radius = float(np.hypot(*a))
    first, last = np.arctan2(a[1], a[0]), np.arctan2(b[1], b[0])
    sweep = (first - last if clockwise else last - first) % (2 * np.pi)
    # Start and end alike: a full circle.
    sweep = sweep if sweep > 1e-9 else 2 * np.pi
    finest = 2 * np.arccos(max(1.0 - ARC_MM / max(radius, ARC_MM), 0.0))
    count = max(int(np.ceil(sweep / max(finest, 1e-3))), 2)
    angle = first + np.linspace(0.0, -sweep if clockwise else sweep, count + 1)
    points = np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    points[0], points[-1] = start, end
    return points


def _painted(pieces: Sequence[tuple[Area, bool]]) -> Area:
    """Dark pieces added, clear ones taken away, in order."""
    area: Area = shapely.Polygon()
    start = 0
    while start < len(pieces):
        dark, end = pieces[start][1], start
        while end < len(pieces) and pieces[end][1] == dark:
            end += 1
        layer = shapely.union_all([shape for shape, _ in pieces[start:end]])
        area = area.union(layer) if dark else area.difference(layer)
        start = end
    return area


def _polygons(area: Area) -> list[shapely.Polygon]:
    parts = shapely.get_parts(area)
    return [p for p in parts if p.geom_type == "Polygon" and p.area > SMALLEST_PAD_MM2]


def _joined(
    flashes: list[tuple[tuple[float, float], shapely.Polygon]],
) -> list[tuple[tuple[float, float], shapely.Polygon]]:
    """Flashes with those that overlap made one, at the first one's place."""
    if not flashes:
        return flashes
    shapes = np.array([shape for _, shape in flashes])
    a, b = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    overlap = shapely.area(shapely.intersection(shapes[a], shapes[b])) > SMALLEST_PAD_MM2
    a, b = a[overlap], b[overlap]
    size = len(flashes)
    _, group = connected_components(coo_array((np.ones(len(a)), (a, b)), shape=(size, size)))
    if len(np.unique(group)) == size:
        return flashes
    joined = []
    for first in np.unique(group, return_index=True)[1]:
        members = shapes[group == group[first]]
        joined.append((int(first), (flashes[first][0], shapely.union_all(members))))
    return [item for _, item in sorted(joined, key=lambda pair: pair[0])]


def _mirror(xy: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The bottom side, seen from below."""
    return np.column_stack([-xy[:, 0], xy[:, 1]])


def _declared(path: Path, side: Side) -> Role | None:
    """A layer's role by its TF.FileFunction attribute, plain or in a comment."""
    try:
        head = path.read_bytes()[:8192].decode("latin-1")
    except OSError as error:
        raise FileError(f"'{path}' cannot be read: {error}") from error
    match = re.search(r"TF\.FileFunction,([^*\n]*)", head)
    if not match:
        return None
    kind, *rest = match[1].lower().split(",")
    tests: dict[str, tuple[Role, Callable[[], bool]]] = {
        "paste": ("paste", lambda: rest[:1] == [side]),
        "soldermask": ("mask", lambda: rest[:1] == [side]),
        "copper": ("copper", lambda: side[:3] in rest),
        "profile": ("outline", lambda: True),
    }
    role, test = tests.get(kind, (None, lambda: False))
    return role if test() else None


def _named(files: Sequence[Path], side: Side) -> dict[Role, Path]:
    """Roles by the naming rules of the CAD tool that fits most layers."""
    try:
        from gerbonara.layer_rules import MATCH_RULES
    except ImportError:
        return {}
    names = {
        "paste": f"{side} paste",
        "mask": f"{side} mask",
        "copper": f"{side} copper",
        "outline": "mechanical outline",
    }
    best: dict[Role, Path] = {}
    for rules in MATCH_RULES.values():
        found: dict[Role, Path] = {}
        for role in ROLES:
            rule = rules.get(names[role])
            fits = [p for p in files if rule and re.fullmatch(rule, p.name, re.IGNORECASE)]
            if fits:
                found[role] = fits[0]
        if len(found) > len(best):
            best = found
    return best
