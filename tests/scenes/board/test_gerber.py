"""Boards from Gerber files: small ones written here, and a real one where it is at hand."""

import importlib.util
import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import shapely

import scenes
from scenes.board import gerber
from scenes.board.gerber.gerber_board import GerberBoard
from scenes.board.printing import artwork, printed
from scenes.board.surface import surfaces
from scenes.labels.pad_truth import truth_of
from scenes.support.errors import FileError, FringebenchError, FringebenchWarning, SceneError

needs_names = pytest.mark.skipif(
    importlib.util.find_spec("gerbonara") is None,
    reason="file names are known by the optional extra board, which is not installed",
)

HEAD = "%FSLAX46Y46*%\n%MOMM*%\n%LPD*%\n"


def write(folder: Path, name: str, body: str, head: str = HEAD) -> Path:
    path = folder / name
    path.write_text(f"{head}{body}M02*\n")
    return path


def mm(x: float, y: float) -> str:
    return f"X{round(x * 1e6)}Y{round(y * 1e6)}"


def square_board(folder: Path) -> Path:
    """A 10 mm board: two pads, their copper and openings, a track under the mask, outline, in KiCad's file names."""
    pads = f"%ADD10R,1.000000X0.600000*%\nD10*\n{mm(-2, 1)}D03*\n{mm(2, 1)}D03*\n"
    opening = pads.replace("1.000000X0.600000", "1.200000X0.800000")
    track = f"%ADD11C,0.200000*%\nD11*\n{mm(-2, 1)}D02*\n{mm(2, 1)}D01*\n"
    write(folder, "b-F_Paste.gbr", pads)
    write(folder, "b-F_Mask.gbr", opening)
    write(folder, "b-F_Cu.gbr", pads + track)
    corners = [mm(x, y) for x, y in ((5, -5), (5, 5), (-5, 5), (-5, -5))]
    lines = f"{mm(-5, -5)}D02*\n" + "".join(f"{c}D01*\n" for c in corners)
    write(folder, "b-Edge_Cuts.gbr", f"%ADD10C,0.100000*%\nG01*\nD10*\n{lines}")
    return folder


@needs_names
def test_layers_of_a_folder_are_read(tmp_path: Path) -> None:
    layout = artwork(GerberBoard(folder=square_board(tmp_path)))
    assert layout.box == (-5.0, -5.0, 5.0, 5.0)
    assert [pad.centre_mm for pad in layout.pads] == [(-2.0, 1.0), (2.0, 1.0)]
    assert layout.openings.area == pytest.approx(2 * 1.2 * 0.8)
    # Two pads, and a track of 3 mm between them.
    assert layout.copper.area == pytest.approx(2 * 1.0 * 0.6 + 3.0 * 0.2)


@needs_names
@pytest.mark.parametrize(
    ("side", "names"),
    [
        ("top", ["x.gtp", "x.gts", "x.gtl", "x.gko", "x.gto"]),
        ("bottom", ["x.gbp", "x.gbs", "x.gbl", "x.gko", "x.gbo"]),
    ],
)
def test_file_names_of_other_tools_are_known(
    tmp_path: Path, side: gerber.Side, names: list[str]
) -> None:
    for name in names:
        (tmp_path / name).write_text(HEAD + "M02*\n")
    found = gerber.layer_files(tmp_path, side, {})
    assert {role: path.name for role, path in found.items()} == dict(
        zip(gerber.ROLES, names, strict=True)
    )


@needs_names
def test_legend_is_printed_on_the_mask_and_not_in_its_openings(tmp_path: Path) -> None:
    # A line over the first pad, its opening of 0.8 mm and the mask above and below; another across the covered track.
    lines = f"%ADD10R,0.100000X2.000000*%\nD10*\n{mm(-2, 1)}D03*\n{mm(0, 1)}D03*\n"
    write(square_board(tmp_path), "b-F_SilkS.gbr", lines)
    board = GerberBoard.model_validate({"folder": tmp_path, "legend": {"height_mm": 0.01}})
    built = surfaces(artwork(board), board.stackup())
    upward: dict[float, float] = {}
    everything = 0.0
    for label, surface in built.items():
        a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
        areas = np.cross(b - a, c - a)[:, 2] / 2
        everything += float(areas.sum())
        for z, area in zip(a[:, 2].round(9), areas, strict=True):
            if label == "legend" and area > 1e-12:
                upward[float(z)] = upward.get(float(z), 0.0) + float(area)
    # Mask 0.025, copper 0.035, legend 0.01 mm; the track under the second line is 0.2 mm wide.
    assert upward == pytest.approx({0.035: 0.1 * (1.2 + 1.8), 0.07: 0.1 * 0.2}, abs=1e-6)
    # Seen from above the board is covered once.
    assert everything == pytest.approx(100.0, rel=1e-9)
    # What is printed with paste does not depend on the legend.
    plain = printed(board.model_copy(update={"legend": None}))
    assert printed(board).stackup.pad_mm == plain.stackup.pad_mm
    assert truth_of(printed(board)) == truth_of(plain)
    assert board.labels == ("base", "mask", "pad", "paste", "legend")


