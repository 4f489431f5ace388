"""Drill files: what they drill against closed forms, and against gerbonara where it is installed."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import shapely

from scenes.board.gerber import drill_files, read_drills
from scenes.board.gerber.excellon import DrillFormat
from scenes.board.gerber.second_reader import second_area
from scenes.support.errors import FileError

METRIC = "M48\nMETRIC\nT1C0.800\n%\nT1\n"
# Corners replace arcs with their area kept but for ends that are fixed: 0.1 %.
ROUND = 1e-3


def write(folder: Path, text: str, name: str = "b.drl") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def disk(x: float, y: float, diameter: float) -> tuple[float, float, float]:
    return x, y, np.pi / 4 * diameter**2


def slot(
    a: tuple[float, float], b: tuple[float, float], width: float
) -> tuple[float, float, float]:
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    return (a[0] + b[0]) / 2, (a[1] + b[1]) / 2, length * width + np.pi / 4 * width**2


# What is drilled: centroid and area of each hole, in order.
PROGRAMS: dict[str, tuple[str, list[tuple[float, float, float]]]] = {
    "decimals": (METRIC + "X1.5Y-2.25\nX3.0\nM30\n", [disk(1.5, -2.25, 0.8), disk(3, -2.25, 0.8)]),
    "inch, leading zeros left out": (
        "M48\nINCH,TZ\nT1C0.0400\n%\nT1\nX10000Y-5000\nY0\nM30\n",
        [disk(25.4, -12.7, 1.016), disk(25.4, 0, 1.016)],
    ),
    "inch, trailing zeros left out": (
        "M48\nINCH,LZ\nT1C0.0400\n%\nT1\nX01Y-005\nM30\n",
        [disk(25.4, -12.7, 1.016)],
    ),
    "digits in the unit's line": (
        "M48\nMETRIC,LZ,0000.00\nT1C1.0\n%\nT1\nX00125Y0001\nM30\n",
        [disk(12.5, 1, 1.0)],
    ),
    "digits in a comment": (
        "M48\n;FILE_FORMAT=4:4\nMETRIC,LZ\nT1F00S00C1.0\n%\nT1\nX000005Y00012\nM30\n",
        [disk(0.05, 1.2, 1.0)],
    ),
    "all digits, zeros not stated": (
        "M48\nINCH\nT01C0.0394\n%\nT01\nX+026814Y+011188\nT00\nM30\n",
        [disk(68.10756, 28.41752, 1.00076)],
    ),
    "unit in the body": (
        "%\nM48\nM71,TZ\nT2C0.5\n%\nM71\nG90\nT2\nX1000Y2000\nM30\n",
        [disk(1, 2, 0.5)],
    ),
    "incremental": (METRIC + "G91\nX1.0Y1.0\nX2.0\nM30\n", [disk(1, 1, 0.8), disk(3, 1, 0.8)]),
    "repeated": (METRIC + "X1.0Y1.0\nR3X2.0\nM30\n", [disk(1 + 2 * i, 1, 0.8) for i in range(4)]),
    "drilled slot": (
        METRIC + "X1.0Y1.0G85X4.0Y5.0\nX9.0Y1.0\nM30\n",
        [slot((1, 1), (4, 5), 0.8), disk(9, 1, 0.8)],
    ),
    "routed slot": (
        METRIC + "G00X1.0Y1.0\nM15\nG01X3.0\nM16\nG05\nX9.0Y1.0\nM30\n",
        [slot((1, 1), (3, 1), 0.8), disk(9, 1, 0.8)],
    ),
    "routed hole": (METRIC + "G00X1.0Y1.0\nM15\nM16\nM30\n", [disk(1, 1, 0.8)]),
    "two tools": (
        "M48\nMETRIC\nT1C0.3\nT2C1.1F10S20\n%\nT2\nX1.0Y0.0\nT1\nX0.0Y0.0\nM30\n",
        [disk(1, 0, 1.1), disk(0, 0, 0.3)],
    ),
    "sizes in comments": (
        ";T01 Holesize 1. = 20.0 Tolerance = +0.0/-0.0 PLATED MILS Quantity = 1\n%\nG90\nM72\nT01\nX010000Y000000\nM30\n",
        [disk(25.4, 0, 0.508)],
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_holes_are_where_and_as_large_as_the_program_says(tmp_path: Path, name: str) -> None:
    text, expected = PROGRAMS[name]
    holes = [hole.outline for hole in read_drills(write(tmp_path, text))]
    found = np.array([(h.centroid.x, h.centroid.y, h.area) for h in holes])
    np.testing.assert_allclose(found, expected, rtol=ROUND, atol=1e-6)


@pytest.mark.skipif(
    importlib.util.find_spec("gerbonara") is None, reason="the second reader is not installed"
)
# gerbonara leaves out a plunge of the routing tool, and takes incremental coordinates for absolute ones.
@pytest.mark.parametrize("name", [n for n in PROGRAMS if n not in ("routed hole", "incremental")])
def test_a_second_reader_drills_the_same(tmp_path: Path, name: str) -> None:
    path = write(tmp_path, PROGRAMS[name][0])
    try:
        second = second_area(path, drill=True)
    except FileError:
        pytest.skip("gerbonara does not read this program")
    own = shapely.union_all([hole.outline for hole in read_drills(path)])
    # Polygons of equal area with 64 and 256 corners are apart by 0.06 % of a disk.
    assert second.symmetric_difference(own).area < 1e-3 * own.area


@pytest.mark.parametrize(("turn", "sign"), [("G02", 1.0), ("G03", -1.0)])
def test_routed_arcs_go_round_their_centre(tmp_path: Path, turn: str, sign: float) -> None:
    # Half a turn from (0, 0) to (4, 0): clockwise over the top. Area: length along the middle times width, and the ends.
    area = 2 * np.pi * 0.8 + np.pi / 4 * 0.8**2
    for words in ("A2.0", "I2.0J0.0"):
        text = METRIC + f"G00X0.0Y0.0\nM15\n{turn}X4.0Y0.0{words}\nM16\nM30\n"
        (hole,) = read_drills(write(tmp_path, text))
        assert hole.outline.area == pytest.approx(area, rel=ROUND)
        assert hole.outline.contains(shapely.Point(2.0, 2.0 * sign))
        assert not hole.outline.contains(shapely.Point(2.0, -2.0 * sign))


@pytest.mark.parametrize("turn", ["G02", "G03"])
def test_an_arc_by_its_radius_is_the_one_by_its_centre(tmp_path: Path, turn: str) -> None:
    """A quarter turn about (3, 0) or (0, 3), of 4.24 mm between its ends."""
    start, middle = "G00X0.0Y0.0\nM15\n", {"G02": "I3.0J0.0", "G03": "I0.0J3.0"}[turn]
    by_radius, by_centre = (
        read_drills(write(tmp_path, f"{METRIC}{start}{turn}X3.0Y3.0{words}\nM16\nM30\n"))[0].outline
        for words in ("A3.0", middle)
    )
    assert by_radius.area == pytest.approx(np.pi / 2 * 3.0 * 0.8 + np.pi / 4 * 0.8**2, rel=ROUND)
    assert by_radius.symmetric_difference(by_centre).area < 1e-6


def test_a_whole_circle_is_routed_by_its_centre_alone(tmp_path: Path) -> None:
    (ring,) = read_drills(write(tmp_path, METRIC + "G00X0.0Y0.0\nM15\nG03I2.0J0.0\nM16\nM30\n"))
    assert ring.outline.area == pytest.approx(2 * np.pi * 2.0 * 0.8, rel=ROUND)
    # Corners of an arc are within 2 um of it.
    assert ring.outline.centroid.coords[0] == pytest.approx((2.0, 0.0), abs=2e-3)


@pytest.mark.parametrize(
    ("text", "plated"),
    [
        ("; #@! TF.FileFunction,Plated,1,2,PTH\n", True),
        ("; #@! TF.FileFunction,NonPlated,1,2,NPTH\n", False),
        ("; #@! TF.FileFunction,MixedPlating,1,2\n; #@! TA.AperFunction,NonPlated,NPTH,ComponentDrill\n", False),
        (";TYPE=PLATED\n", True),
        (";TYPE=NON_PLATED\n", False),
        ("", None),
    ],
)  # fmt: skip
def test_plating_is_what_the_file_states(tmp_path: Path, text: str, plated: bool | None) -> None:
    program = f"M48\n{text}METRIC\nT1C0.8\n%\nT1\nX1.0Y1.0\nM30\n"
    assert read_drills(write(tmp_path, program))[0].plated is plated
    # A file's name says it where its text does not.
    if plated is None:
        assert read_drills(write(tmp_path, program, "b-NPTH.drl"))[0].plated is False
        assert read_drills(write(tmp_path, program, "b-PTH.drl"))[0].plated is True


def test_plating_stated_before_a_tools_holes_is_that_tools(tmp_path: Path) -> None:
    text = "M48\nMETRIC\nT1C0.5\nT2C0.6\n%\n;TYPE=PLATED\nT1\nX1.0Y1.0\n;TYPE=NON_PLATED\nT2\nX2.0Y1.0\nM30\n"
    assert [hole.plated for hole in read_drills(write(tmp_path, text))] == [True, False]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (METRIC + "X1.0Y1.0\n", "does not end with M30"),
        (METRIC + "X1.0Y1.0\nG82X2.0Y2.0\nM30\n", "'G82' is not a supported"),
        (METRIC + "X1.0Y1.0\nM02X5.0\nM30\n", "'M02' is not a supported"),
        (METRIC + "X1.0Y1.0\nCOPY2\nM30\n", "'COPY2' is not a known command"),
        ("M48\nMETRIC\nFMAT,1\nM30\n", "'FMAT,1' is not a known command"),
        ("M48\nMETRIC\n%\nX1.0Y1.0\nM30\n", "before its tool is selected"),
        ("M48\nMETRIC\n%\nT7\nX1.0Y1.0\nM30\n", "T7 is not defined"),
        ("M48\nT1C0.8\n%\nT1\nX1.0Y1.0\nM30\n", "does not say its unit; set board.holes"),
        (METRIC + "X15Y1\nM30\n", "which zeros 'X?15' lacks of 3.3 digits"),
        ("M48\nMETRIC\nT1C0800\n%\nT1\nX1.0Y1.0\nM30\n", "without a decimal point"),
        (METRIC + "X1.0Y1.0\nM00\nT1\nX2.0Y2.0\nM30\n", "'T1' comes after the end"),
        (METRIC + "X1.0Y1.0A2.0\nM30\n", "outside an arc"),
        (METRIC + "G00X1.0Y1.0\nG01X2.0\nM30\n", "with the tool up"),
        (METRIC + "G00X1.0Y1.0\nM15\nG01X2.0\nM30\n", "does not end with M30"),
        (METRIC + "G00X1.0Y1.0\nM15\nG02X3.0A0.5\nM16\nM30\n", "an arc of radius 0.5 mm between"),
    ],
)
def test_what_would_lose_or_misplace_a_hole_is_refused(
    tmp_path: Path, text: str, message: str
) -> None:
    with pytest.raises(FileError, match=message):
        read_drills(write(tmp_path, text))


def test_what_a_file_leaves_unsaid_may_be_given(tmp_path: Path) -> None:
    path = write(tmp_path, "%\nT1C.04F095S3\nX01Y005\nM30\n")
    says = DrillFormat(unit="inch", digits=(2, 4), zeros_left_out="trailing")
    (hole,) = read_drills(path, number_format=says)
    assert hole.outline.centroid.coords[0] == pytest.approx((25.4, 12.7))
    leading = DrillFormat(unit="inch", digits=(1, 3), zeros_left_out="leading")
    (hole,) = read_drills(path, number_format=leading)
    assert hole.outline.centroid.coords[0] == pytest.approx((0.0254, 0.127))


def test_drill_files_are_found_by_content_or_suffix(tmp_path: Path) -> None:
    write(tmp_path, METRIC + "M30\n", "holes.TXT")
    write(tmp_path, "T1\n", "b.xln")
    write(tmp_path, "%TF.FileFunction,Plated,1,2,PTH*%\n", "b-PTH-drl.gbr")
    write(tmp_path, "%TF.FileFunction,Drillmap*%\n", "b-map.gbr")
    write(tmp_path, "M48 is a command\n", "readme.txt")
    assert [path.name for path in drill_files(tmp_path)] == ["b-PTH-drl.gbr", "b.xln", "holes.TXT"]


def test_holes_flashed_in_a_gerber_file_are_read_and_mirrored(tmp_path: Path) -> None:
    text = "%TF.FileFunction,NonPlated,1,2,NPTH*%\n%FSLAX46Y46*%\n%MOMM*%\n%ADD10C,1.0*%\nD10*\nX2000000Y1000000D03*\nM02*\n"
    (hole,) = read_drills(write(tmp_path, text, "b-NPTH-drl.gbr"), mirrored=True)
    assert hole.outline.centroid.coords[0] == pytest.approx((-2.0, 1.0))
    assert (hole.outline.area, hole.plated) == (pytest.approx(np.pi / 4, rel=1e-9), False)


@pytest.mark.parametrize(
    ("span", "top", "bottom"), [("1,2,Blind", 1, 0), ("2,4,Blind", 0, 1), ("2,3,Buried", 0, 0)]
)
def test_holes_that_do_not_reach_a_side_are_not_seen_there(
    tmp_path: Path, span: str, top: int, bottom: int
) -> None:
    head = f"M48\n; #@! TF.FileFunction,Plated,{span}\nMETRIC\nT1C0.8\n%\nT1\n"
    path = write(tmp_path, head + "X1.0Y1.0\nM30\n")
    assert len(read_drills(path)) == top
    assert len(read_drills(path, mirrored=True)) == bottom
