"""A board and its paste as renderable meshes: one per material, with the pad that every triangle belongs to.

Hundreds of deposits as shapes of their own would slow a renderer down; what tells them apart is a number per triangle.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.board import SOIL, Board
from scenes.board_surface import surfaces
from scenes.heightfield import Heightfield
from scenes.printing import Bridge, Print, printed

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Paste stands on the pad and on whatever lies beside it: its walls run down to the laminate, drawn in by this much so
# that they never lie in a pad's or a mask opening's wall.
UNDERCUT_MM = 0.002


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles of one label and material, world mm."""

    label: str
    material: str
    vertices: Floats
    faces: Ints
    pad: NDArray[np.int32]
    """(face,) pad id, 0 for none."""
    smooth: bool


def bodies(board: Board) -> tuple[Body, ...]:
    """Everything of a board that can be seen, in the order of its labels."""
    return tuple(_bodies(board, printed(board)))


def _bodies(board: Board, print_: Print) -> Iterable[Body]:
    layers, paste = board.layers, board.paste
    materials = {
        "base": layers.laminate_material,
        "mask": layers.mask_material,
        "pad": layers.pad_material,
    }
    x, y = print_.layout.centre_mm
    for label, surface in surfaces(print_.layout, print_.stackup).items():
        world = surface.vertices - np.array([x, y, 0.0])
        yield Body(
            label, materials[label], world, surface.faces, surface.pad.astype(np.int32), False
        )
    base = print_.stackup.pad_mm
    fields = [(d.field, _same(d.pad.id, d.field)) for d in print_.deposits if d.field]
    fields += [(d.tail, _same(d.pad.id, d.tail)) for d in print_.deposits if d.tail]
    fields += [(b.field, _halves(b, b.field)) for b in print_.bridges if b.field]
    smooth = paste.texture == "smooth"
    if fields:
        yield _shells("paste", paste.material, fields, base, smooth)
    specks = [(d.speck, _same(d.pad.id, d.speck)) for d in print_.deposits if d.speck]
    if specks:
        yield _shells(SOIL, board.defects.contamination.material, specks, base, False)


def _shells(
    label: str, material: str, fields: list[tuple[Heightfield, Ints]], base_mm: float, smooth: bool
) -> Body:
    vertices, faces, pads, count = [], [], [], 0
    for field, top in fields:
        v, f = field.shell(base_mm, 0.0, UNDERCUT_MM)
        pads.append(np.concatenate([top, np.full(len(f) - len(top), top[0])]))
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return Body(
        label,
        material,
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(pads).astype(np.int32),
        smooth,
    )


def _same(pad: int, field: Heightfield) -> Ints:
    return np.full(len(field.faces), pad, dtype=np.int64)


def _halves(bridge: Bridge, field: Heightfield) -> Ints:
    """A bridge's triangles, each of the pad whose end is nearer."""
    centre = field.xy_mm[field.faces].mean(axis=1)
    a, b = bridge.ends_mm
    nearer = np.linalg.norm(centre - a, axis=1) <= np.linalg.norm(centre - b, axis=1)
    return np.where(nearer, *bridge.pads).astype(np.int64)
