"""Panels made of a board: place and number of every copy's pads, areas of gaps and rails, and prints of their own."""

import csv
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.affinity
from pydantic import ValidationError

import render
import scenes
from evaluation.inspection.spi_csv import write_spi_csv
from scenes.board.board import ParametricBoard
from scenes.board.extras.board_panel import BoardPanel
from scenes.board.paste import Paste
from scenes.board.printing import artwork, printed
from scenes.board.surface import surfaces
from scenes.board.transfer import Transfer
from scenes.labels.pad_truth import BoardTruth, PadTruth, truth_of
from scenes.support.errors import SceneError
from tests.scenes.board.test_fiducials import gerber_board
from tests.scenes.board.test_holes import DISK, seen

# Three by two boards of 10 x 8 mm, 2 mm apart and 2 mm from the rails: 34 x 32 mm.
SIZE = (10.0, 8.0)
PANEL = {"rows": 2, "columns": 3, "rail_mm": 5.0, "fiducial_mm": 1.0}
# Everything of a deposit differs from one to the next.
SCATTERED = {
    "offset_x_mm": {"kind": "normal", "mean": 0.0, "sd": 0.02},
    "slump_mm": {"kind": "uniform", "low": 0.0, "high": 0.02},
    "scoop": {"kind": "uniform", "low": 0.0, "high": 0.3},
}


def board(panel: dict[str, Any] | None, **settings: Any) -> ParametricBoard:
    parts = [{"package": "chip", "name": "R1", "size": "0603", "position_mm": [1.0, -2.0]}]
    tree = {"size_mm": SIZE, "parts": parts, "panel": panel, **settings}
    return ParametricBoard.model_validate(tree)


def of_board(truth: BoardTruth, number: int) -> list[PadTruth]:
    return [pad for pad in truth.pads if pad.board == number]


def test_each_copy_has_the_boards_pads_at_its_pitch_with_ids_of_their_own() -> None:
    alone, layout = artwork(board(None)), artwork(board(PANEL))
    assert [pad.id for pad in layout.pads] == list(range(1, 13))
    for pad in layout.pads:
        first = alone.pads[(pad.id - 1) % 2]
        row, column = divmod(pad.board - 1, 3)
        assert pad.board == 1 + (pad.id - 1) // 2
        assert (pad.number, pad.name) == (first.id, first.name)
        there = np.add(first.centre_mm, (12.0 * column, 10.0 * row))
        assert pad.centre_mm == pytest.approx(there, abs=1e-12)
    # The first board stays where it is alone: rails reach 7 mm below it.
    assert layout.box == pytest.approx((-5.0, -11.0, 29.0, 21.0))


def test_gaps_are_cut_through_and_tabs_rails_and_boards_are_not() -> None:
    of = board(PANEL)
    parts = surfaces(artwork(of), of.stackup())
    # Tabs of 2 x 2 mm: 2 gaps in each of 2 rows, 3 gaps (2 of them beside rails) in each of 3 columns.
    tabs = (2 * 2 + 3 * 3) * 2.0 * 2.0
    gaps = 34.0 * 32.0 - 6 * SIZE[0] * SIZE[1] - 2 * 34.0 * 5.0 - tabs
    # Depth of the support, as under holes.
    assert seen(parts["hole"]) == pytest.approx({-1.6: gaps + 4 * DISK * 3.0**2}, rel=1e-4)
    assert seen(parts["fiducial"]) == pytest.approx({0.04: 3 * DISK}, rel=1e-4)
    assert "plated wall" not in parts
    copper = sum(seen(parts["pad"]).values())
    assert copper == pytest.approx(12 * 0.8 * 0.95, rel=1e-6)
    # Seen from above nothing is missing and nothing is twice.
    total = sum(sum(seen(part).values()) for part in parts.values())
    assert total == pytest.approx(34.0 * 32.0, rel=1e-6)
    assert {"hole", "fiducial"} <= set(of.labels) and "hole" not in board(None).labels


