"""Parametric boards in scenes: place and amount of paste, and what defects do to it."""

import time
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import trimesh
from pydantic import TypeAdapter

import scenes
from scenes.board.board import Board, ParametricBoard
from scenes.board.component_packages import Bga, Chip, Qfn, Qfp
from scenes.board.defects import Contamination, Offset, Scratch, Smear, _speck
from scenes.board.deposits import Print
from scenes.board.pad_layout import circle, rectangle
from scenes.board.printing import artwork, printed
from scenes.board.surface import surfaces
from scenes.board.transfer import Transfer
from scenes.labels.pad_truth import BoardTruth, PadTruth, truth_of
from scenes.shapes.materials import Printed
from scenes.support.distribution import value_range
from scenes.support.errors import SceneError

# Square corners: triangles along arcs are not symmetric to a nanometre.
QUIET: dict[str, Any] = {"step_mm": 0.02, "corner_mm": 0.0, "transfer": {"spread": 0.0}}
HUNDREDS: list[dict[str, Any]] = [
    {
        "package": "qfp",
        "position_mm": [-8.0, 0.0],
        "pins": 100,
        "row_mm": 15.4,
        "rotation_deg": 45.0,
    },
    {"package": "bga", "position_mm": [8.0, 4.0], "columns": 12, "rows": 12},
    {"package": "qfn", "position_mm": [8.0, -5.0], "rotation_deg": 30.0},
    *(
        {"package": "chip", "size": size, "position_mm": [-1.5 + 4.0 * i, 10.5]}
        for i, size in enumerate(["0201", "0402", "0603", "0805", "1206"])
    ),
]
# Every shape of pad there is on those, for what holds of each pad alone.
FEW = [*HUNDREDS[2:], HUNDREDS[1] | {"columns": 2, "rows": 2}]


def board(parts: list[dict[str, Any]] | None = None, **settings: Any) -> Board:
    settings = {"paste": QUIET, "size_mm": [40.0, 32.0]} | settings
    return ParametricBoard.model_validate({"parts": parts or HUNDREDS, **settings})


def with_defect(name: str, **settings: Any) -> tuple[Print, BoardTruth]:
    print_ = printed(board(FEW, defects={name: {"probability": 1.0, **settings}}))
    return print_, truth_of(print_)


@pytest.fixture(scope="module")
def plain() -> Print:
    return printed(board())


@pytest.fixture(scope="module")
def few_truth() -> BoardTruth:
    return truth_of(printed(board(FEW)))


def test_deposits_are_centred_on_their_pads(plain: Print) -> None:
    assert len(plain.deposits) == 100 + 144 + 32 + 4 + 10
    copper = plain.layout.copper.buffer(1e-6)
    for deposit in plain.deposits:
        assert deposit.field is not None
        at = np.asarray(deposit.pad.centre_mm) - plain.layout.centre_mm
        # A micrometre, where float64 leaves a picometre.
        np.testing.assert_allclose(deposit.field.centroid_mm, at, atol=1e-6)
        assert shapely.hausdorff_distance(deposit.footprint, deposit.aperture) < 1e-6
        assert copper.contains(deposit.pad.outline)


def test_total_volume_is_aperture_times_stencil_times_transfer(plain: Print) -> None:
    expected = {
        d.pad.id: d.pad.aperture.area * 0.12 * board().paste.transfer.efficiency(d.area_ratio)
        for d in plain.deposits
    }
    solids = [trimesh.Trimesh(*d.field.solid(), process=False) for d in plain.deposits if d.field]
    assert all(solid.is_watertight for solid in solids)
    assert sum(s.volume for s in solids) == pytest.approx(sum(expected.values()), rel=1e-9)
    for pad in truth_of(plain).pads:
        assert pad.volume_mm3 == pytest.approx(expected[pad.pad], rel=1e-9)
        assert pad.mean_height_mm * pad.area_mm2 == pytest.approx(pad.volume_mm3)
        assert pad.mean_height_mm < pad.peak_height_mm < 0.2
        assert pad.defects == () and pad.bridged_to == ()


