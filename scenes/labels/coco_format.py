"""Detection and segmentation labels in COCO's JSON form (T.-Y. Lin et al., ECCV 2014; cocodataset.org, "Data format").

Outlines are the deposits' own, projected through the camera: never read off a rendered image. COCO's image coordinates
are continuous with the first pixel's corner at (0, 0), as this project's are.
"""

from collections.abc import Iterable
from typing import Any, get_args

import numpy as np
import shapely
from numpy.typing import NDArray

from scenes.board.defects import CLASSES
from scenes.board.deposits import Deposit, Print
from scenes.board.pad_layout import DamageClass
from scenes.board.printing import printed
from scenes.rig.projection import Projection
from scenes.scene import Scene
from scenes.support.errors import SceneError

# What a detector is neither rewarded nor punished for: pads cut by the region's edge, whose bare copper looks like a
# missing deposit. Annotated as crowds, which readers leave out.
IGNORE = "ignore"
DAMAGE: tuple[str, ...] = get_args(DamageClass)
CATEGORIES: tuple[str, ...] = ("good", *CLASSES, IGNORE, *DAMAGE)
# Objects next to or on a deposit, which has a class of its own.
OWN_OUTLINE = ("smear", "bridge", "contamination")
# A bridge of deposits that touch, which they do not hide.
TOUCH = "touch"
# Words that IPC-7527 (Requirements for Solder Paste Printing) and its users have for the classes; the trade's, not checked
# against the standard's text.
IPC_NAMES = {
    "good": "acceptable",
    "missing": "missing paste",
    "insufficient": "insufficient paste",
    "excess": "excessive paste",
    "low-area": "insufficient coverage",
    "high-area": "slumping",
    "offset": "misregistration",
    "peak": "dog ears or peaking",
    "smear": "smearing",
    "bridge": "bridging",
    "contamination": "foreign material",
    "scratch": "scratched solder mask",
    "residue": "residue",
    "mask-shift": "solder mask misregistration",
}
# Outlines smaller than this cannot be drawn, nor have COCO's readers a box for them.
SMALLEST_PX2 = 0.5
# Straight pieces of an outline this short keep it true under lens distortion.
PIECE_MM = 0.05


def coco(scene: Scene, file_name: str, image_id: int = 1) -> dict[str, Any]:
    """One image's detection and segmentation labels in COCO's form.

    Parameters
    ----------
    scene
        A scene with a board.
    file_name
        Name of the image, as COCO's readers open it.
    image_id
        Number of the image, 1 or more.

    Returns
    -------
    dict
        COCO's tables. A deposit is annotated once under each defect of its own shape, as `good` if it has none; smears, bridges
        and contaminations are objects of their own. Masks are what is seen from above: a speck hides paste, a deposit a smear. Outlines
        and boxes are in pixels, (0, 0) being the first pixel's corner; ``pad`` is the pad's id. Masks with holes are
        run-length encoded, which COCO's polygons cannot express. Bare copper of pads that the region's edge cuts is
        `ignore`, with ``iscrowd`` 1; all others have 0.

    Raises
    ------
    SceneError
        For a scene without a board.

    Notes
    -----
    A missing deposit has its aperture's outline. A bridge is annotated once, under the first of its two pads, with the
    outline of the paste between them; a contamination with its own. Outlines are cut at the image's edge.

    Examples
    --------
    >>> import scenes
    >>> sorted(scenes.coco(scenes.load("spi"), "picture.png"))
    ['annotations', 'categories', 'images', 'info', 'licenses']
    """
    if scene.seen_board is None:
        raise SceneError(f"scene '{scene.name}' has no board: only boards have pads to label")
    camera, print_ = scene.camera.projection(), printed(scene.seen_board)
    annotations: list[dict[str, Any]] = []
    for name, pad, outline, z_mm in _outlines(print_):
        seen = _imaged(outline, z_mm, camera)
        if seen.area >= SMALLEST_PX2:
            annotations.append(_annotation(len(annotations) + 1, image_id, name, pad, seen, camera))
    return {
        "info": {"description": scene.description, "version": "1.0"},
        "licenses": [],
        "images": [
            {"id": image_id, "file_name": file_name, "width": camera.width, "height": camera.height}
        ],
        "annotations": annotations,
        "categories": categories(),
    }


def categories() -> list[dict[str, Any]]:
    """COCO's list of categories, the same for every image."""
    return [
        {"id": i, "name": name, "supercategory": "paste"}
        for i, name in enumerate(CATEGORIES, start=1)
    ]


def _outlines(print_: Print) -> Iterable[tuple[str, int, shapely.Polygon, float]]:
    """Category, pad, world outline and its height, of everything there is to annotate."""
    for name, pad, outline in _flat_outlines(print_):
        rise = (
            print_.warp.z_mm(np.array(outline.centroid.coords[0])) if not outline.is_empty else 0.0
        )
        yield name, pad, outline, print_.stackup.pad_mm + float(rise)


def _flat_outlines(print_: Print) -> Iterable[tuple[str, int, shapely.Geometry]]:
    """Category, pad and world outline of what is seen from above: specks hide paste, deposits hide smears and bridges."""
    found = list(_whole_outlines(print_))
    specks = [outline for name, _, outline in found if name == "contamination"]
    deposits = [d.footprint for d in print_.deposits if d.field is not None]
    thin = [outline for name, _, outline in found if name in ("smear", "bridge")]
    hiding = {"contamination": [], "smear": [*specks, *deposits], "bridge": [*specks, *deposits]}
    trees = {
        name: shapely.STRtree(parts)
        for name, parts in {
            **hiding,
            **{key: [*specks, *deposits, *thin] for key in ("missing", IGNORE, *DAMAGE)},
            "": specks,
        }.items()
    }
    for name, pad, outline in found:
        tree = trees.get(name, trees[""])
        hits = tree.geometries[tree.query(outline, "intersects")]
        yield name, pad, outline.difference(shapely.union_all(hits)) if len(hits) else outline