@needs_names
def test_legend_without_its_layer_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="no legend layer of this side: name it under"):
        artwork(GerberBoard.model_validate({"folder": square_board(tmp_path), "legend": {}}))


def test_bottom_is_mirrored(tmp_path: Path) -> None:
    path = write(tmp_path, "p.gbp", f"%ADD10R,1X0.5*%\nD10*\n{mm(3, 1)}D03*\n")
    (pad,) = gerber.read_pads(path, mirrored=True)
    assert pad.centre_mm == (-3.0, 1.0)


ROUNDED = (
    "%AMROUND*21,1,1.0,0.4,0,0,0*21,1,0.8,0.6,0,0,0*"
    "1,1,0.2,0.4,0.2*1,1,0.2,-0.4,0.2*1,1,0.2,0.4,-0.2*1,1,0.2,-0.4,-0.2*%\n"
)
SHAPES = {
    "circle": ("%ADD10C,0.5*%\n", np.pi * 0.25**2),
    "rectangle": ("%ADD10R,0.9X0.4*%\n", 0.36),
    "obround": ("%ADD10O,1.0X0.4*%\n", 0.6 * 0.4 + np.pi * 0.2**2),
    "octagon": ("%ADD10P,1.0X8*%\n", 8 / 2 * 0.5**2 * np.sin(np.pi / 4)),
    "with a hole": ("%ADD10C,0.8X0.4*%\n", np.pi * (0.4**2 - 0.2**2)),
    "with a rectangular hole": ("%ADD10C,0.8X0.3X0.2*%\n", np.pi * 0.4**2 - 0.3 * 0.2),
    "macro": (ROUNDED + "%ADD10ROUND*%\n", 1.0 * 0.6 - (4 - np.pi) * 0.1**2),
}


@pytest.mark.parametrize("name", SHAPES)
def test_aperture_area_is_exact(tmp_path: Path, name: str) -> None:
    aperture, area = SHAPES[name]
    path = write(tmp_path, "p.gtp", f"{aperture}D10*\n{mm(12.5, -7.25)}D03*\n")
    (pad,) = gerber.read_pads(path)
    assert pad.centre_mm == (12.5, -7.25)
    # Exact but for coordinates rounded to a nanometre; the macro's overlapping disks stick out of its rectangles by
    # 0.08 % of their radius of 0.1 mm.
    assert pad.aperture.area == pytest.approx(area, rel=1e-3 if name == "macro" else 2e-5)
    np.testing.assert_allclose(
        np.array(pad.aperture.bounds).reshape(2, 2).mean(axis=0), 0.0, atol=2e-3
    )


def test_cut_out_is_removed_from_the_board(tmp_path: Path) -> None:
    def ring(half: float) -> str:
        first, *rest = ((-half, -half), (half, -half), (half, half), (-half, half))
        return f"{mm(*first)}D02*\n" + "".join(f"{mm(*p)}D01*\n" for p in (*rest, first))

    path = write(tmp_path, "o.gko", f"%ADD10C,0.1*%\nG01*\nD10*\n{ring(5)}{ring(1)}")
    outline = gerber.read_outline(path)
    assert outline.area == pytest.approx(100.0 - 4.0)


def test_round_outline_has_a_circles_area(tmp_path: Path) -> None:
    body = f"%ADD10C,0.1*%\nD10*\nG75*\n{mm(5, 0)}D02*\nG03*\n{mm(5, 0)}I-5000000J0D01*\n"
    outline = gerber.read_outline(write(tmp_path, "o.gko", body))
    # A chord's sagitta of 2 um at most loses two thirds of that along the rim.
    assert outline.area == pytest.approx(np.pi * 25.0, abs=2 * np.pi * 5 * 0.002 + 0.01)


BROKEN = {
    "empty": "",
    "text": "this is not a Gerber file\n",
    "no aperture": HEAD + "D10*\nX0Y0D03*\nM02*\n",
    "binary": "\x00\x01\x02" * 300,
}


@pytest.mark.parametrize("name", BROKEN)
def test_damaged_file_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "p.gtp").write_text(BROKEN[name])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(FringebenchError):
            artwork(GerberBoard(folder=tmp_path))


@needs_names
def test_message_names_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="does not exist"):
        artwork(GerberBoard(folder=tmp_path / "nowhere"))
    (tmp_path / "readme.txt").write_text("hello")
    with pytest.raises(FileError, match="no top paste layer among the 1 files"):
        artwork(GerberBoard(folder=tmp_path))
    square_board(tmp_path)
    far = {"region": {"centre_mm": [90.0, 0.0], "size_mm": [5.0, 5.0]}}
    with pytest.raises(SceneError, match="is outside the board"):
        artwork(GerberBoard.model_validate({"folder": tmp_path, **far}))
    with pytest.raises(SceneError, match="pad 3 does not exist"):
        artwork(GerberBoard(folder=tmp_path, pads=(3,)))


def test_message_without_the_library_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "gerbonara.layer_rules", None)
    write(tmp_path, "b-F_Paste.gbr", f"%ADD10R,1X1*%\nD10*\n{mm(0, 0)}D03*\n")
    with pytest.raises(FileError, match=r'pip install "fringebench\[board\]"'):
        gerber.layer_files(tmp_path, "top", {})


