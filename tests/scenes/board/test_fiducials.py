"""Fiducials: bare copper of the size and at the place asked for, named in truth, and what prints are registered to."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

import render
import scenes
from scenes.board.board import ParametricBoard
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import artwork, printed
from scenes.board.surface import surfaces
from scenes.labels.pad_truth import truth_of
from scenes.support.errors import FileError, SceneError
from tests.scenes.board.test_gerber import mm, write
from tests.scenes.board.test_holes import DISK, seen

PLACES = [[-4.0, 3.0], [4.0, -3.0]]


def board(fiducials: dict[str, Any] | None, **settings: Any) -> ParametricBoard:
    part = {"package": "chip", "size": "0603", "position_mm": [0.0, 0.0]}
    tree = {"size_mm": [10.0, 8.0], "parts": [part], "fiducials": fiducials, **settings}
    return ParametricBoard.model_validate(tree)


def test_fiducials_are_disks_of_bare_copper_in_an_opening_of_the_mask() -> None:
    of = board({"positions_mm": PLACES, "diameter_mm": 1.0, "opening_mm": 1.6})
    plain, marked = board(None), of
    before, after = (surfaces(artwork(b), b.stackup()) for b in (plain, marked))
    assert seen(after["fiducial"]) == pytest.approx({0.04: 2 * DISK}, rel=1e-4)
    ring = 2 * DISK * (1.6**2 - 1.0**2)
    assert seen(after["base"])[0.0] - seen(before["base"])[0.0] == pytest.approx(ring, rel=1e-3)
    # Neither paste nor numbers of pads change.
    assert truth_of(printed(marked)).pads == truth_of(printed(plain)).pads
    assert "fiducial" in marked.labels and "fiducial" not in plain.labels


def test_truth_has_their_places_and_pixels() -> None:
    overrides = {
        "camera.resolution": [160, 120],
        "camera.field_width_mm": 8.0,
        "board.fiducials": {"positions_mm": [[0.6, 0.3], [20.0, 0.0]], "diameter_mm": 0.8},
    }
    scene = scenes.load("spi", overrides)
    assert scene.board is not None
    (mark,) = truth_of(printed(scene.board)).fiducials
    assert (mark.x_mm, mark.y_mm, mark.diameter_mm) == pytest.approx((0.6, 0.3, 0.8), rel=1e-6)
    maps = render.truth(scene)
    # Paste of the QFP beside it does not reach it.
    place = maps.xyz_mm[maps.region("fiducial")].mean(axis=0)[:2]
    assert place == pytest.approx([0.6, 0.3], abs=8.0 / 160 / 2)


def test_a_print_is_off_by_its_registration_error_relative_to_the_fiducials() -> None:
    error = {"shift_x_mm": 0.03, "shift_y_mm": -0.02, "transfer": {"spread": 0.0}}
    truth = truth_of(printed(board({"positions_mm": PLACES}, paste=error)))
    assert np.allclose([(f.x_mm, f.y_mm) for f in truth.fiducials], PLACES)
    for pad in truth.pads:
        assert (pad.offset_x_mm, pad.offset_y_mm) == pytest.approx((0.03, -0.02), abs=1e-6)


def gerber_board(folder: Path, attribute: str, **fiducials: Any) -> GerberBoard:
    pads = f"%ADD10R,1X0.6*%\nD10*\n{mm(0, 1)}D03*\n"
    rest = f"D10*\n{mm(0, 1)}D03*\nD12*\n{mm(-4, 3)}D03*\n{mm(4, -3)}D03*\nD13*\n{mm(4, 3)}D03*\n"
    copper = f"%ADD10R,1X0.6*%\n{attribute}%ADD12C,1.0*%\n%TD*%\n%ADD13C,1.0*%\n{rest}"
    opening = f"%ADD10R,1.1X0.7*%\n%ADD12C,2.0*%\n%ADD13C,2.0*%\n{rest}"
    corners = "".join(f"{mm(x, y)}D01*\n" for x, y in ((6, -4), (6, 4), (-6, 4), (-6, -4)))
    lines = f"%ADD10C,0.1*%\nG01*\nD10*\n{mm(-6, -4)}D02*\n{corners}"
    files = {
        "outline": write(folder, "o.gbr", lines),
        "paste": write(folder, "p.gbr", pads),
        "copper": write(folder, "c.gbr", copper),
        "mask": write(folder, "m.gbr", opening),
    }
    return GerberBoard.model_validate({"files": files, "fiducials": fiducials, **BOX})


BOX = {"region": {"centre_mm": [0.0, 0.0], "size_mm": [12.0, 9.0]}}


@pytest.mark.parametrize(
    "attribute",
    ["%TA.AperFunction,FiducialPad,Local*%\n", "G04 #@! TA.AperFunction,FiducialPad,Global*\n"],
)
@pytest.mark.parametrize("side", ["top", "bottom"])
def test_fiducials_of_gerber_boards_are_those_the_copper_layer_names(
    tmp_path: Path, attribute: str, side: str
) -> None:
    of = gerber_board(tmp_path, attribute).model_copy(update={"side": side})
    sign = -1.0 if side == "bottom" else 1.0
    found = artwork(of).fiducials
    places = [(f.centroid.x, f.centroid.y) for f in found]
    assert np.allclose(places, [(-4 * sign, 3), (4 * sign, -3)])
    assert [f.area for f in found] == pytest.approx([DISK] * 2, rel=1e-9)


def test_fiducials_of_gerber_boards_may_be_given_by_place(tmp_path: Path) -> None:
    found = artwork(gerber_board(tmp_path, "", positions_mm=[[3.8, 3.1]])).fiducials
    assert [(round(f.centroid.x, 6), round(f.centroid.y, 6)) for f in found] == [(4.0, 3.0)]


def test_what_names_no_fiducial_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        FileError, match="no aperture of the board's copper layer has the attribute"
    ):
        artwork(gerber_board(tmp_path, ""))
    with pytest.raises(SceneError, match=r"no bare copper at \[0.0, -2.0\] mm"):
        artwork(gerber_board(tmp_path, "", positions_mm=[[0.0, -2.0]]))
    with pytest.raises(SceneError, match="needs positions_mm"):
        artwork(board({}))
    with pytest.raises(SceneError, match=r"opening_mm 0.5 is smaller than diameter_mm 1.0"):
        scenes.load("spi", {"board.fiducials": {"positions_mm": PLACES, "opening_mm": 0.5}})


def test_a_fiducial_cut_by_the_region_is_not_listed() -> None:
    of = board({"positions_mm": PLACES}, region={"centre_mm": [0.0, 0.0], "size_mm": [8.0, 8.0]})
    layout = artwork(of)
    assert layout.fiducials == ()
    # Its copper is there all the same: half of each disk.
    chip = 2 * 0.8 * 0.95
    assert layout.copper.area == pytest.approx(chip + DISK, rel=1e-6)
    assert shapely.get_parts(layout.copper).size == 4
