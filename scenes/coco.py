"""Detection and segmentation labels in COCO's JSON form (T.-Y. Lin et al., ECCV 2014; cocodataset.org, "Data format").

Outlines are the deposits' own, projected through the camera: never read off a rendered image. COCO's image coordinates
are continuous with the first pixel's corner at (0, 0), as this project's are.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import shapely

from scenes.defects import CLASSES
from scenes.errors import SceneError
from scenes.printing import Bridge, Deposit, Print, printed
from scenes.rig import Projection
from scenes.scene import Scene

CATEGORIES: tuple[str, ...] = ("good", *CLASSES)
# Outlines smaller than this cannot be drawn, nor have COCO's readers a box for them.
SMALLEST_PX2 = 0.5
# Straight pieces of an outline this short keep it true under lens distortion.
PIECE_MM = 0.05


def coco(scene: Scene, file_name: str, image_id: int = 1) -> dict[str, Any]:
    """One image's annotations: a deposit without defects as `good`, any other once under each of its defects.

    A missing deposit's outline is its aperture's; a bridge is annotated once under the first of its two pads, with the
    outline of the paste between them; a contamination with its own. Outlines are cut at the image's edge, and what lies
    outside is left out. `pad` on each annotation is the pad's id. Raises `SceneError` for a scene without a board.
    """
    if scene.board is None:
        raise SceneError(f"scene '{scene.name}' has no board: only boards have pads to label")
    camera, print_ = scene.camera.projection(), printed(scene.board)
    annotations: list[dict[str, Any]] = []
    for name, pad, outline, z_mm in _outlines(print_):
        for polygon in _imaged(outline, z_mm, camera):
            annotations.append(_annotation(len(annotations) + 1, image_id, name, pad, polygon))
    return {
        "info": {"description": scene.description, "version": "1.0"},
        "licenses": [],
        "images": [
            {
                "id": image_id,
                "file_name": file_name,
                "width": camera.width,
                "height": camera.height,
            }
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


def merged(images: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """The files of many images as one; images and annotations are numbered anew, in order."""
    whole: dict[str, Any] = {
        "info": {"version": "1.0"},
        "licenses": [],
        "images": [],
        "annotations": [],
        "categories": categories(),
    }
    for part in images:
        number = {}
        for image in part["images"]:
            number[image["id"]] = len(whole["images"]) + 1
            whole["images"].append(image | {"id": number[image["id"]]})
        for note in part["annotations"]:
            renumbered = {
                "id": len(whole["annotations"]) + 1,
                "image_id": number[note["image_id"]],
            }
            whole["annotations"].append(note | renumbered)
    return whole


def _outlines(print_: Print) -> Iterable[tuple[str, int, shapely.Polygon, float]]:
    """Category, pad, world outline and its height, of everything there is to annotate."""
    ground = print_.stackup.pad_mm
    bridged = {pad for bridge in print_.bridges for pad in bridge.pads}
    for deposit in print_.deposits:
        yield from _of_deposit(deposit, deposit.pad.id in bridged, ground)
    outlines = {deposit.pad.id: deposit.footprint for deposit in print_.deposits}
    for bridge in print_.bridges:
        yield "bridge", bridge.pads[0], _of_bridge(bridge, outlines), ground


def _of_deposit(
    deposit: Deposit, bridged: bool, ground_mm: float
) -> Iterable[tuple[str, int, shapely.Polygon, float]]:
    classes, pad = deposit.fate.classes, deposit.pad.id
    shape = deposit.aperture if deposit.field is None else deposit.footprint
    if not classes and not bridged:
        yield "good", pad, shape, ground_mm
    for name in classes:
        outline = shape
        if name == "contamination" and deposit.speck is not None:
            outline = shapely.Polygon(deposit.speck.xy_mm[deposit.speck.rims[0]])
        elif name == "smear" and deposit.tail is not None:
            tail = shapely.Polygon(deposit.tail.xy_mm[deposit.tail.rims[0]])
            outline = tail.difference(deposit.footprint)
        yield name, pad, outline, ground_mm


def _of_bridge(bridge: Bridge, outlines: dict[int, shapely.Polygon]) -> shapely.Geometry:
    a, b = (outlines[pad] for pad in bridge.pads)
    if bridge.field is None:
        # They touch: the overlap, or the two together where it has no area.
        overlap = a.intersection(b)
        return overlap if overlap.area > 0 else a.union(b)
    strip = shapely.Polygon(bridge.field.xy_mm[bridge.field.rims[0]])
    return strip.difference(a.union(b))


def _imaged(
    outline: shapely.Geometry, z_mm: float, camera: Projection
) -> Iterable[shapely.Polygon]:
    """The outline's pieces as the camera images them, cut at the frame."""
    frame = shapely.box(0.0, 0.0, camera.width, camera.height)
    for part in shapely.get_parts(shapely.segmentize(outline, PIECE_MM)):
        if part.geom_type != "Polygon":
            continue
        corners = shapely.get_coordinates(part.exterior)
        pixels, _ = camera.project(np.column_stack([corners, np.full(len(corners), z_mm)]))
        if not np.isfinite(pixels).all():
            continue
        seen = shapely.Polygon(pixels).intersection(frame)
        for piece in shapely.get_parts(seen):
            if piece.geom_type == "Polygon" and piece.area >= SMALLEST_PX2:
                yield piece.simplify(0.01)


def _annotation(
    number: int, image_id: int, name: str, pad: int, polygon: shapely.Polygon
) -> dict[str, Any]:
    x0, y0, x1, y1 = polygon.bounds
    flat = [round(float(v), 3) for v in shapely.get_coordinates(polygon.exterior)[:-1].ravel()]
    return {
        "id": number,
        "image_id": image_id,
        "category_id": CATEGORIES.index(name) + 1,
        "segmentation": [flat],
        "bbox": [round(float(v), 3) for v in (x0, y0, x1 - x0, y1 - y0)],
        "area": round(float(polygon.area), 3),
        "iscrowd": 0,
        "pad": pad,
    }