def board_of(folder: Path, places: list[tuple[float, float]]) -> GerberBoard:
    """A 10 mm board with pads at these places."""
    flashes = "".join(f"{mm(*place)}D03*\n" for place in places)
    write(folder, "paste.gbr", f"%ADD10R,1X1*%\nD10*\n{flashes}")
    square_board(folder)
    files = {"paste": folder / "paste.gbr", "outline": folder / "b-Edge_Cuts.gbr"}
    return GerberBoard.model_validate({"files": files})


def test_pads_outside_the_outline_are_reported(tmp_path: Path) -> None:
    with pytest.warns(FringebenchWarning, match="1 of 3 paste openings are outside.*P2"):
        layout = artwork(board_of(tmp_path, [(0, 0), (20, 0), (3, 3)]))
    assert [pad.id for pad in layout.pads] == [1, 3]
    with pytest.raises(SceneError, match="all 2 paste openings are outside"):
        artwork(board_of(tmp_path, [(20, 0), (30, 0)]))


@needs_names
def test_changed_file_is_read_again(tmp_path: Path) -> None:
    folder = square_board(tmp_path)
    board = GerberBoard(folder=folder)
    assert len(artwork(board).pads) == 2
    assert artwork(board.model_copy(update={"seed": 4})) is artwork(board)
    write(folder, "b-F_Paste.gbr", f"%ADD10R,1X1*%\nD10*\n{mm(0, 0)}D03*\n")
    assert len(artwork(board).pads) == 1


@needs_names
def test_board_folder_is_relative_to_the_scene_file(tmp_path: Path) -> None:
    (tmp_path / "gerbers").mkdir()
    square_board(tmp_path / "gerbers")
    text = scenes.source("spi")
    start, end = text.index("[board]"), text.index("[board.paste]")
    mine = text[:start] + '[board]\nkind = "gerber"\nfolder = "gerbers"\n\n' + text[end:]
    (tmp_path / "mine.toml").write_text(mine)
    scene = scenes.load(tmp_path / "mine.toml")
    assert set(scenes.meshes(scene)) >= {"mask", "pad"}
    assert scenes.parse(scenes.dumps(scene)) == scene


def real_board() -> Path:
    """The folder of the real board: under FRINGEBENCH_BOARDS, else next to the repository."""
    default = Path(__file__).parents[4] / "shared" / "boards"
    folder = Path(os.environ.get("FRINGEBENCH_BOARDS", default)) / "chibi_2024"
    if not folder.is_dir():
        pytest.skip(f"the real board's Gerber files are not at {folder}: set FRINGEBENCH_BOARDS")
    return folder


def flashes(path: Path) -> list[tuple[float, float]]:
    """Where a KiCad 4 paste layer flashes, read without any library: X and Y in nanometres before each D03."""
    places = [
        line[1:].split("D03")[0].split("Y")
        for line in path.read_text().splitlines()
        if "D03*" in line
    ]
    return [(int(x) * 1e-6, int(y) * 1e-6) for x, y in places]


def test_real_board_has_paste_where_its_gerber_has_it() -> None:
    folder = real_board()
    expected = np.array(flashes(folder / "chibi_2024-F.Paste.gbr"))
    assert len(expected) == 209
    board = GerberBoard.model_validate(
        {"folder": folder, "paste": {"step_mm": 0.02, "transfer": {"spread": 0.0}}}
    )
    print_ = printed(board)
    assert len(print_.deposits) == 209
    found = np.array([d.field.centroid_mm for d in print_.deposits if d.field])
    # A micrometre is the promise.
    np.testing.assert_allclose(found + print_.layout.centre_mm, expected, atol=1e-3)
    # An arc of radius r in a right corner is (sqrt(2) - 1) r from it, and nothing else is off; small openings have r of less.
    corner_mm = (np.sqrt(2.0) - 1.0) * board.paste.corner_mm
    for deposit in print_.deposits:
        off_mm = shapely.hausdorff_distance(deposit.footprint, deposit.aperture)
        assert off_mm < corner_mm + 1e-3
    volume = sum(d.field.volume_mm3 for d in print_.deposits if d.field)
    efficiency = board.paste.transfer.efficiency
    due = sum(d.aperture.area * 0.12 * efficiency(d.area_ratio) for d in print_.deposits)
    assert volume == pytest.approx(due, rel=1e-3)


def test_region_of_a_real_board_is_cut_out() -> None:
    settings = {
        "folder": real_board(),
        "region": {"centre_mm": [103.0, -60.0], "size_mm": [12.0, 9.0]},
    }
    layout = artwork(GerberBoard.model_validate(settings))
    assert layout.board.area == pytest.approx(12.0 * 9.0)
    assert layout.centre_mm == (103.0, -60.0)
    assert 10 < len(layout.pads) < 209
    # Every printed pad is on bare copper, as a real board's paste does.
    bare = layout.copper.intersection(layout.openings).buffer(0.002)
    assert all(bare.contains(pad.outline) for pad in layout.pads)
