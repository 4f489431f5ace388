"""Commands of the Gerber format, each in a small file whose areas follow from geometry."""

import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import shapely

from scenes.board import gerber
from scenes.support.errors import FileError

HEAD = "%FSLAX46Y46*%\n%MOMM*%\n%LPD*%\n"
BOX = "%ADD10R,1.0X0.5*%\nD10*\n"
TRIANGLE = "%AMTRI*4,1,3,0,0,1,0,0,1,0,0,0*%\n%ADD10TRI*%\nD10*\n"
# A coordinate of the files' nanometres may round either way at each corner.
ROUNDED = 1e-5


def at(x: float, y: float, operation: str = "") -> str:
    return f"X{round(x * 1e6)}Y{round(y * 1e6)}{operation}*\n"


def rectangle(x0: float, y0: float, x1: float, y1: float) -> str:
    """A region."""
    corners = [(x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    return (
        "G36*\n"
        + at(x0, y0, "D02")
        + "G01*\n"
        + "".join(at(x, y, "D01") for x, y in corners)
        + "G37*\n"
    )


def pads_of(folder: Path, body: str, head: str = HEAD) -> list[shapely.Polygon]:
    path = folder / "paste.gbr"
    path.write_text(f"{head}{body}M02*\n")
    return [pad.outline for pad in gerber.read_pads(path)]


CLEAR = f"%LPC*%\n{rectangle(-2, -2, 2, 2)}%LPD*%\n"
# Body, areas of the pads in order.
FILES: dict[str, tuple[str, list[float]]] = {
    "clear first": (f"{CLEAR}{BOX}{at(0, 0, 'D03')}", [0.5]),
    "clear between": (f"{BOX}{at(0, 0, 'D03')}{CLEAR}{at(1, 0, 'D03')}{at(9, 0, 'D03')}", [0.5, 0.5]),
    "clear last": (f"{BOX}{at(0, 0, 'D03')}{at(9, 0, 'D03')}{CLEAR}", [0.5]),
    "clear in part": (f"{BOX}{at(0, 0, 'D03')}%LPC*%\n{rectangle(0, -1, 1, 1)}", [0.25]),
    "flashes that overlap": (f"{BOX}{at(0, 0, 'D03')}{at(5, 0, 'D03')}{at(0.5, 0, 'D03')}", [0.75, 0.5]),
    "region and stroke": (f"{rectangle(0, 0, 1, 0.5)}%ADD10R,0.2X0.2*%\nD10*\n{at(3, 0, 'D02')}{at(4, 0, 'D01')}", [0.5, 0.24]),
    "flash on a region": (f"{rectangle(-1, -1, 1, 1)}%ADD10C,0.8*%\nD10*\n{at(0, 0, 'D03')}", [4.0]),
    "region on a flash": (f"{BOX}{at(0, 0, 'D03')}{rectangle(-0.5, -0.25, 0.5, 0.25)}", [0.5]),
    "flash beyond a region": (f"{rectangle(0, -0.25, 1, 0.25)}{BOX}{at(0, 0, 'D03')}", [0.75]),
    "stroke on a flash": (
        f"{BOX}{at(0, 0, 'D03')}%ADD11C,0.2*%\nD11*\n{at(-0.4, 0, 'D02')}{at(0.4, 0, 'D01')}",
        [0.5],
    ),
    "abutting strokes": (
        "%ADD10R,0.2X1*%\nD10*\n"
        + "".join(at(0.2 * i, 0, "D02") + at(0.2 * i, 1, "D01") for i in range(5)),
        [1.0 * 2.0],
    ),
    "modal flash": (f"{BOX}{at(0, 0, 'D03')}{at(2, 0)}{at(4, 0)}", [0.5] * 3),
    "modal stroke": (f"%ADD10R,0.5X0.5*%\nD10*\n{at(0, 0, 'D02')}{at(1, 0, 'D01')}{at(2, 0)}", [1.25]),
    "G70": (f"G70*\n{BOX}{at(0, 0, 'D03')}", [0.5 * 25.4**2]),
    "G71": (f"G70*\nG71*\n{BOX}{at(0, 0, 'D03')}", [0.5]),
    "select with G54": (f"%ADD10R,1.0X0.5*%\nG54D10*\n{at(0, 0, 'D03')}", [0.5]),
    "several in one block": (f"%ADD10R,1X1*ADD11R,2X2*%\nD11*\n{at(0, 0, 'D03')}", [4.0]),
    "square stroke": (f"%ADD10R,0.5X0.5*%\nD10*\n{at(0, 0, 'D02')}{at(1, 0, 'D01')}", [0.75]),
    "thin stroke": (f"%ADD10R,0.2X1.0*%\nD10*\n{at(0, 0, 'D02')}{at(1, 0, 'D01')}", [1.2]),
    # A rectangle w x h along (x, y) sweeps w h + x h + y w.
    "slanted stroke": (f"{BOX}{at(0, 0, 'D02')}{at(2, 1, 'D01')}", [0.5 + 2 * 0.5 + 1 * 1.0]),
    "stroke of no length": (f"{BOX}{at(0, 0, 'D02')}{at(0, 0, 'D01')}", [0.5]),
    "stroke of a triangle": (f"{TRIANGLE}{at(0, 0, 'D02')}{at(2, 0, 'D01')}", [0.5 + 2.0]),
    "round stroke": (
        f"%ADD10C,0.4*%\nD10*\n{at(0, 0, 'D02')}{at(1, 1, 'D01')}",
        [0.4 * np.sqrt(2) + np.pi * 0.2**2],
    ),
    # Half a turn at 1 mm, and two half disks.
    "round stroke along an arc": (
        f"%ADD10C,0.4*%\nD10*\nG75*\n{at(1, 0, 'D02')}G03*\n{at(-1, 0, 'I-1000000J0D01')}",
        [np.pi * 0.4 + np.pi * 0.2**2],
    ),
    "round stroke around": (
        f"%ADD10C,0.4*%\nD10*\nG75*\n{at(1, 0, 'D02')}G02*\n{at(1, 0, 'I-1000000J0D01')}",
        [2 * np.pi * 0.4],
    ),
    "LR": (f"{BOX}%LR90*%\n{at(0, 0, 'D03')}%LR45*%\n{at(3, 0, 'D03')}", [0.5, 0.5]),
    "LS": (f"{BOX}%LS2*%\n{at(0, 0, 'D03')}%LS0.5*%\n{at(5, 0, 'D03')}", [2.0, 0.125]),
    "LS of a stroke": (
        f"%ADD10C,0.2*%\nD10*\n%LS2*%\n{at(0, 0, 'D02')}{at(1, 0, 'D01')}",
        [0.4 + np.pi * 0.2**2],
    ),
    "SR": (f"{BOX}%SRX2Y3I5.0J4.0*%\n{at(0, 0, 'D03')}%SR*%\n", [0.5] * 6),
    "SR closed by X1Y1": (f"{BOX}%SRX2Y3I5.0J4.0*%\n{at(0, 0, 'D03')}%SRX1Y1I0J0*%\n", [0.5] * 6),
    "SR left open": (f"{BOX}%SRX3Y1I5.0J0*%\n{at(0, 0, 'D03')}", [0.5] * 3),
    "SR after SR": (
        f"{BOX}%SRX2Y1I5J0*%\n{at(0, 0, 'D03')}%SRX3Y1I5J0*%\n{at(0, 9, 'D03')}%SR*%\n",
        [0.5] * 5,
    ),
    "SR of a region": (f"%SRX2Y1I5J0*%\n{rectangle(0, 0, 1, 1)}%SR*%\n", [1.0] * 2),
    "SR of clear and dark": (
        f"{BOX}%SRX2Y1I5J0*%\n{at(0, 0, 'D03')}%LPC*%\n{rectangle(0, -1, 1, 1)}%LPD*%\n%SR*%\n",
        [0.25] * 2,
    ),
    "AB": (f"%ADD10R,1.0X0.5*%\n%ABD12*%\nD10*\n{at(0, 0, 'D03')}{at(2, 0, 'D03')}%AB*%\nD12*\n{at(0, 0, 'D03')}{at(0, 3, 'D03')}", [0.5] * 4),
    "AB in AB": (
        f"%ADD10R,1X1*%\n%ABD11*%\nD10*\n{at(0, 0, 'D03')}%AB*%\n%ABD12*%\nD11*\n{at(0, 0, 'D03')}{at(2, 0, 'D03')}"
        f"%AB*%\nD12*\n%LS0.5*%\n{at(0, 0, 'D03')}{at(9, 0, 'D03')}",
        [0.25] * 4,
    ),
    "AB flashed clear": (
        f"%ADD10R,1X1*%\n%ABD11*%\nD10*\n{at(0, 0, 'D03')}%AB*%\n%LPD*%\n{rectangle(-1, -1, 1, 1)}%LPC*%\nD11*\n"
        + at(0, 0, "D03"),
        [3.0],
    ),
    "thermal": (
        "%AMTH*7,0,0,2.0,1.0,0.2,45*%\n%ADD10TH*%\nD10*\n" + at(0, 0, "D03"),
        # A quarter of the ring, less half a gap on each side. A gap is 2 * integral of sqrt(1 - y^2) - sqrt(0.25 - y^2)
        # from 0 to 0.1.
        [
            np.pi * 0.75 / 4
            - (0.1 * np.sqrt(0.99) + np.arcsin(0.1))
            + (0.1 * np.sqrt(0.24) + 0.25 * np.arcsin(0.2))
        ]
        * 4,
    ),
    "outline off the origin": ("%AMOO*4,1,3,1,1,2,1,1,2,1,1,0*%\n%ADD10OO*%\nD10*\n" + at(0, 0, "D03"), [0.5]),
    "lower left line": ("%AMLL*22,1,1.0,0.5,0,0,0*%\n%ADD10LL*%\nD10*\n" + at(0, 0, "D03"), [0.5]),
    "vector line, turned": ("%AMVL*2,1,0.5,0,0,1,0,30*%\n%ADD10VL*%\nD10*\n" + at(0, 0, "D03"), [0.5]),
    "expressions": (
        "%AMEX*$3=$1x2-(1+$2)/2*21,1,$3,-$2+1,0,0,0*%\n%ADD10EX,1.0X0.5*%\nD10*\n" + at(0, 0, "D03"),
        [1.25 * 0.5],
    ),
    "signs": ("%AMSI*21,1,+$1,--$2,+0,-0,0*%\n%ADD10SI,1.0X0.5*%\nD10*\n" + at(0, 0, "D03"), [0.5]),
    "percent signs in and after a comment": (f"%ADD10R,1.0X0.5*%\nG04 scaled to 40%*%D10*\n{at(0, 0, 'D03')}", [0.5]),
    "exposure off": ("%AMEO*21,1,2,2,0,0,0*1,0,1,0,0*%\n%ADD10EO*%\nD10*\n" + at(0, 0, "D03"), [4 - np.pi / 4]),
    # The hole shows what was painted before, as apertures do not erase.
    "hole over copper": (f"{rectangle(-1, -1, 1, 1)}%ADD10C,0.8X0.4*%\nD10*\n{at(0, 0, 'D03')}", [4.0]),
    "moire": (
        "%AMMO*6,0,0,2.0,0.2,0.3,2,0,0,0*%\n%ADD10MO*%\nD10*\n" + at(0, 0, "D03"),
        [np.pi * (1.0**2 - 0.8**2), np.pi * (0.5**2 - 0.3**2)],
    ),
    "region of two contours": (
        rectangle(0, 0, 1, 1).replace("G37*\n", rectangle(2, 0, 3, 1).replace("G36*\n", "")),
        [1.0, 1.0],
    ),
    # A contour runs in to its hole and back along the same line.
    "region with a cut-in": (
        "G36*\n" + at(0, 0, "D02") + "".join(
            at(x, y, "D01")
            for x, y in ((4, 0), (4, 4), (0, 4), (0, 1), (1, 1), (1, 3), (3, 3), (3, 1), (0, 1), (0, 0))
        ) + "G37*\n",
        [16.0 - 4.0],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_command_paints_its_area(tmp_path: Path, name: str) -> None:
    body, areas = FILES[name]
    # 64 corners instead of two circles.
    rel = 2e-3 if name in ("moire", "exposure off") else ROUNDED
    assert [pad.area for pad in pads_of(tmp_path, body)] == pytest.approx(areas, rel=rel)


@pytest.mark.parametrize("radius", [0.1, 0.125, 0.15, 0.25, 0.5, 5.0])
@pytest.mark.parametrize("pieces", [1, 2, 4, 7])
def test_arcs_of_a_region_keep_the_area(tmp_path: Path, radius: float, pieces: int) -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, pieces + 1)
    body = "G75*\nG36*\n" + at(radius, 0.0, "D02") + "G03*\n"
    for start, end in pairwise(angles):
        x, y = radius * np.cos(end), radius * np.sin(end)
        i, j = (round(-radius * 1e6 * v) for v in (np.cos(start), np.sin(start)))
        body += at(x, y, f"I{i}J{j}D01")
    (pad,) = pads_of(tmp_path, body + "G37*\n")
    # Half a nanometre on each coordinate of a radius.
    assert pad.area == pytest.approx(np.pi * radius**2, rel=3e-6 / radius)


def test_polygon_of_a_large_arc_is_within_two_micrometres_of_it(tmp_path: Path) -> None:
    body = "G75*\nG36*\n" + at(50.0, 0.0, "D02") + "G03*\n" + at(50.0, 0.0, "I-50000000J0D01")
    (pad,) = pads_of(tmp_path, body + "G37*\n")
    corners = shapely.get_coordinates(pad.exterior)
    chords = (corners[1:] + corners[:-1]) / 2.0
    assert np.abs(np.hypot(*np.vstack([corners, chords]).T) - 50.0).max() < 2e-3


def test_line_by_its_corner_begins_there(tmp_path: Path) -> None:
    body = "%AMLL*22,1,1.0,0.5,0.3,-0.2,0*%\n%ADD10LL*%\nD10*\n" + at(0, 0, "D03")
    (pad,) = pads_of(tmp_path, body)
    assert pad.bounds == pytest.approx((0.3, -0.2, 1.3, 0.3))


def test_single_quadrant_arc_is_the_short_one(tmp_path: Path) -> None:
    body = "G74*\nG36*\n" + at(1, 0, "D02") + "G03*\n" + at(0, 1, "I1000000J0D01")
    body += "G01*\n" + at(0, 0, "D01") + at(1, 0, "D01") + "G37*\n"
    (pad,) = pads_of(tmp_path, body)
    assert pad.area == pytest.approx(np.pi / 4, rel=ROUNDED)


def test_mirroring_rotation_and_scaling_apply_in_that_order(tmp_path: Path) -> None:
    (pad,) = pads_of(tmp_path, f"{TRIANGLE}%LMX*%\n%LR90*%\n%LS2*%\n{at(0, 0, 'D03')}")
    # Corners (0, 0), (1, 0), (0, 1): mirrored to -x, turned to -y and -x, doubled.
    expected = shapely.Polygon([(0, 0), (0, -2), (-2, 0)])
    assert pad.symmetric_difference(expected).area < 1e-9


@pytest.mark.parametrize(
    "primitive",
    # One millimetre from the origin on the x axis, each with its rotation last.
    ["1,1,0.4,1,0,90", "2,1,0.4,0.5,0,1.5,0,90", "21,1,1,0.4,1,0,90", "22,1,1,0.4,0.5,-0.2,90",
     "4,1,4,0.5,-0.2,1.5,-0.2,1.5,0.2,0.5,0.2,0.5,-0.2,90"],
)  # fmt: skip
def test_macro_primitives_turn_about_the_origin(tmp_path: Path, primitive: str) -> None:
    (pad,) = pads_of(tmp_path, f"%AMM*{primitive}*%\n%ADD10M*%\nD10*\n{at(0, 0, 'D03')}")
    assert (pad.centroid.x, pad.centroid.y) == pytest.approx((0.0, 1.0), abs=1e-6)
    x0, y0, x1, y1 = pad.bounds
    length_mm = 0.4 if primitive.startswith("1,") else 1.0
    assert (x1 - x0, y1 - y0) == pytest.approx((0.4, length_mm), abs=1e-3)


def test_repeats_are_at_their_places_in_inches_too(tmp_path: Path) -> None:
    head = "%FSLAX24Y24*%\n%MOIN*%\n"
    body = "%ADD10R,0.04X0.02*%\n%SRX2Y2I0.2J0.1*%\nD10*\nX0Y0D03*\n%SR*%\n"
    pads = pads_of(tmp_path, body, head)
    centres = [(pad.centroid.x, pad.centroid.y) for pad in pads]
    assert pads[0].area == pytest.approx(0.04 * 0.02 * 25.4**2, rel=ROUNDED)
    # Columns first, then rows: the order of the specification.
    expected = [(x * 5.08, y * 2.54) for x in (0, 1) for y in (0, 1)]
    np.testing.assert_allclose(centres, expected, atol=1e-6)


def test_incremental_coordinates_add_up(tmp_path: Path) -> None:
    body = f"{BOX}{at(1, 1, 'D03')}{at(2, 0, 'D03')}{at(2, 0, 'D03')}"
    pads = pads_of(tmp_path, body, HEAD.replace("FSLA", "FSLI"))
    assert [pad.centroid.x for pad in pads] == pytest.approx([1.0, 3.0, 5.0])


@pytest.mark.parametrize(
    ("format_", "coordinate"), [("FSLAX24Y24", "X10000Y0"), ("FSTAX24Y24", "X01Y0"), ("FSDAX24Y24", "X1.0Y0")]
)  # fmt: skip
def test_zeros_are_restored(tmp_path: Path, format_: str, coordinate: str) -> None:
    (pad,) = pads_of(tmp_path, f"{BOX}{coordinate}D03*\n", f"%{format_}*%\n%MOMM*%\n")
    assert pad.centroid.x == pytest.approx(1.0)


REFUSED = {
    "cut off": (HEAD + BOX + at(0, 0, "D03"), "M02"),
    "cut off in a command": (HEAD + BOX + at(0, 0, "D03") + "%LP", "cut off"),
    "unknown command": (HEAD + "%XY1*%\n" + BOX + at(0, 0, "D03") + "M02*", "%?XY1"),
    "unknown word": (HEAD + BOX + "G99*\n" + at(0, 0, "D03") + "M02*", "G99"),
    "undefined aperture": (HEAD + "D12*\n" + at(0, 0, "D03") + "M02*", "D12"),
    "undefined macro": (HEAD + "%ADD10NAME*%\nM02*", "NAME"),
    "no unit": ("%FSLAX46Y46*%\nG36*\n" + at(0, 0, "D02") + "M02*", "unit"),
    "no format": ("%MOMM*%\n" + BOX + at(0, 0, "D03") + "M02*", "format"),
    "open macro outline": (
        HEAD + "%AMO*4,1,3,0,0,1,0,1,1,0.1,0,0*%\n%ADD10O1*%\nM02*",
        "not defined|open",
    ),
    "nested macro": (
        HEAD + f"%AMN*1,1,{'(' * 3000}1{')' * 3000},0,0*%\n%ADD10N*%\n" + at(0, 0, "D03") + "M02*",
        "nested too deeply",
    ),
    "thermal of gaps alone": (HEAD + "%AMT*7,0,0,1,0.5,0.8,0*%\n%ADD10T*%\nM02*", "thermal"),
    "polygon of too many corners": (HEAD + "%ADD10P,1X1001*%\nD10*\n" + at(0, 0, "D03") + "M02*", "1001 corners"),
    "unknown primitive": (HEAD + "%AMQ*9,1,2*%\n%ADD10Q*%\nM02*", "not defined|primitive 9"),
    "endless repeat": (HEAD + BOX + "%SRX99999Y99999I1J1*%\n" + at(0, 0, "D03") + "M02*", "more than"),
    "open block": (HEAD + "%ABD12*%\n" + BOX + at(0, 0, "D03") + "M02*", "not closed"),
    "mirrored image": (HEAD + "%MIA1B0*%\n" + BOX + at(0, 0, "D03") + "M02*", "MIA1B0"),
    "flash in a region": (HEAD + BOX + "G36*\n" + at(0, 0, "D03") + "M02*", "region"),
    "crooked arc": (
        HEAD + BOX + "G75*\n" + at(0, 0, "D02") + "G03*\n" + at(5, 5, "I1000000J0D01") + "M02*",
        "arc",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_understood_is_refused(tmp_path: Path, name: str) -> None:
    text, message = REFUSED[name]
    path = tmp_path / "paste.gbr"
    path.write_text(text)
    with pytest.raises(FileError, match=message):
        gerber.read_pads(path)


def outline_of(folder: Path, body: str) -> shapely.Geometry:
    path = folder / "outline.gbr"
    path.write_text(f"{HEAD}%ADD10C,0.1*%\nG01*\nD10*\n{body}M02*\n")
    return gerber.read_outline(path)


def open_square(gap_mm: float, side_mm: float = 10.0) -> str:
    corners = [(side_mm, 0.0), (side_mm, side_mm), (0.0, side_mm), (0.0, gap_mm)]
    return at(0, 0, "D02") + "".join(at(x, y, "D01") for x, y in corners)


CUT_OUT = at(4, 4, "D02") + "".join(at(x, y, "D01") for x, y in ((6, 4), (6, 6), (4, 6), (4, 4)))


@pytest.mark.parametrize("gap_mm", [0.0, 1e-6, 0.001, 0.00254, 0.0254, 0.09])
def test_small_gap_of_an_outline_is_closed(tmp_path: Path, gap_mm: float) -> None:
    assert outline_of(tmp_path, open_square(gap_mm)).area == pytest.approx(100.0, rel=1e-6)
    assert outline_of(tmp_path, open_square(gap_mm) + CUT_OUT).area == pytest.approx(96.0, rel=1e-6)


@pytest.mark.parametrize("rest", ["", CUT_OUT])
@pytest.mark.parametrize("gap_mm", [0.2, 1.0, 4.0])
def test_large_gap_of_an_outline_is_refused(tmp_path: Path, gap_mm: float, rest: str) -> None:
    with pytest.raises(FileError, match=rf"open.*{gap_mm:.3g} mm apart.*0\.1 mm is closed"):
        outline_of(tmp_path, open_square(gap_mm) + rest)


def test_pieces_in_any_order_and_loose_lines_make_an_outline(tmp_path: Path) -> None:
    sides = [
        ((0, 0), (10, 0)),
        ((10, 10), (10, 0.01)),
        ((0.02, 10), (10, 10)),
        ((0, 0.03), (0, 10)),
    ]
    body = "".join(at(*a, "D02") + at(*b, "D01") for a, b in sides)
    loose = at(2, 2, "D02") + at(3, 2, "D01") + at(12, 0, "D02") + at(12, 10, "D01")
    # The gaps' own triangles are of a few 0.01 mm by 10 mm / 2.
    assert outline_of(tmp_path, body + loose).area == pytest.approx(100.0, abs=0.2)


def test_end_near_a_line_is_joined_to_it(tmp_path: Path) -> None:
    body = at(0, 0, "D02") + "".join(
        at(x, y, "D01") for x, y in ((10, 0), (10, 10), (0, 10), (0, 0))
    )
    # A slot of the full height, whose ends stop 20 um short: two faces, and both are board.
    body += at(5, 0.02, "D02") + at(5, 9.98, "D01")
    assert outline_of(tmp_path, body).area == pytest.approx(100.0, rel=1e-6)


@pytest.mark.parametrize("attribute", ["Paste,Bot", "Paste,Bottom"])
def test_declared_functions_win_over_file_names(tmp_path: Path, attribute: str) -> None:
    functions = (attribute, "Soldermask,Bot", "Paste,Top", "Copper,L2,Bot,Signal", "Copper,L1,Top")
    for i, function in enumerate(functions):
        # Before X2 attributes existed, they were comments.
        words = "G04 #@! TF.FileFunction,{}*" if i == 1 else "%TF.FileFunction,{}*%"
        text = f"{words.format(function)}\n{HEAD}{BOX}{at(0, 0, 'D03')}M02*\n"
        (tmp_path / f"l{i}.gbr").write_text(text)
    found = gerber.layer_files(tmp_path, "bottom", {})
    expected = {"paste": "l0.gbr", "mask": "l1.gbr", "copper": "l3.gbr"}
    assert {role: path.name for role, path in found.items()} == expected
    top = gerber.layer_files(tmp_path, "top", {})
    assert {role: path.name for role, path in top.items()} == {
        "paste": "l2.gbr",
        "copper": "l4.gbr",
    }


# What gerbv 2.9 draws otherwise than the specification has it: newer commands, strokes with other apertures than circles
# and rectangles, expressions with precedence, and the gaps of thermals.
NOT_GERBV = {"AB", "AB in AB", "AB flashed clear", "LR", "LS", "LS of a stroke"}
NOT_GERBV |= {"stroke of a triangle", "expressions", "thermal"}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("gerbv") is None, reason="gerbv is not installed")
@pytest.mark.parametrize("name", sorted(FILES.keys() - NOT_GERBV))
def test_gerbv_paints_the_same_area(tmp_path: Path, name: str) -> None:
    """An independent reader, by counting pixels."""
    from PIL import Image

    pads = pads_of(tmp_path, FILES[name][0])
    x0, y0, x1, y1 = shapely.union_all(pads).bounds
    dpi = int(min(2000 / ((max(x1 - x0, y1 - y0) + 0.4) / 25.4), 20000))
    window = [(x0 - 0.2) / 25.4, (y0 - 0.2) / 25.4, (x1 - x0 + 0.4) / 25.4, (y1 - y0 + 0.4) / 25.4]
    picture = tmp_path / "painted.png"
    subprocess.run(
        [
            *("gerbv", "-x", "png", "-D", str(dpi), "-B", "0", "-b", "#000000", "-f", "#ffffff"),
            *("-O", f"{window[0]:.6f}x{window[1]:.6f}", "-W", f"{window[2]:.6f}x{window[3]:.6f}"),
            *("-o", str(picture), str(tmp_path / "paste.gbr")),
        ],
        check=True,
        capture_output=True,
        timeout=300,
    )
    with Image.open(picture) as image:
        found = (np.asarray(image.convert("L")) > 127).sum() * (25.4 / dpi) ** 2
    # Straight edges round together, by up to half a pixel along the whole outline.
    rim = sum(pad.length for pad in pads) * 0.5 * 25.4 / dpi
    assert found == pytest.approx(sum(pad.area for pad in pads), abs=rim)
