"""Holes in a board's surface: areas, depths and places against closed forms, and what is tented."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import render
import scenes
from scenes.board.board import Board, ParametricBoard
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import artwork, printed
from scenes.board.surface import BoardSurface, surfaces
from scenes.labels.pad_truth import truth_of
from scenes.scene_identity import identity
from scenes.support.errors import FileError, SceneError
from tests.scenes.board.test_gerber import mm, write

VIA = {"position_mm": [0.5, 0.2], "diameter_mm": 0.3, "ring_mm": 0.6}
DISK = np.pi / 4


def board(holes: list[dict[str, Any]], **settings: Any) -> Board:
    """A 10 x 8 mm board with one chip well away from the holes."""
    part = {"package": "chip", "size": "0603", "position_mm": [-3.0, -2.0]}
    tree = {"size_mm": [10.0, 8.0], "parts": [part], "holes": {"drilled": holes} | settings}
    return ParametricBoard.model_validate(tree)


def built(of: Board) -> dict[str, BoardSurface]:
    return surfaces(artwork(of), of.stackup())


def seen(surface: BoardSurface) -> dict[float, float]:
    """Height -> area seen from above, mm2; walls have none."""
    corners = surface.vertices[surface.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    level = np.ptp(corners[..., 2], axis=1) < 1e-12
    heights = corners[level, 0, 2].round(6)
    return {float(z): float(area[level][heights == z].sum()) for z in np.unique(heights)}


def whole(parts: dict[str, BoardSurface]) -> trimesh.Trimesh:
    count, vertices, faces = 0, [], []
    for part in parts.values():
        vertices.append(part.vertices)
        faces.append(part.faces + count)
        count += len(part.vertices)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    mesh.merge_vertices(digits_vertex=7)
    return mesh


def test_an_open_via_is_a_ring_of_copper_around_a_plated_hole() -> None:
    parts = built(board([VIA], depth_mm=1.0))
    assert seen(parts["hole"]) == pytest.approx({-1.0: DISK * 0.3**2}, rel=1e-4)
    chip = 2 * 0.8 * 0.95
    assert seen(parts["pad"]) == pytest.approx({0.04: chip + DISK * (0.6**2 - 0.3**2)}, rel=1e-4)
    # Wall: the circumference of a circle within 0.1 % of it, from the floor to the copper's surface.
    wall = parts["plated wall"]
    side = trimesh.Trimesh(wall.vertices, wall.faces, process=False).area
    assert side == pytest.approx(np.pi * 0.3 * (1.0 + 0.04), rel=1e-3)
    assert "bare wall" not in parts


def test_holes_leave_neither_gap_nor_overlap() -> None:
    holes = [
        VIA,
        VIA | {"position_mm": [2.0, 0.0], "tented": True},
        {"position_mm": [3.5, -1.0], "end_mm": [3.5, 1.0], "diameter_mm": 0.8},
        # In a pad of the chip, and cut by the board's edge.
        {"position_mm": [-3.825, -2.0], "diameter_mm": 0.2, "ring_mm": 0.3},
        {"position_mm": [5.0, 2.0], "diameter_mm": 1.0},
    ]
    mesh = whole(built(board(holes)))
    up = mesh.face_normals[:, 2] > 0.5
    assert mesh.area_faces[up].sum() == pytest.approx(80.0, rel=1e-9)
    edges = np.sort(mesh.edges, axis=1)
    kinds, counts = np.unique(edges, axis=0, return_counts=True)
    ends = np.abs(mesh.vertices[kinds[counts == 1]])
    assert ((np.abs(ends[..., 0] - 5.0) < 1e-6) | (np.abs(ends[..., 1] - 4.0) < 1e-6)).all()


def test_the_volume_of_holes_is_their_area_times_depth() -> None:
    def below(of: Board) -> float:
        """Volume under the surface, down to z = -1 mm."""
        return sum(
            (z + 1.0) * area for part in built(of).values() for z, area in seen(part).items()
        )

    slot = {"position_mm": [3.5, -1.0], "end_mm": [3.5, 1.0], "diameter_mm": 0.8}
    drilled, plain = board([slot], depth_mm=1.0), board([], depth_mm=1.0)
    # The mask, 0.025 mm, is open 0.05 mm around the slot.
    area, opened = 2.0 * 0.8 + DISK * 0.8**2, 2.0 * 0.9 + DISK * 0.9**2
    assert below(plain) - below(drilled) == pytest.approx(area * 1.0 + opened * 0.025, rel=1e-3)


def test_a_tented_via_is_a_dip_in_the_mask() -> None:
    parts = built(board([VIA | {"tented": True}], dip_mm=0.015))
    assert "hole" not in parts
    mask = seen(parts["mask"])
    # Over the copper ring 0.035 mm higher, over the hole 0.015 mm lower than that.
    assert mask[0.06] == pytest.approx(DISK * (0.6**2 - 0.3**2), rel=1e-4)
    assert mask[0.045] == pytest.approx(DISK * 0.3**2, rel=1e-4)


def test_a_pad_keeps_its_number_around_a_via_in_its_middle() -> None:
    of = board([{"position_mm": [-3.825, -2.0], "diameter_mm": 0.2, "ring_mm": 0.3}])
    pad = built(of)["pad"]
    corners = pad.vertices[pad.faces]
    level = np.ptp(corners[..., 2], axis=1) < 1e-12
    left = level & (corners[..., 0].mean(axis=1) < -3.0)
    assert set(pad.pad[left]) == {1}


def test_truth_lists_holes_and_labels_their_pixels() -> None:
    scene = scenes.load(
        "spi",
        {
            "camera.resolution": [200, 150],
            "camera.field_width_mm": 6.0,
            "board.holes": {"drilled": [VIA, VIA | {"position_mm": [1.6, 0.4], "tented": True}]},
        },
    )
    assert scene.board is not None
    truth = truth_of(printed(scene.board))
    assert [(h.plated, h.tented) for h in truth.holes] == [(True, False), (True, True)]
    via = truth.holes[0]
    assert (via.x_mm, via.y_mm) == pytest.approx((0.5, 0.2), abs=1e-9)
    assert via.area_mm2 == pytest.approx(DISK * 0.3**2, rel=1e-9)
    maps = render.truth(scene)
    inside = maps.region("hole")
    pixel = 6.0 / 200
    # A pixel is inside if its centre is: wrong by less than the circumference times half a diagonal.
    assert inside.sum() * pixel**2 == pytest.approx(via.area_mm2, abs=np.pi * 0.3 * pixel * 0.71)
    place = maps.xyz_mm[inside].mean(axis=0)
    assert place == pytest.approx([0.5, 0.2, -1.6], abs=pixel / 2)
    assert "hole" not in scenes.load("spi").labels


def test_a_gerber_boards_holes_come_from_its_drill_files(tmp_path: Path) -> None:
    pads = f"%ADD10R,1X0.6*%\nD10*\n{mm(-2, 1)}D03*\n{mm(2, 1)}D03*\n"
    rings = f"%ADD11C,0.6*%\nD11*\n{mm(0, 0)}D03*\n{mm(1, 0)}D03*\n"
    paste, copper = write(tmp_path, "p.gbr", pads), write(tmp_path, "c.gbr", pads + rings)
    mask = write(tmp_path, "m.gbr", pads + f"%ADD11C,0.7*%\nD11*\n{mm(1, 0)}D03*\n")
    program = "M48\nMETRIC\nT1C0.3\nT2C1.0\n%\nT1\nX0.0Y0.0\nX1.0Y0.0\nT2\nX0.0Y2.0\nM30\n"
    (tmp_path / "b.drl").write_text(program)
    files = {"paste": paste.name, "mask": mask.name, "copper": copper.name}
    of = GerberBoard.model_validate({"folder": tmp_path, "files": files, "holes": {}})
    # In copper: plated, tented where the mask is closed. In the laminate: bare, and never tented.
    found = {
        (round(h.outline.centroid.x, 6), round(h.outline.centroid.y, 6)): (h.plated, h.tented)
        for h in artwork(of).holes
    }
    assert found == {(0, 0): (True, True), (1, 0): (True, False), (0, 2): (False, False)}
    named = files | {"drill": ["b.drl"]}
    by_name = GerberBoard.model_validate({"folder": tmp_path, "files": named, "holes": {}})
    assert by_name.drill_paths() == (tmp_path / "b.drl",)
    # Other contents, other artwork and another identity.
    scene = scenes.load("spi", {"board": of.model_dump(mode="json", exclude_none=True)})
    before = identity(scene)["board"]
    (tmp_path / "b.drl").write_text(program.replace("X0.0Y2.0", "X0.0Y2.5"))
    assert identity(scene)["board"] != before
    assert {round(h.outline.centroid.y, 6) for h in artwork(of).holes} == {0, 2.5}
    (tmp_path / "b.drl").unlink()
    with pytest.raises(FileError, match="no drill file: name it under"):
        artwork(of)
    assert artwork(of.model_copy(update={"holes": None})).holes == ()


def test_a_path_around_something_frees_it_and_a_path_around_the_board_does_not(
    tmp_path: Path,
) -> None:
    paste = write(tmp_path, "p.gbr", f"%ADD10R,1X0.6*%\nD10*\n{mm(0, 3)}D03*\n")
    lines = "".join(f"{mm(x, y)}D01*\n" for x, y in ((5, -5), (5, 5), (-5, 5), (-5, -5)))
    outline = write(tmp_path, "o.gbr", f"%ADD10C,0.1*%\nG01*\nD10*\n{mm(-5, -5)}D02*\n{lines}")

    def square(half: float) -> str:
        corners = [(half, -half), (half, half), (-half, half), (-half, -half)]
        moves = "".join(f"G01X{x:.1f}Y{y:.1f}\n" for x, y in corners)
        return f"G00X{-half:.1f}Y{-half:.1f}\nM15\n{moves}M16\n"

    program = f"M48\nMETRIC\nT1C0.8\n%\nT1\n{square(1.0)}{square(5.4)}M30\n"
    drill = tmp_path / "b.drl"
    drill.write_text(program)
    files = {"paste": paste, "outline": outline, "drill": [drill]}
    of = GerberBoard.model_validate({"files": files, "holes": {}})
    parts = built(of)
    # 2.8 mm wide, with round corners; the cutter around the board only meets its edge.
    expected = 2.8**2 - (4 - np.pi) * 0.4**2
    assert seen(parts["hole"])[-1.6] == pytest.approx(expected, rel=1e-3)


def test_a_ring_smaller_than_its_hole_is_refused() -> None:
    with pytest.raises(SceneError, match=r"ring_mm 0.3 is not larger than diameter_mm 0.4"):
        scenes.load(
            "spi",
            {
                "board.holes": {
                    "drilled": [{"position_mm": [0, 0], "diameter_mm": 0.4, "ring_mm": 0.3}]
                }
            },
        )