def test_round_apertures_have_a_circles_area() -> None:
    pad = artwork(board([{"package": "bga", "position_mm": [0, 0], "pad_mm": 0.3}])).pads[0]
    # Corners are rounded to a nanometre, 1 / 150 000 of the radius.
    assert pad.aperture.area == pytest.approx(np.pi * 0.15**2, rel=2e-5)
    assert shapely.Polygon(circle(1.0)).area == pytest.approx(np.pi, rel=1e-12)


def test_bare_surface_covers_the_board_exactly_once(plain: Print) -> None:
    built = surfaces(plain.layout, plain.stackup)
    assert set(built) == {"base", "mask", "pad"}
    vertices, faces, count = [], [], 0
    for surface in built.values():
        vertices.append(surface.vertices)
        faces.append(surface.faces + count)
        count += len(surface.vertices)
    mesh = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    mesh.merge_vertices(digits_vertex=7)
    up = mesh.face_normals[:, 2] > 0.5
    assert np.all(up | (np.abs(mesh.face_normals[:, 2]) < 1e-9))
    # Seen from above the board is covered once: vertical walls have no area in that view.
    assert mesh.area_faces[up].sum() == pytest.approx(40.0 * 32.0, rel=1e-9)
    heights = np.unique(mesh.vertices[:, 2].round(6))
    np.testing.assert_allclose(heights, [0.0, 0.025, 0.04])
    # Only the board's own rim is free; a crack between mask and pad would add edges inside it.
    edges = np.sort(mesh.edges, axis=1)
    kinds, counts = np.unique(edges, axis=0, return_counts=True)
    ends = mesh.vertices[kinds[counts == 1]]
    on_rim = (np.abs(np.abs(ends[..., 0]) - 20.0) < 1e-6) | (
        np.abs(np.abs(ends[..., 1]) - 16.0) < 1e-6
    )
    assert on_rim.all()


def test_legend_frames_parts_clear_of_their_pads() -> None:
    layout = artwork(board(FEW, legend={}))
    frames = shapely.get_parts(layout.legend)
    assert layout.legend.distance(layout.openings) > 0.1
    for pad in layout.pads:
        assert any(shapely.Polygon(frame.exterior).contains(pad.outline) for frame in frames)
    assert "legend" not in board(FEW).labels
    assert "legend" not in surfaces(layout, board(FEW).stackup())


def test_exposed_copper_carries_its_pads_id(plain: Print) -> None:
    surface = surfaces(plain.layout, plain.stackup)["pad"]
    centre = surface.vertices[surface.faces].mean(axis=1)
    for deposit in plain.deposits:
        if "EP" in deposit.pad.name:
            continue
        inside = shapely.contains_xy(deposit.pad.outline, centre[:, :2])
        assert inside.any()
        assert set(surface.pad[inside]) == {deposit.pad.id}


def only(truth: BoardTruth, base: BoardTruth, name: str) -> list[tuple[PadTruth, PadTruth]]:
    assert all(name in pad.defects for pad in truth.pads)
    return list(zip(truth.pads, base.pads, strict=True))


def test_missing_deposit_leaves_no_paste() -> None:
    print_, truth = with_defect("missing")
    assert all(d.field is None for d in print_.deposits)
    assert all(p.volume_mm3 == 0.0 and p.offset_x_mm is None for p in truth.pads)
    assert {p.defects for p in truth.pads} == {("missing",)}


@pytest.mark.parametrize(("name", "volume"), [("insufficient", 0.4), ("excess", 2.0)])
def test_volume_defect_changes_volume_alone(
    few_truth: BoardTruth, name: str, volume: float
) -> None:
    for bad, good in only(with_defect(name, volume=volume)[1], few_truth, name):
        assert bad.volume_mm3 == pytest.approx(volume * good.volume_mm3)
        assert bad.area_mm2 == pytest.approx(good.area_mm2)


@pytest.mark.parametrize(("name", "area"), [("low_area", 0.5), ("high_area", 1.6)])
def test_area_defect_keeps_volume(few_truth: BoardTruth, name: str, area: float) -> None:
    for bad, good in only(with_defect(name, area=area)[1], few_truth, name.replace("_", "-")):
        assert bad.area_mm2 == pytest.approx(area * good.area_mm2)
        assert bad.volume_mm3 == pytest.approx(good.volume_mm3)