def _whole_outlines(print_: Print) -> Iterable[tuple[str, int, shapely.Geometry]]:
    for deposit in print_.deposits:
        yield from _of_deposit(deposit)
    layout, origin = print_.layout, np.asarray(print_.layout.centre_mm)
    flat: list[tuple[str, int, shapely.Geometry]] = [
        *((IGNORE, cut.id, copper) for cut, copper in layout.cut_copper),
        *((mark.name, mark.pad, mark.outline) for mark in layout.damage),
    ]
    for name, pad, outline in flat:
        yield name, pad, shapely.transform(outline, lambda xy: xy - origin)
    outlines = {deposit.pad.id: deposit.footprint for deposit in print_.deposits}
    for bridge in print_.bridges:
        if bridge.field is not None:
            strip = shapely.Polygon(bridge.field.xy_mm[bridge.field.rims[0]])
            yield "bridge", bridge.pads[0], strip
        else:
            a, b = (outlines[pad] for pad in bridge.pads)
            # They touch: the overlap, or the two together where it has no area.
            yield TOUCH, bridge.pads[0], a & b if (a & b).area > 0 else a | b


def _of_deposit(deposit: Deposit) -> Iterable[tuple[str, int, shapely.Geometry]]:
    classes, pad = deposit.defects.classes, deposit.pad.id
    shape = deposit.aperture if deposit.field is None else deposit.footprint
    for other, field in (("contamination", deposit.speck), ("smear", deposit.tail)):
        if other in classes and field is not None:
            yield other, pad, shapely.Polygon(field.xy_mm[field.rims[0]])
    own: list[str] = [name for name in classes if name not in OWN_OUTLINE]
    for name in own or ["good"]:
        yield name, pad, shape


def _imaged(outline: shapely.Geometry, z_mm: float, camera: Projection) -> shapely.Geometry:
    """The outline as the camera images it, cut at the frame; in several pieces where something hides its middle."""
    pieces: list[shapely.Polygon] = []
    frame = shapely.box(0.0, 0.0, camera.width, camera.height)
    for part in shapely.get_parts(shapely.segmentize(outline, PIECE_MM)):
        if part.geom_type != "Polygon":
            continue
        rings = [_projected(ring, z_mm, camera) for ring in (part.exterior, *part.interiors)]
        if not all(np.isfinite(ring).all() for ring in rings):
            continue
        seen = shapely.Polygon(rings[0], rings[1:]).intersection(frame)
        pieces += [
            piece.simplify(0.01)
            for piece in shapely.get_parts(seen)
            if piece.geom_type == "Polygon" and piece.area >= SMALLEST_PX2
        ]
    return pieces[0] if len(pieces) == 1 else shapely.MultiPolygon(pieces)


def _projected(ring: shapely.LinearRing, z_mm: float, camera: Projection) -> NDArray[np.float64]:
    corners = shapely.get_coordinates(ring)
    pixels, _ = camera.project(np.column_stack([corners, np.full(len(corners), z_mm)]))
    return np.asarray(pixels, np.float64)


def _annotation(
    number: int, image_id: int, name: str, pad: int, polygon: shapely.Geometry, camera: Projection
) -> dict[str, Any]:
    x0, y0, x1, y1 = polygon.bounds
    return {
        "id": number,
        "image_id": image_id,
        "category_id": CATEGORIES.index("bridge" if name == TOUCH else name) + 1,
        "segmentation": _segmentation(polygon, camera, masked=name == IGNORE),
        "bbox": [round(float(v), 3) for v in (x0, y0, x1 - x0, y1 - y0)],
        "area": round(float(polygon.area), 3),
        "iscrowd": int(name == IGNORE),
        "pad": pad,
    }


def _segmentation(seen: shapely.Geometry, camera: Projection, masked: bool) -> Any:
    """COCO's polygon; run lengths of a mask for crowds, and for holes, which polygons cannot have there."""
    pieces = shapely.get_parts(seen)
    if not masked and not any(piece.interiors for piece in pieces):
        rings = [shapely.get_coordinates(piece.exterior)[:-1].ravel() for piece in pieces]
        return [[round(float(v), 3) for v in ring] for ring in rings]
    return {
        "size": [camera.height, camera.width],
        "counts": run_lengths(pixels_inside(seen, camera)),
    }


def pixels_inside(polygon: shapely.Geometry, camera: Projection) -> NDArray[np.bool_]:
    """(row, col) mask of the pixels whose centre is inside a polygon in image coordinates, px."""
    inside = np.zeros((camera.height, camera.width), np.bool_)
    x0, y0, x1, y1 = polygon.bounds
    columns = np.arange(max(int(x0), 0), min(int(np.ceil(x1)), camera.width))
    rows = np.arange(max(int(y0), 0), min(int(np.ceil(y1)), camera.height))
    x, y = np.meshgrid(columns + 0.5, rows + 0.5)
    inside[np.ix_(rows, columns)] = shapely.contains_xy(polygon, x, y)
    return inside


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Lengths of alternating runs of a (row, col) mask down its columns, the first one outside: COCO's RLE.

    >>> run_lengths(np.array([[False, True], [True, True]]))
    [1, 3]
    """
    flat = np.concatenate([[False], mask.ravel(order="F")])
    changes = np.flatnonzero(flat[1:] != flat[:-1])
    lengths: list[int] = np.diff(np.concatenate([[0], changes, [mask.size]])).tolist()
    return lengths
