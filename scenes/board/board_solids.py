"""A board and its paste as renderable meshes: one per material, with the pad that every triangle belongs to.

Hundreds of separate shapes would slow a renderer down; a number per triangle identifies the deposit instead.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scenes.board.board import Board
from scenes.board.board_settings import CONTAMINATION, FIDUCIAL, HOLE, LEGEND, RESIDUE, SCRATCH
from scenes.board.deposits import PasteBridge, Print
from scenes.board.extras.solder_domes import Dome, domes, on_domes
from scenes.board.printing import printed
from scenes.board.surface import surfaces
from scenes.board.warp import FACE_MM, WarpedPlane
from scenes.shapes.heightfield import Heightfield

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Paste covers the pad and its surroundings: its walls run down to the laminate, moved inwards by this much so that they
# never coincide with the wall of a pad or of a mask opening.
UNDERCUT_MM = 0.002


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles of one label and material, world mm."""

    label: str
    material: str
    vertices: Floats
    """(vertex, 3), world mm."""
    faces: Ints
    """(face, 3) indices of vertices."""
    pad: NDArray[np.int32]
    """(face,) pad id, 0 for none."""
    smooth: bool


def bodies(board: Board) -> tuple[Body, ...]:
    """Everything of a board that can be seen, in the order of its labels."""
    print_ = printed(board)
    warp, parts = print_.warp, tuple(_bodies(board, print_))
    if warp == WarpedPlane():
        return parts
    rise = [np.column_stack([np.zeros((len(b.vertices), 2)), warp.z_mm(b.vertices)]) for b in parts]
    return tuple(replace(b, vertices=b.vertices + up) for b, up in zip(parts, rise, strict=True))


def _bodies(board: Board, print_: Print) -> Iterable[Body]:
    layers, paste = board.layers, board.paste
    looks = {
        "base": ("base", layers.laminate_material),
        "mask": ("mask", layers.mask_material),
        "pad": ("pad", layers.pad_material),
        RESIDUE: (RESIDUE, board.defects.residue.material),
        "scratched copper": (SCRATCH, "copper"),
        "scratched laminate": (SCRATCH, layers.laminate_material),
        FIDUCIAL: (FIDUCIAL, layers.pad_material),
        LEGEND: (LEGEND, board.legend.material if board.legend else ""),
        HOLE: (HOLE, board.through.material if board.through else ""),
        "plated wall": (HOLE, layers.pad_material),
        "bare wall": (HOLE, layers.laminate_material),
    }
    x, y = print_.layout.centre_mm
    face_mm = FACE_MM if print_.warp.curvature_per_mm else None
    for kind, surface in surfaces(print_.layout, print_.stackup, face_mm).items():
        world = surface.vertices - np.array([x, y, 0.0])
        yield Body(*looks[kind], world, surface.faces, surface.pad.astype(np.int32), False)
    base = print_.stackup.pad_mm
    tin = domes(board, print_.layout)
    for label in dict.fromkeys(dome.label for dome in tin):
        tops = [(dome.field, _same(dome.pad, dome.field)) for dome in tin if dome.label == label]
        yield _shells(label, layers.pad_material, tops, base, True, walls=False)
    fields = [(d.field, _same(d.pad.id, d.field)) for d in print_.deposits if d.field]
    fields += [(d.tail, _same(d.pad.id, d.tail)) for d in print_.deposits if d.tail]
    fields += [(b.field, _halves(b, b.field)) for b in print_.bridges if b.field]
    fields = [(_raised(field, tin), pads) for field, pads in fields]
    if fields:
        shells = _shells("paste", paste.material, fields, base, paste.texture != "granular")
        # Grains, the flux between them, and paste without either, such as smears.
        kinds = np.concatenate([_kinds(field) for field, _ in fields])
        named = (paste.grain_material, paste.flux_material, paste.material)
        for number, name in enumerate(named):
            if (own := kinds == number).any():
                yield replace(shells, material=name, faces=shells.faces[own], pad=shells.pad[own])
    specks = [(_raised(d.speck, tin), _same(d.pad.id, d.speck)) for d in print_.deposits if d.speck]
    if specks:
        yield _shells(CONTAMINATION, board.defects.contamination.material, specks, base, False)


def _shells(
    label: str,
    material: str,
    fields: list[tuple[Heightfield, Ints]],
    base_mm: float,
    smooth: bool,
    walls: bool = True,
) -> Body:
    vertices, faces, pads, count = [], [], [], 0
    for field, top in fields:
        v, f = field.shell(base_mm, 0.0, UNDERCUT_MM)
        if not walls:  # Normals at the rim are the surface's own.
            v, f = v[: len(field.xy_mm)], field.faces
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


def _raised(field: Heightfield, tin: list[Dome]) -> Heightfield:
    """Paste on domes: as high above them as above flat pads, so that volumes stay exact."""
    return replace(field, height_mm=field.height_mm + on_domes(field, tin)) if tin else field


def _kinds(field: Heightfield) -> Ints:
    """(face,) of a field's shell: 0 grains, 1 flux, 2 neither."""
    walls = 2 * sum(len(rim) for rim in field.rims)
    if field.bed is None:
        return np.full(len(field.faces) + walls, 2)
    return np.concatenate([field.bed[field.faces].sum(axis=1) > 1, np.zeros(walls)]).astype(
        np.int64
    )


def _same(pad: int, field: Heightfield) -> Ints:
    return np.full(len(field.faces), pad, dtype=np.int64)


def _halves(bridge: PasteBridge, field: Heightfield) -> Ints:
    """A bridge's triangles, each of the pad whose end is nearer."""
    centre = field.xy_mm[field.faces].mean(axis=1)
    a, b = bridge.ends_mm
    nearer = np.linalg.norm(centre - a, axis=1) <= np.linalg.norm(centre - b, axis=1)
    return np.where(nearer, *bridge.pads).astype(np.int64)