@pytest.mark.parametrize(
    ("settings", "gaps"),
    [
        ({"gap_mm": 0.0}, 0.0),
        ({"tab_mm": 0.0}, 34.0 * 32.0 - 480.0 - 340.0),
        # Wider than gap_mm along x: 2 gaps of 3 mm become 16 mm high, less the rows' tabs; rails stay 2 mm off.
        ({"pitch_mm": [13.0, 8.0]}, 2 * 3.0 * (16.0 - 2 * 2.0) + 2 * 2.0 * (36.0 - 3 * 2.0)),
    ],
)
def test_gaps_are_as_wide_as_asked(settings: dict[str, Any], gaps: float) -> None:
    of = board(PANEL | {"tooling_mm": 0.0} | settings)
    holes = surfaces(artwork(of), of.stackup()).get("hole")
    assert (sum(seen(holes).values()) if holes else 0.0) == pytest.approx(gaps, rel=1e-6)


# Both corners of a square frame have a hole or fiducial in common, so that of "x" and of "xy" there are as many.
@pytest.mark.parametrize(
    ("rails", "size", "away"), [("y", (48.0, 18.0), (2.5, 7.5)), ("xy", (48.0, 32.0), (7.5, 2.5))]
)
def test_rails_are_on_the_sides_asked_for(
    rails: str, size: tuple[float, float], away: tuple[float, float]
) -> None:
    of = board(PANEL | {"rails": rails, "tab_mm": 0.0})
    layout = artwork(of)
    x0, y0, x1, y1 = layout.box
    assert (x1 - x0, y1 - y0) == pytest.approx(size)
    parts = surfaces(layout, of.stackup())
    solid = 6 * SIZE[0] * SIZE[1] + 2 * 5.0 * (18.0 if rails == "y" else 48.0 + 22.0)
    gaps = size[0] * size[1] - solid
    assert seen(parts["hole"]) == pytest.approx({-1.6: gaps + 4 * DISK * 3.0**2}, rel=1e-4)
    marks = [(m.centroid.x - x0, m.centroid.y - y0) for m in layout.fiducials]
    dx, dy = away
    there = [(dx, dy), (size[0] - dx, dy), (dx, size[1] - dy)]
    assert np.allclose(marks, there)


