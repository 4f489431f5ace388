"""Faults of the bare board: what they bare or cover against closed forms, and what labels say of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

import render
import scenes
from scenes.board.board import ParametricBoard
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import artwork, printed
from scenes.board.surface import BoardSurface, surfaces
from scenes.labels.coco_format import CATEGORIES, pixels_inside
from scenes.labels.pad_truth import truth_of
from tests.scenes.board.test_gerber import mm, write
from tests.scenes.board.test_holes import seen

# 0.8 mm long, 0.95 mm across, 1.65 mm apart.
PART = {"package": "chip", "size": "0603", "position_mm": [0.0, 0.0]}
# Beyond the other pad, and on the board.
FAR = {"kind": "uniform", "low": 6.0, "high": 6.9}
SCRATCH = {"probability": 1.0, "length_mm": 0.7, "width_mm": 0.1, "distance": FAR}
RESIDUE = {"probability": 1.0, "radius_mm": 0.3, "height_mm": 0.01, "distance": FAR}


def board(**settings: Any) -> ParametricBoard:
    tree = {"size_mm": [10.0, 8.0], "parts": [PART], "seed": 3, **settings}
    return ParametricBoard.model_validate(tree)


def built(of: ParametricBoard | GerberBoard) -> dict[str, BoardSurface]:
    return surfaces(printed(of).layout, of.stackup())


def test_a_scratch_bares_laminate_over_its_length_and_width() -> None:
    of = board(defects={"scratch": SCRATCH})
    after, before = built(of), built(board())
    # One for each pad; the ends are half disks.
    area = 2 * (0.7 * 0.1 + np.pi / 4 * 0.1**2)
    assert seen(after["scratched laminate"]) == pytest.approx({0.0: area}, rel=1e-3)
    assert seen(before["mask"])[0.025] - seen(after["mask"])[0.025] == pytest.approx(area, rel=1e-3)
    assert seen(after["pad"]) == pytest.approx(seen(before["pad"]), rel=1e-9)
    truth = truth_of(printed(of))
    assert [(d.name, d.pad) for d in truth.damage] == [("scratch", 1), ("scratch", 2)]
    assert sum(d.area_mm2 for d in truth.damage) == pytest.approx(area, rel=1e-3)
    for mark, pad in zip(truth.damage, truth.pads, strict=True):
        # Half the pad's longer side is 0.475 mm.
        away = np.hypot(mark.x_mm - pad.x_mm, mark.y_mm - pad.y_mm)
        assert 6.0 * 0.475 - 1e-6 <= away <= 6.9 * 0.475 + 1e-6
    assert "scratch" in of.labels and "scratch" not in board().labels


def test_a_scratch_over_copper_bares_copper_and_leaves_pads_whole(tmp_path: Path) -> None:
    pad = f"%ADD10R,1X0.6*%\nD10*\n{mm(0, 0)}D03*\n"
    plane = f"%ADD10R,12X12*%\nD10*\n{mm(0, 0)}D03*\n"
    files = {
        "paste": write(tmp_path, "p.gbr", pad),
        "mask": write(tmp_path, "m.gbr", pad),
        "copper": write(tmp_path, "c.gbr", plane),
    }
    # Through the middle of the pad, along it, and 0.5 mm beyond at either end.
    through = {"probability": 1.0, "length_mm": 1.9, "width_mm": 0.1, "direction_deg": 0.0, "distance": 0.0}  # fmt: skip
    parts = built(GerberBoard.model_validate({"files": files, "defects": {"scratch": through}}))
    area = 0.9 * 0.1 + np.pi / 4 * 0.1**2
    assert seen(parts["scratched copper"]) == pytest.approx({0.035: area}, rel=1e-3)
    assert seen(parts["pad"]) == pytest.approx({0.04: 0.6}, rel=1e-6)


def test_residue_is_a_film_of_its_radius_area_on_what_is_below() -> None:
    of = board(defects={"residue": RESIDUE})
    parts = built(of)
    area = 2 * np.pi * 0.3**2
    # On the mask, 0.025 mm.
    assert seen(parts["residue"]) == pytest.approx({0.035: area}, rel=1e-5)
    near = board(defects={"residue": RESIDUE | {"distance": 0.0}})
    parts = built(near)
    on_pads = seen(parts["residue"])
    # Over the pads' middles, 0.04 mm: as wide as the film, which is smaller than the pad but for its lobes.
    assert on_pads[0.05] == pytest.approx(sum(on_pads.values()), rel=0.1)
    assert sum(on_pads.values()) == pytest.approx(area, rel=1e-5)
    # What is left of a pad is still its pad's.
    assert set(parts["pad"].pad) == {1, 2}


def test_a_shifted_mask_covers_one_side_of_pads_and_bares_laminate_on_the_other() -> None:
    of = board(layers={"mask_shift_x_mm": 0.12}, mask_clearance_mm=0.05)
    parts = built(of)
    # The opening, 0.9 x 1.05 mm, begins 0.07 mm inside the pad and ends 0.17 mm beyond it.
    covered, copper = 0.07 * 0.95, 0.8 * 0.95
    assert seen(parts["pad"]) == pytest.approx({0.04: 2 * (copper - covered)}, rel=1e-6)
    assert seen(parts["base"]) == pytest.approx(
        {0.0: 2 * (0.9 * 1.05 - copper + covered)}, rel=1e-6
    )
    assert seen(parts["mask"])[0.06] == pytest.approx(2 * covered, rel=1e-6)
    truth = truth_of(printed(of))
    assert truth.mask_shift_mm == (0.12, 0.0)
    assert [(d.name, d.pad) for d in truth.damage] == [("mask-shift", 1), ("mask-shift", 2)]
    assert [d.area_mm2 for d in truth.damage] == pytest.approx([covered] * 2, rel=1e-6)
    # From the pad's middle to that of the covered strip.
    assert truth.damage[0].x_mm - truth.pads[0].x_mm == pytest.approx(-0.4 + 0.035, abs=1e-6)


def test_faults_of_the_board_change_neither_print_nor_artwork() -> None:
    faulty = board(
        defects={"scratch": SCRATCH, "residue": RESIDUE}, layers={"mask_shift_y_mm": 0.1}
    )
    assert truth_of(printed(faulty)).pads == truth_of(printed(board())).pads
    assert artwork(faulty) is artwork(board())
    # And a scratch stays where it is when residue is added.
    alone = truth_of(printed(board(defects={"scratch": SCRATCH}))).damage
    both = truth_of(printed(board(defects={"scratch": SCRATCH, "residue": RESIDUE}))).damage
    assert both[:2] == alone


@pytest.mark.parametrize("name", ["scratch", "residue"])
def test_masks_of_annotations_are_the_truths_pixels(name: str) -> None:
    overrides = {
        "camera.resolution": [400, 300],
        "camera.field_width_mm": 6.0,
        f"board.defects.{name}.probability": 0.2,
        "board.defects.scratch.width_mm": 0.15,
    }
    scene = scenes.load("spi", overrides)
    truth = render.truth(scene).region(name)
    camera = scene.camera.projection()
    marked = np.zeros_like(truth)
    for note in scenes.coco(scene, "0.png")["annotations"]:
        if CATEGORIES[note["category_id"] - 1] == name:
            assert note["pad"] > 0 and not note["iscrowd"]
            marked |= _mask(note["segmentation"], camera)
    assert truth.sum() > 500
    # Outlines are exact, so both choose the pixels whose centre is inside; the rest is rounding.
    assert (marked & truth).sum() / (marked | truth).sum() >= 0.98


def _mask(segmentation: Any, camera: Any) -> NDArray[np.bool_]:
    if isinstance(segmentation, dict):
        runs = np.array(segmentation["counts"])
        flat = np.repeat(np.arange(len(runs)) % 2 == 1, runs)
        return flat.reshape(segmentation["size"], order="F")
    rings = [shapely.Polygon(np.reshape(ring, (-1, 2))) for ring in segmentation]
    return pixels_inside(shapely.union_all(rings), camera)