def test_offset_defect_has_the_stated_direction_and_distance(few_truth: BoardTruth) -> None:
    settings = {"distance": 0.5, "direction_deg": 90.0, "rotation_deg": 0.0}
    for bad, good in only(with_defect("offset", **settings)[1], few_truth, "offset"):
        corners = shapely.get_coordinates(
            shapely.oriented_envelope(shapely.Polygon(good.aperture_mm))
        )
        shorter = np.linalg.norm(np.diff(corners, axis=0), axis=1).min()
        # A disk's enclosing rectangle depends on its corners: cos(pi / 64) = 0.9988.
        assert bad.offset_y_mm == pytest.approx(0.5 * shorter, rel=2e-3)
        assert bad.offset_x_mm == pytest.approx(0.0, abs=1e-9)


def test_peak_defect_is_higher_at_equal_volume(few_truth: BoardTruth) -> None:
    settings = {"height_mm": 0.1, "width_mm": 0.1}
    for bad, good in only(with_defect("peak", **settings)[1], few_truth, "peak"):
        assert bad.volume_mm3 == pytest.approx(good.volume_mm3)
        assert bad.peak_height_mm > good.peak_height_mm + 0.02


def test_smear_adds_a_thin_tail_in_its_direction() -> None:
    print_, truth = with_defect(
        "smear", direction_deg=0.0, length_mm=0.3, height_mm=0.04, width=0.5
    )
    for deposit, pad in zip(print_.deposits, truth.pads, strict=True):
        assert deposit.tail is not None
        reach = deposit.tail.xy_mm[:, 0].max() - deposit.footprint.bounds[2]
        assert reach <= 0.3 + 1e-9
        # Between nothing and a slab of full height; a tail thins to a third.
        assert 0.0 < pad.smear_volume_mm3 < 0.3 * 0.5 * min(pad.size_mm) * 0.04 * 1.5
        assert "smear" in pad.defects


def test_specks_are_as_far_from_their_aperture_as_asked_in_every_direction() -> None:
    """Half a side's length from the middle; 400 angles drawn evenly have a mean cosine and sine of 0 +- 0.035."""
    speck = Contamination.model_validate({"probability": 1.0, "distance": 0.5})
    rng = np.random.default_rng(2)
    at = np.array([_speck(speck, rng).at for _ in range(400)])
    np.testing.assert_allclose(np.hypot(*at.T), 0.5)
    assert np.abs(at.mean(axis=0)).max() < 0.5 * 4.0 * 0.035


def test_contamination_is_on_top_of_all_paste() -> None:
    """Of deposits, of smears beyond them, and of bridges between them."""
    strays = {name: {"probability": 1.0} for name in ("smear", "bridge")}
    speck = {"probability": 1.0, "radius_mm": 0.06, "height_mm": 0.05}
    print_ = printed(board(FEW, defects=strays | {"contamination": speck}))
    kinds = {
        "deposit": [d.field for d in print_.deposits],
        "smear": [d.tail for d in print_.deposits],
        "bridge": [b.field for b in print_.bridges],
    }
    met = dict.fromkeys(kinds, 0)
    for deposit in print_.deposits:
        assert deposit.speck is not None and "contamination" in deposit.defects.classes
        outline = shapely.Polygon(deposit.speck.xy_mm[deposit.speck.rims[0]])
        for kind, fields in kinds.items():
            for field in fields:
                if field is not None:
                    below = field.height_mm[shapely.contains_xy(outline, field.xy_mm)]
                    assert below.max(initial=0.0) < deposit.speck.height_mm.min()
                    met[kind] += len(below) > 0
    assert min(met.values()) > 2, met