def turned(turn_deg: int, xy: tuple[float, float]) -> complex:
    return complex(*xy) * 1j ** (turn_deg // 90)


@pytest.mark.parametrize("turn_deg", [90, 180, 270])
def test_turned_copies_are_the_board_turned(tmp_path: Path, turn_deg: int) -> None:
    """Pads, copper, mask, fiducials and what is printed, about the board's own middle."""
    alone = gerber_board(tmp_path, "%TA.AperFunction,FiducialPad,Local*%\n")
    alone = alone.model_copy(update={"region": None, "paste": Paste(transfer=Transfer(spread=0.0))})
    tree = alone.model_dump() | {"panel": {"columns": 2, "turns_deg": (0, turn_deg)}}
    of = type(alone).model_validate(tree)
    one, both = artwork(alone), artwork(of)
    # 12 x 8 mm about the origin, and where a quarter turn makes them 8 x 12 mm still 14 mm apart.
    upright = turn_deg == 180
    assert both.box == pytest.approx((-6, -4, 20, 4) if upright else (-6, -6, 18, 6))
    assert both.board.area == pytest.approx((26.0 * 8.0) if upright else (24.0 * 12.0))

    def places(points: Iterable[tuple[float, float]]) -> list[complex]:
        return [turned(turn_deg, p) + 14.0 for p in points]

    second = [pad for pad in both.pads if pad.board == 2]
    centres = [complex(*pad.centre_mm) for pad in second]
    assert np.allclose(centres, places(pad.centre_mm for pad in one.pads))
    for pad, first in zip(second, one.pads, strict=True):
        spun = shapely.affinity.rotate(first.outline, turn_deg, origin=(0, 0))
        assert pad.outline.symmetric_difference(
            shapely.affinity.translate(spun, 14.0)
        ).area == pytest.approx(0.0, abs=1e-9)
    marks = [[m.centroid.coords[0] for m in layout.fiducials] for layout in (one, both)]
    assert len(marks[0]) > 0
    assert np.allclose([complex(*m) for m in marks[1][len(marks[0]) :]], places(marks[0]))
    for layer in ("copper", "openings"):
        a, b = getattr(one, layer), getattr(both, layer)
        assert b.area == pytest.approx(2 * a.area)
        spun = shapely.affinity.translate(shapely.affinity.rotate(a, turn_deg, origin=(0, 0)), 14.0)
        assert (spun - b).area == pytest.approx(0.0, abs=1e-9)
    truth = truth_of(printed(of))
    printed_on = of_board(truth, 1), of_board(truth, 2)
    for a_, b_ in zip(*printed_on, strict=True):
        assert b_.volume_mm3 == pytest.approx(a_.volume_mm3, rel=1e-9)
        assert b_.size_mm == pytest.approx(a_.size_mm if upright else a_.size_mm[::-1])


def test_copies_turned_differently_stand_at_the_pitch_wherever_the_board_is() -> None:
    box = (3.0, 20.0, 13.0, 28.0)
    panel = BoardPanel(rows=2, columns=2, turns_deg=(0, 180), pitch_mm=(12.0, 10.0))
    frames = [place(shapely.box(*box)).bounds for place in panel.places(box)]
    steps = [(0, 0), (12, 0), (0, 10), (12, 10)]
    assert frames == [(3 + x, 20 + y, 13 + x, 28 + y) for x, y in steps]
    (corner,) = (place(shapely.Point(3.0, 20.0)) for place in panel.places(box)[1:2])
    assert (corner.x, corner.y) == (25.0, 28.0)


def test_a_copy_is_a_print_of_its_own_and_the_first_is_as_without_a_panel() -> None:
    settings = {"paste": SCATTERED, "region": {"centre_mm": [0.0, 0.0], "size_mm": SIZE}}
    assert (
        truth_of(printed(board(PANEL, **settings))).pads
        == truth_of(printed(board(None, **settings))).pads
    )
    truth = truth_of(printed(board(PANEL, paste=SCATTERED)))
    for figure in ("volume_mm3", "offset_x_mm", "area_mm2", "peak_height_mm"):
        assert len({round(getattr(pad, figure), 9) for pad in truth.pads}) == 12


def test_all_boards_get_the_same_paste_where_nothing_scatters() -> None:
    truth = truth_of(printed(board(PANEL, paste={"transfer": {"spread": 0.0}})))
    volumes = [sum(p.volume_mm3 for p in of_board(truth, k)) for k in range(1, 7)]
    assert volumes == pytest.approx([volumes[0]] * 6, rel=1e-9) and volumes[0] > 0.0


def test_a_region_over_two_boards_has_the_near_pads_of_both() -> None:
    # From 1 to 13: pads of 0.8 mm are at 0.175 (outside), 1.825, 12.175 and 13.825 (outside).
    region = {"centre_mm": [7.0, -2.0], "size_mm": [12.0, 4.0]}
    layout = artwork(board(PANEL, region=region))
    assert [(pad.id, pad.board, pad.number) for pad in layout.pads] == [(2, 1, 2), (3, 2, 1)]
    assert [pad.id for pad in artwork(board(PANEL, pads=[2, 3])).pads] == [2, 3]
    with pytest.raises(SceneError, match="pad 13 does not exist; the board has 1 to 12"):
        artwork(board(PANEL, pads=[13]))


@pytest.mark.parametrize("side", ["top", "bottom"])
def test_boards_from_files_are_copied_with_their_own_fiducials(tmp_path: Path, side: str) -> None:
    named = "%TA.AperFunction,FiducialPad,Local*%\n"
    alone = gerber_board(tmp_path, named).model_copy(update={"region": None, "side": side})
    tree = alone.model_dump() | {"panel": {"columns": 2, "gap_mm": 1.5}}
    panel = artwork(type(alone).model_validate(tree))
    one = artwork(alone)
    # 12 x 8 mm each.
    assert panel.board.area == pytest.approx(25.5 * 8.0)
    assert [hole.outline.area for hole in panel.holes] == pytest.approx([1.5 * 3.0] * 2)
    places = [pad.centre_mm for pad in one.pads]
    assert [p.centre_mm for p in panel.pads] == [*places, *((x + 13.5, y) for x, y in places)]
    marks = [(mark.centroid.x, mark.centroid.y) for mark in one.fiducials]
    assert np.allclose(
        [(mark.centroid.x, mark.centroid.y) for mark in panel.fiducials],
        [*marks, *((x + 13.5, y) for x, y in marks)],
    )
    assert panel.copper.area == pytest.approx(2 * one.copper.area)
    assert panel.openings.area == pytest.approx(2 * one.openings.area)


def test_pixels_and_tables_name_the_board(tmp_path: Path) -> None:
    overrides = {
        "camera.resolution": [320, 240],
        "camera.field_width_mm": 34.0,
        "board": board(PANEL).model_dump(mode="json"),
    }
    scene = scenes.load("spi", overrides)
    truth = scenes.board_truth(scene)
    maps = render.truth(scene)
    assert maps.pad is not None
    assert set(np.unique(maps.pad[maps.region("paste")])) == set(range(1, 13))
    # The panel's middle, which is the world's, is (12, 5) on the first board: between two boards, on a tab, on a rail.
    for place, label in (((6.0, 3.0), "hole"), ((6.0, 0.0), "mask"), ((3.0, -7.5), "mask")):
        away = np.linalg.norm(maps.xyz_mm[..., :2] - np.subtract(place, (12.0, 5.0)), axis=-1)
        assert maps.region(label).flat[np.nanargmin(away)]
    write_spi_csv(truth.pads, truth, tmp_path / "truth.csv", panel="A")
    with (tmp_path / "truth.csv").open(newline="") as file:
        found = [
            (r["PanelID"], r["Board"], r["PadID"], r["NumberOnBoard"], r["PinNumber"])
            for r in csv.DictReader(file)
        ]
    assert found == [
        ("A", str(k + 1), str(2 * k + i), str(i), str(i)) for k in range(6) for i in (1, 2)
    ]
    truth.write(tmp_path / "board.json")
    assert BoardTruth.read(tmp_path / "board.json") == truth


def test_drawn_regions_are_anywhere_on_the_panel_and_whole() -> None:
    of = board(PANEL, region={"size_mm": [6.0, 5.0]})
    layouts = [artwork(of.model_copy(update={"seed": seed})) for seed in range(40)]
    for layout in layouts:
        assert layout.board.area == pytest.approx(30.0)
        total = sum(sum(seen(part).values()) for part in surfaces(layout, of.stackup()).values())
        assert total == pytest.approx(30.0, rel=1e-6)
    # Each board is as likely as the others: one of six is in none of 40 with 6 (5/6)^40 = 0.4 %; the seeds are fixed.
    assert {pad.board for layout in layouts for pad in layout.pads} == set(range(1, 7))


@pytest.mark.parametrize("panel", [None, PANEL])
def test_a_region_beside_the_board_is_refused(panel: dict[str, Any] | None) -> None:
    region = {"centre_mm": [60.0, 0.0], "size_mm": [5.0, 5.0]}
    with pytest.raises(SceneError, match="is outside the board, which spans"):
        artwork(board(panel, region=region))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(SceneError, match=r"10.000 x 8.000 mm overlap; make it larger"):
        artwork(board(PANEL | {"pitch_mm": [9.0, 10.0]}))
    for wrong, message in (
        ({"tooling_mm": 5.5}, "rail_mm 5.0 is too narrow for tooling_mm 5.5"),
        ({"rail_mm": 0.0}, "fiducial_mm 1.0 in an opening of twice that"),
        ({"gap": 1.0}, "gap"),
    ):
        with pytest.raises(ValidationError, match=message):
            board(PANEL | wrong)
