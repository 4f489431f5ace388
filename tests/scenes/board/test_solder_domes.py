"""Domes of hot-air levelled pads, against closed forms of surfaces under constant pressure; what is printed on them."""

from typing import Any

import numpy as np
import pytest
import shapely

import render
import scenes
from scenes.board.board import ParametricBoard
from scenes.board.board_solids import bodies
from scenes.board.extras.solder_domes import domes, on_domes
from scenes.board.printing import artwork, printed
from scenes.labels.pad_truth import truth_of
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import tessellate

# Round pads of 0.5 mm, 1 mm apart.
BALLS = {
    "package": "bga",
    "position_mm": [0, 0],
    "columns": 3,
    "rows": 3,
    "pitch_mm": 1.0,
    "pad_mm": 0.5,
}
QUIET = {"transfer": {"spread": 0.0}}
HEIGHT_MM = 0.02


def board(part: dict[str, Any], **layers: Any) -> ParametricBoard:
    tree = {"size_mm": [8.0, 8.0], "parts": [part], "layers": layers, "paste": QUIET}
    return ParametricBoard.model_validate(tree)


def test_dome_of_a_round_pad_is_a_paraboloid() -> None:
    of = board(BALLS, finish="hasl", dome_mm=HEIGHT_MM)
    made = domes(of, artwork(of))
    assert sorted(dome.pad for dome in made) == list(range(1, 10))
    for dome in made:
        middle = np.asarray(artwork(of).pads[dome.pad - 1].centre_mm)
        r = np.linalg.norm(dome.field.xy_mm - middle, axis=1)
        # The pad is a polygon of a circle's area, 0.08 % of R off it; triangles are R / 17 wide: (1 / 17)^2 / 4 = 0.1 %.
        assert np.allclose(
            dome.field.height_mm, HEIGHT_MM * (1 - (r / 0.25) ** 2), atol=5e-3 * HEIGHT_MM
        )
        volume = 0.5 * HEIGHT_MM * np.pi * 0.25**2
        assert dome.field.volume_mm3 == pytest.approx(volume, rel=5e-3)


def test_dome_of_a_rectangle_is_the_membrane_of_torsion() -> None:
    of = board({"package": "chip", "size": "1206", "position_mm": [0, 0]}, dome_mm=HEIGHT_MM)
    made = domes(of, artwork(of))
    assert len(made) == 2
    for dome in made:
        x, y = (dome.field.xy_mm - dome.origin_mm).T
        wide, high = np.ptp(x) / 2, np.ptp(y) / 2
        # Prandtl's series (Timoshenko and Goodier, Theory of Elasticity, art. 109), scaled to 1 in the middle.
        n = np.arange(1, 60, 2)[:, None]
        k, factor = n * np.pi / (2 * wide), (-1.0) ** ((n - 1) // 2) / n**3

        def series(x: Any, y: Any, k: Any = k, factor: Any = factor, high: float = high) -> Any:
            return (factor * (1 - np.cosh(k * y) / np.cosh(k * high)) * np.cos(k * x)).sum(axis=0)

        expected = HEIGHT_MM * series(x, y) / series(0.0, 0.0)
        assert np.allclose(dome.field.height_mm, expected, atol=5e-3 * HEIGHT_MM)


def test_paste_is_as_high_above_domes_as_above_flat_pads() -> None:
    flat, domed = board(BALLS), board(BALLS, dome_mm=HEIGHT_MM)
    assert truth_of(printed(flat)).pads == truth_of(printed(domed)).pads
    paste = [next(b for b in bodies(of) if b.label == "paste") for of in (flat, domed)]
    assert (paste[0].faces == paste[1].faces).all()
    x, y = paste[0].vertices[:, :2].T
    r = np.hypot(x - np.clip(np.rint(x), -1, 1), y - np.clip(np.rint(y), -1, 1))
    top = paste[0].vertices[:, 2] > 0.0
    rise = np.where(top, HEIGHT_MM * np.maximum(1 - (r / 0.25) ** 2, 0.0), 0.0)
    assert np.allclose(
        paste[1].vertices[:, 2] - paste[0].vertices[:, 2], rise, atol=5e-3 * HEIGHT_MM
    )


def test_paste_wider_than_its_pad_lies_on_the_dome_and_on_the_plane_around_it() -> None:
    of = board(BALLS, dome_mm=HEIGHT_MM)
    mesh = tessellate(shapely.box(-0.4, -0.4, 0.4, 0.4), 0.02)
    field = Heightfield(mesh.xy_mm, mesh.faces, mesh.rims, np.full(len(mesh.xy_mm), 0.1))
    r = np.hypot(*field.xy_mm.T)
    rise = HEIGHT_MM * np.maximum(1 - (r / 0.25) ** 2, 0.0)
    # As in the dome itself.
    np.testing.assert_allclose(on_domes(field, domes(of, artwork(of))), rise, atol=5e-3 * HEIGHT_MM)


def test_each_pad_of_a_hasl_board_has_a_dome_of_its_own_and_other_finishes_none() -> None:
    of = board(BALLS, finish="hasl")
    heights = {dome.height_mm for dome in domes(of, artwork(of))}
    assert len(heights) == 9 and 0.0 < min(heights) < max(heights) < 0.02
    for finish, dome_mm in (("enig", None), ("osp", None), ("tin", None), ("hasl", 0.0)):
        other = board(BALLS, finish=finish, dome_mm=dome_mm)
        assert domes(other, artwork(other)) == []


def test_pixels_of_bare_pads_are_as_high_as_the_dome() -> None:
    overrides = {
        "camera.resolution": [160, 120],
        "camera.field_width_mm": 4.0,
        "board": board(BALLS, dome_mm=HEIGHT_MM).model_dump(mode="json")
        | {"defects": {"missing": {"probability": 1.0}}},
    }
    maps = render.truth(scenes.load("spi", overrides))
    r = np.linalg.norm(maps.xyz_mm[..., :2] - np.rint(maps.xyz_mm[..., :2]), axis=-1)
    # A pixel of 25 um wholly on its pad.
    inner = maps.region("pad") & (r < 0.23)
    assert inner.sum() > 9 * 200
    assert maps.pad is not None and set(np.unique(maps.pad[inner])) == set(range(1, 10))
    height = 0.04 + HEIGHT_MM * (1 - (r[inner] / 0.25) ** 2)
    assert np.allclose(maps.height_mm[inner], height, atol=5e-3 * HEIGHT_MM)


def test_copper_at_a_hole_or_under_residue_stays_flat() -> None:
    drilled = {"drilled": [{"position_mm": [0.0, 0.0], "diameter_mm": 0.2}]}
    holed = board(BALLS, dome_mm=HEIGHT_MM).model_dump() | {"holes": drilled}
    of = ParametricBoard.model_validate(holed)
    assert sorted(d.pad for d in domes(of, printed(of).layout)) == [1, 2, 3, 4, 6, 7, 8, 9]
    spilt = {"residue": {"probability": 1.0, "distance": 0.0, "radius_mm": 0.2}}
    of = ParametricBoard.model_validate(holed | {"holes": None, "defects": spilt})
    assert domes(of, printed(of).layout) == []