@pytest.mark.parametrize("turn_deg", [0.0, 30.0])
def test_bridge_joins_neighbours(turn_deg: float) -> None:
    chip: dict[str, Any] = {"package": "chip", "size": "0201", "position_mm": [0.0, 0.0]}
    chips = [chip | {"rotation_deg": turn_deg}]
    paste = QUIET
    defects = {"bridge": {"probability": 1.0, "width_mm": 0.1, "height_mm": 0.06}}
    print_ = printed(board(chips, paste=paste, defects=defects))
    truth = truth_of(print_)
    (bridge,) = print_.bridges
    assert bridge.field is not None
    a, b = (d.footprint for d in print_.deposits)
    strip = shapely.Polygon(bridge.field.xy_mm[bridge.field.rims[0]])
    gap = 0.64 - 0.46
    # Across the gap it reaches a little into both deposits.
    cosine, sine = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    upright = bridge.field.xy_mm @ np.array([[cosine, -sine], [sine, cosine]])
    sides = np.sort(np.ptp(upright, axis=0))
    assert sides == pytest.approx([0.1, strip.area / 0.1], rel=1e-5)
    assert strip.intersection(a).area > 0 and strip.intersection(b).area > 0
    # Full height over its width but for two flanks of 0.03 mm, which hold between wall (0.3) and full height.
    full, thinnest = gap * 0.1 * 0.06, gap * (0.04 + 0.06 * 0.3) * 0.06
    assert thinnest < truth.bridges[0].volume_mm3 < full
    assert [p.bridged_to for p in truth.pads] == [(2,), (1,)]
    assert all(p.defects == ("bridge",) for p in truth.pads)


def test_bridges_are_where_their_pads_are_near() -> None:
    """Corners of a QFP, too, where pads at right angles gape."""
    bridge = {"probability": 1.0, "width_mm": 0.1, "longest_mm": 0.5}
    qfp = {
        "package": "qfp",
        "position_mm": [0, 0],
        "pins": 32,
        "row_mm": 5.2,
        "pad_mm": [1.0, 0.28],
    }
    for seed in range(5):
        print_ = printed(board([qfp], defects={"bridge": bridge}, seed=seed))
        lengths = [np.hypot(*np.subtract(*b.ends_mm)) for b in print_.bridges]
        assert len(lengths) == 28 + 4
        assert max(lengths) <= 0.5 + 1e-9


