"""Panels as CAD tools write them: boards stepped and repeated, rails, routed slots, tooling holes and fiducials."""

from pathlib import Path

import numpy as np
import pytest

from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import artwork, printed
from scenes.board.surface import surfaces
from scenes.labels.pad_truth import truth_of
from tests.scenes.board.test_gerber import mm, write
from tests.scenes.board.test_holes import DISK, seen

# Two by two boards of 8 x 6 mm, 2 mm apart, in a panel of 22 x 24 mm with rails of 5 mm above and below.
REPEAT = "%SRX2Y2I10J8*%\n"
PANEL = (22.0, 24.0)


def panel(folder: Path) -> GerberBoard:
    pads = f"{REPEAT}%ADD10R,1.0X0.6*%\nD10*\n{mm(-8, -6)}D03*\n{mm(-5, -4)}D03*\n%SR*%\n"
    marks = f"%TA.AperFunction,FiducialPad,Global*%\n%ADD20C,{{:.1f}}*%\nD20*\n{mm(-9, 10)}D03*\n{mm(9, -10)}D03*\n"
    x, y = PANEL[0] / 2, PANEL[1] / 2
    lines = "".join(f"{mm(*c)}D01*\n" for c in ((x, -y), (x, y), (-x, y), (-x, -y)))
    # Between boards and rails 2 mm wide paths, 8 mm long, leave bridges; tooling holes are bare.
    slots = "".join(
        f"G00X{x:.1f}Y{y:.1f}\nM15\nG01X{x + 6.0:.1f}\nM16\n"
        for x in (-8.0, 2.0)
        for y in (-8.0, 8.0)
    )
    drill = f"M48\nMETRIC\nT1C2.0\nT2C3.0\n%\nT1\n{slots}G05\nT2\nX0.0Y10.5\nX0.0Y-10.5\nM30\n"
    (folder / "p.drl").write_text(drill)
    files = {
        "paste": write(folder, "p.gbr", pads),
        "copper": write(folder, "c.gbr", pads + marks.format(1.0)),
        "mask": write(folder, "m.gbr", pads.replace("1.0X0.6", "1.1X0.7") + marks.format(2.0)),
        "outline": write(folder, "o.gbr", f"%ADD10C,0.1*%\nG01*\nD10*\n{mm(-x, -y)}D02*\n{lines}"),
        "drill": [folder / "p.drl"],
    }
    return GerberBoard.model_validate({"files": files, "fiducials": {}, "holes": {}})


def test_a_panel_has_all_boards_rails_and_what_is_routed(tmp_path: Path) -> None:
    of = panel(tmp_path)
    layout = artwork(of)
    places = sorted((round(p.centre_mm[0], 6), round(p.centre_mm[1], 6)) for p in layout.pads)
    steps = [(i, j) for i in (0, 10) for j in (0, 8)]
    assert places == sorted((x + i, y + j) for x, y in ((-8, -6), (-5, -4)) for i, j in steps)
    assert layout.board.area == pytest.approx(PANEL[0] * PANEL[1], rel=1e-9)
    parts = surfaces(layout, of.stackup())
    routed = 4 * (6.0 * 2.0 + DISK * 2.0**2) + 2 * DISK * 3.0**2
    assert seen(parts["hole"]) == pytest.approx({-1.6: routed}, rel=1e-4)
    assert "plated wall" not in parts
    assert seen(parts["fiducial"]) == pytest.approx({0.04: 2 * DISK}, rel=1e-4)
    truth = truth_of(printed(of))
    assert len(truth.pads) == 8 and len(truth.holes) == 6
    assert np.allclose([(f.x_mm, f.y_mm) for f in truth.fiducials], [(-9, 10), (9, -10)])