def test_every_use_of_random_numbers_has_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two uses of one stream would go together: all missing deposits would be narrow ones, say."""
    used: list[tuple[int, ...]] = []

    def generator(self: Board, *key: int) -> np.random.Generator:
        used.append(key)
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))

    monkeypatch.setattr(ParametricBoard, "generator", generator)
    defects = {"bridge": {"probability": 0.5}, "missing": {"probability": 0.2}}
    printed(board(FEW, defects=defects, seed=123))
    of_pads = [key for key in used if len(key) > 1]
    assert len(of_pads) > 100
    assert len(set(of_pads)) == len(of_pads)


def test_layers_and_print_of_a_board_do_not_go_together() -> None:
    thick = {"kind": "uniform", "low": 0.02, "high": 0.04}
    paste = QUIET | {"stencil_mm": {"kind": "uniform", "low": 0.1, "high": 0.2}}
    drawn = [
        printed(board(FEW[:1], layers={"copper_mm": thick}, paste=paste, seed=seed))
        for seed in range(3)
    ]
    copper = [(p.stackup.copper_mm - 0.02) / 0.02 for p in drawn]
    stencil = [(p.stencil_mm - 0.1) / 0.1 for p in drawn]
    assert max(abs(a - b) for a, b in zip(copper, stencil, strict=True)) > 1e-3


@pytest.mark.parametrize("defect", [Offset(), Smear(), Scratch()])
def test_faults_are_in_every_direction_where_none_is_given(
    defect: Offset | Smear | Scratch,
) -> None:
    assert value_range(defect.direction_deg) == (0.0, 360.0)


def test_sizes_left_out_are_those_of_the_scene_reference() -> None:
    """Other ones would change every board and texture that was published with its scene alone."""
    assert value_range(Scratch().width_mm) == (0.03, 0.12)
    assert Printed().grain_mm == 0.2


@pytest.mark.parametrize("inset_mm", [0.0, 0.02, 0.2])
def test_openings_of_a_bga_are_inside_its_smallest_pads(inset_mm: float) -> None:
    for land in Bga(position_mm=(0.0, 0.0), pad_mm=0.06).lands(inset_mm):
        assert land.openings[0].area > 0.0
        assert land.openings[0].difference(land.pad).area < 1e-12


def test_touching_deposits_are_a_bridge() -> None:
    chips = [{"package": "chip", "size": "0201", "position_mm": [0.0, 0.0]}]
    truth = truth_of(printed(board(chips, paste=QUIET | {"slump_mm": 0.1})))
    assert [b.pads for b in truth.bridges] == [(1, 2)]
    assert all("bridge" in pad.defects for pad in truth.pads)


def test_registration_moves_all_deposits_together() -> None:
    paste = QUIET | {"shift_x_mm": 0.05, "turn_deg": 1.0, "stretch": 0.002}
    truth = truth_of(printed(board(FEW, paste=paste)))
    angle = np.deg2rad(1.0)
    for pad in truth.pads:
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        turned = 1.002 * rotation @ [pad.x_mm, pad.y_mm]
        assert pad.offset_x_mm == pytest.approx(turned[0] + 0.05 - pad.x_mm, abs=1e-9)
        assert pad.offset_y_mm == pytest.approx(turned[1] - pad.y_mm, abs=1e-9)
    # Openings move and keep their sizes: what each holds is the same.
    plain = truth_of(printed(board(FEW)))
    assert [p.area_mm2 for p in truth.pads] == pytest.approx([p.area_mm2 for p in plain.pads])


def test_variation_follows_its_distribution() -> None:
    paste = QUIET | {
        "volume": {"kind": "truncated-normal", "mean": 1.0, "sd": 0.1, "low": 0.5, "high": 1.5},
        "offset_x_mm": {"kind": "normal", "mean": 0.0, "sd": 0.02},
    }
    pads = truth_of(printed(board(paste=paste))).pads
    transfer = board().paste.transfer
    volume = [
        p.volume_mm3 / (p.nominal_volume_mm3 * transfer.efficiency(p.area_ratio)) for p in pads
    ]
    offset = [p.offset_x_mm or 0.0 for p in pads]
    # Standard errors of mean and sd over 290 pads; five of them.
    n = len(pads)
    assert np.mean(volume) == pytest.approx(1.0, abs=5 * 0.1 / np.sqrt(n))
    assert np.std(volume) == pytest.approx(0.1, rel=5 / np.sqrt(2 * n))
    assert np.std(offset) == pytest.approx(0.02, rel=5 / np.sqrt(2 * n))


ROWS = ("area_ratio", "efficiency", "cv")
TABLE = [
    dict(zip(ROWS, row, strict=True))
    for row in ((0.45, 0.5, 0.25), (0.66, 0.85, 0.1), (1.5, 1.05, 0.05))
]


def spheres(
    diameter_mm: float, seed: int = 0, **transfer: Any
) -> list[tuple[tuple[float, float], float]]:
    """Place and transferred share of the 400 round openings of a BGA."""
    part = {"package": "bga", "position_mm": [0, 0], "columns": 20, "rows": 20}
    part |= {"pad_mm": diameter_mm, "pitch_mm": 1.0}
    paste = {"step_mm": 0.1, "transfer": transfer}
    pads = truth_of(printed(board([part], paste=paste, seed=seed))).pads
    return [((p.x_mm, p.y_mm), p.volume_mm3 / p.nominal_volume_mm3) for p in pads]


@pytest.mark.parametrize("table", [[], TABLE], ids=["published points", "own table"])
@pytest.mark.parametrize("ratio", [0.45, 0.55, 0.66, 1.0])
def test_volumes_have_the_stated_mean_and_spread(
    table: list[dict[str, float]], ratio: float
) -> None:
    # Round openings of area ratio d / 4 t.
    share = np.array([s for _, s in spheres(4 * 0.12 * ratio, table=table, neighbours=0.0)])
    if table:
        ratios, means, cvs = (np.array([row[name] for row in table]) for name in ROWS)
        mean, cv = np.interp(ratio, ratios, means), np.interp(ratio, ratios, cvs)
    else:
        mean = 1.0 - np.exp(-(ratio - 0.288) / 0.231)
        cv = np.hypot(0.05, np.sqrt((1.0 - mean) / (33.0 * mean)))
        assert (cv > 0.101) == (ratio < 0.66)
    # Five standard errors over 400 pads; those of a log-normal's spread are a little wider than a Gaussian's.
    assert share.mean() == pytest.approx(mean, rel=5 * cv / 20 + 1e-3)
    assert share.std() / share.mean() == pytest.approx(
        cv, abs=min(0.02, 6 * cv / np.sqrt(800) + 0.01 * cv)
    )


def test_field_that_neighbours_share_is_normal_and_correlated_as_stated() -> None:
    transfer, places = Transfer(reach_mm=2.0), ((0.0, 0.0), (1.0, 0.0), (0.0, 12.0))
    field = np.array(
        [
            [transfer.common(at, np.random.default_rng(seed)) for at in places]
            for seed in range(3000)
        ]
    )
    expected = np.exp(-((np.array([0.0, 1.0, 12.0]) / 2.0) ** 2) / 2.0)
    # Five standard errors of a product of unit normals over 3000 prints.
    assert (field[:, :1] * field).mean(axis=0) == pytest.approx(expected, abs=5 * np.sqrt(2 / 3000))
    assert field.mean(axis=0) == pytest.approx(0.0, abs=5 / np.sqrt(3000))


def test_volumes_of_neighbours_are_alike_where_they_share_all_their_variance() -> None:
    share = {tuple(np.round(at, 3)): s for at, s in spheres(0.3, neighbours=1.0)}
    grid = np.array([share[at] for at in sorted(share)]).reshape(20, 20)
    # exp(-1/50) at 1 mm of 5 mm; the sample's own mean and spread take a little of it.
    assert np.corrcoef(grid[1:].ravel(), grid[:-1].ravel())[0, 1] > 0.9


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, -30.0])
@pytest.mark.parametrize("stroke", ["x", "y"])
def test_long_openings_across_the_stroke_and_clogged_ones_transfer_less(
    stroke: str, turn_deg: float
) -> None:
    part = {"package": "qfp", "position_mm": [0, 0], "pins": 4, "row_mm": 4.0}
    part |= {"rotation_deg": turn_deg}
    part |= {"pad_mm": [1.2, 0.3], "pitch_mm": 1.0}

    def share(**transfer: Any) -> Any:
        paste = {"transfer": {"spread": 0.0} | transfer, "stroke": stroke}
        pads = truth_of(printed(board([part], paste=paste))).pads
        return np.array([pad.volume_mm3 / pad.nominal_volume_mm3 for pad in pads])

    plain = share()
    across = share(across=0.9) / plain
    # Pads of the left and right side are across a stroke along y. (1.2 - 0.3) / (1.2 + 0.3) of the effect; of slanted ones,
    # by what they measure across and along it.
    cosine, sine = np.cos(np.deg2rad(turn_deg)), abs(np.sin(np.deg2rad(turn_deg)))
    slant = 0.6 * (cosine - sine) / (cosine + sine)
    sides = [0.9**slant, 1.0] if stroke == "y" else [1.0, 0.9**slant]
    assert across == pytest.approx(sides * 2, rel=1e-6)
    assert share(clogging=0.1, prints_since_wipe=5) == pytest.approx(plain**1.5, rel=1e-6)
    assert share(clogging=0.1) == pytest.approx(plain)


def test_region_prints_the_same_deposits_as_the_whole_board() -> None:
    paste = QUIET | {"volume": {"kind": "uniform", "low": 0.8, "high": 1.2}, "roughness": 0.05}
    defects = {name: {"probability": 0.2} for name in ("offset", "peak", "bridge", "smear")}
    whole = printed(board(HUNDREDS[1:], paste=paste, defects=defects))
    region = {"centre_mm": [8.0, 4.0], "size_mm": [7.0, 7.0]}
    part = printed(board(HUNDREDS[1:], paste=paste, defects=defects, region=region))
    assert 0 < len(part.deposits) < len(whole.deposits)
    same = {d.pad.id: d for d in whole.deposits}
    for deposit in part.deposits:
        other = same[deposit.pad.id]
        assert deposit.defects == other.defects
        assert deposit.field is not None and other.field is not None
        np.testing.assert_allclose(
            deposit.field.xy_mm + np.array([8.0, 4.0]), other.field.xy_mm, atol=1e-9
        )
        np.testing.assert_array_equal(deposit.field.height_mm, other.field.height_mm)


@pytest.mark.parametrize(
    ("part", "pads", "across_mm", "pad_mm"),
    # KiCad's land patterns of LQFP-48 7x7 and QFN-32 5x5, pad to pad over all, and a grid of 8 x 8.
    [
        (Qfp(position_mm=(0.0, 0.0)), 48, 8.325 + 1.475, (1.475, 0.3)),
        (Qfn(position_mm=(0.0, 0.0)), 32, 4.875 + 0.875, (0.875, 0.25)),
        (Bga(position_mm=(0.0, 0.0)), 64, 7 * 0.5 + 0.3, (0.3, 0.3)),
    ],
)
def test_parts_are_common_ones_of_half_a_millimetre_pitch(
    part: Qfp | Qfn | Bga, pads: int, across_mm: float, pad_mm: tuple[float, float]
) -> None:
    lands = [land.pad for land in part.lands(0.0) if land.name != "EP"]
    assert len(lands) == pads
    centres = np.array([(pad.centroid.x, pad.centroid.y) for pad in lands])
    apart = np.linalg.norm(np.diff(centres[:3], axis=0), axis=1)
    np.testing.assert_allclose(apart, 0.5, atol=1e-9)
    x0, y0, x1, y1 = shapely.union_all(lands).bounds
    assert (x1 - x0, y1 - y0) == pytest.approx((across_mm, across_mm), abs=1e-3)
    x0, y0, x1, y1 = lands[0].bounds
    assert (x1 - x0, y1 - y0) == pytest.approx(pad_mm, abs=1e-3)


@pytest.mark.parametrize(
    ("size", "length_mm", "width_mm"),
    # Bodies by their metric codes: 0603, 1005, 1608, 2012, 3216.
    [
        ("0201", 0.6, 0.3),
        ("0402", 1.0, 0.5),
        ("0603", 1.6, 0.8),
        ("0805", 2.0, 1.25),
        ("1206", 3.2, 1.6),
    ],
)
def test_both_ends_of_a_chip_rest_on_its_pads(size: str, length_mm: float, width_mm: float) -> None:
    one, two = (land.pad.bounds for land in Chip(size=size, position_mm=(0.0, 0.0)).lands(0.0))
    # Solder rises at the ends; the gap is under the body, whose terminals are 0.15 mm long or longer.
    assert 0.1 < (two[2] - one[0] - length_mm) / 2 < 0.5
    assert 0.1 < two[0] - one[2] < length_mm - 0.3
    assert 0.05 < one[3] - one[1] - width_mm < 0.2


def test_a_millimetre_is_left_around_pads_by_number() -> None:
    layout = artwork(board(pads=[101]))
    (pad,) = (pad for pad in layout.pads if pad.id == 101)
    np.testing.assert_allclose(
        np.subtract(layout.box, pad.outline.bounds), (-1, -1, 1, 1), atol=1e-9
    )


def test_pads_by_number_are_in_the_middle() -> None:
    layout = artwork(board(pads=[101, 112], margin_mm=0.5))
    ids = [pad.id for pad in layout.pads]
    assert {101, 112} <= set(ids)
    ends = [pad.centre_mm for pad in layout.pads if pad.id in (101, 112)]
    np.testing.assert_allclose(layout.centre_mm, np.mean(ends, axis=0), atol=1e-9)
    with pytest.raises(SceneError, match="pad 999 does not exist"):
        artwork(board(pads=[999]))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ({"board.paste.material": "sodler"}, "unknown material 'sodler'"),
        ({"board.paste.volume": {"kind": "normal", "mean": 1, "sd": 1}}, "use truncated-normal"),
        ({"board.paste.stencil_mm": 120}, "0.02 to 0.5 is allowed"),
        ({"board.parts.0.pitch_mm": 0.2}, "pads touch"),
        ({"board.parts.2.pad_mm": 0.9}, "must be less than pitch_mm"),
        (
            {
                "board.paste.transfer.table": [
                    {"area_ratio": 0.7, "efficiency": 0.9},
                    {"area_ratio": 0.5, "efficiency": 0.6},
                ]
            },
            "must rise",
        ),
        ({"board.paste.sloop": 1}, "unknown key 'board.paste.sloop'"),
        ({"board.defects.bridge.probability": 2}, "board.defects.bridge.probability"),
        ({"board.pads": [1], "board.region": {"centre_mm": [0, 0], "size_mm": [1, 1]}}, "either"),
    ],
)
def test_impossible_board_is_refused(override: dict[str, object], message: str) -> None:
    with pytest.raises(SceneError) as caught:
        scenes.load("spi", override)
    assert message in str(caught.value)


def test_scene_without_objects_or_board_is_refused() -> None:
    text = scenes.source("step")
    bare = text[: text.index("[[objects]]")]
    with pytest.raises(SceneError, match="give objects, or a board"):
        scenes.parse(bare)
    with pytest.raises(SceneError, match="has no board"):
        scenes.board_truth(scenes.load("step"))


def test_triangles_carry_their_pads_id() -> None:
    scene = scenes.load("spi")
    parts = {part.label: part for part in scenes.parts(scene)}
    assert set(parts) <= set(scene.labels)
    paste = parts["paste"]
    assert paste.face_pad is not None and len(paste.face_pad) == len(paste.mesh.faces)
    truth = scenes.board_truth(scene)
    printed_pads = {pad.pad for pad in truth.pads if pad.volume_mm3 > 0}
    assert set(paste.face_pad) == printed_pads
    pad = next(p for p in truth.pads if not p.defects)
    triangles = paste.mesh.triangles[paste.face_pad == pad.pad]
    low, high = triangles.reshape(-1, 3).min(axis=0), triangles.reshape(-1, 3).max(axis=0)
    assert high[2] == pytest.approx(truth.pad_surface_mm + pad.peak_height_mm)
    assert low[0] < pad.x_mm < high[0] and low[1] < pad.y_mm < high[1]
    assert high[0] - low[0] < pad.size_mm[0] + 0.1


def test_hundreds_of_pads_are_printed_in_seconds() -> None:
    start = time.process_time()
    print_ = printed(board(paste={}))
    spent = time.process_time() - start
    assert len(print_.deposits) == 290
    # 10 um triangles; measured 0.6 s of processor time, and twice the 2 s aimed at is a fault anywhere.
    assert spent < 4.0


def test_truth_is_the_same_after_a_file_round_trip(tmp_path: Any, few_truth: BoardTruth) -> None:
    few_truth.write(tmp_path / "labels.json")
    assert BoardTruth.read(tmp_path / "labels.json") == few_truth


def test_files_from_before_masks_could_be_shifted_have_none(
    tmp_path: Path, few_truth: BoardTruth
) -> None:
    path = tmp_path / "labels.json"
    path.write_text(few_truth.model_dump_json(exclude={"mask_shift_mm", "damage"}))
    assert BoardTruth.read(path) == few_truth


def test_turned_rectangle_stays_about_its_centre() -> None:
    """A quarter turn exchanges its sides; 30 degrees turn its corner counter-clockwise."""
    upright = rectangle(3.0, -4.0, 2.0, 1.0, np.pi / 2)
    assert upright.bounds == pytest.approx((2.5, -5.0, 3.5, -3.0))
    turned = rectangle(3.0, -4.0, 2.0, 1.0, np.pi / 6)
    assert tuple(turned.centroid.coords[0]) == pytest.approx((3.0, -4.0))
    cos, sin = np.cos(np.pi / 6), np.sin(np.pi / 6)
    corner = shapely.Point(3.0 + cos * 1.0 - sin * 0.5, -4.0 + sin * 1.0 + cos * 0.5)
    assert turned.exterior.distance(corner) < 1e-12
    assert min(corner.distance(shapely.Point(p)) for p in turned.exterior.coords) < 1e-12


def test_the_board_of_the_page_is_valid() -> None:
    page = (Path(__file__).parents[3] / "docs" / "boards.md").read_text("utf-8")
    tree = tomllib.loads(page.partition("```toml\n")[2].partition("```")[0])
    found: Board = TypeAdapter(Board).validate_python(tree["board"])
    assert {"hole", "fiducial", "scratch", "residue", "legend"} <= set(found.labels)
