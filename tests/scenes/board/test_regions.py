"""Regions drawn for each sample, and pads that a region's edge cuts."""

from typing import Any

import numpy as np
import pytest
import shapely

import render
import scenes
from scenes.board.board import ParametricBoard
from scenes.board.printing import artwork, printed
from scenes.labels.coco_format import CATEGORIES, IGNORE
from scenes.support.errors import SceneError

PARTS: list[dict[str, Any]] = [
    {"package": "qfn", "name": "U1", "position_mm": [-6.0, 3.0]},
    {"package": "bga", "name": "U2", "position_mm": [6.0, -3.0], "columns": 6, "rows": 6},
    *(
        {"package": "chip", "size": "0402", "name": f"R{i}", "position_mm": [-9.0 + 3.0 * i, -6.0]}
        for i in range(7)
    ),
]
SIZE = (24.0, 16.0)


def board(**settings: Any) -> ParametricBoard:
    return ParametricBoard.model_validate(
        {"parts": PARTS, "size_mm": SIZE, "paste": {"step_mm": 0.05}, **settings}
    )


def test_each_seed_shows_another_region_with_pads_on_the_board() -> None:
    boxes = []
    shown: set[str] = set()
    for seed in range(40):
        layout = artwork(board(seed=seed, region={"size_mm": [6.0, 4.0]}))
        x0, y0, x1, y1 = layout.box
        assert (x1 - x0, y1 - y0) == pytest.approx((6.0, 4.0))
        assert x0 >= -12.0 - 1e-9 and x1 <= 12.0 + 1e-9 and y0 >= -8.0 - 1e-9 and y1 <= 8.0 + 1e-9
        assert layout.pads
        assert layout.board.area == pytest.approx(24.0)
        boxes.append(layout.box)
        shown |= {pad.name.split("-")[0] for pad in layout.pads}
    assert len(set(boxes)) == 40
    # Each of 82 pads is as likely to be the one that must be shown: 40 draws miss the 68 of the two large parts never.
    assert {"U1", "U2"} <= shown
    assert any(name.startswith("R") for name in shown)
    again = artwork(board(seed=3, region={"size_mm": [6.0, 4.0]}))
    assert again.box == boxes[3]


def test_region_larger_than_the_board_is_centred_on_a_pad() -> None:
    layout = artwork(board(region={"size_mm": [60.0, 60.0]}))
    assert layout.board.area <= SIZE[0] * SIZE[1] + 1e-9
    assert layout.pads


def test_region_too_small_for_any_pad_is_refused() -> None:
    with pytest.raises(SceneError, match="holds none of the"):
        artwork(board(region={"size_mm": [0.1, 0.1]}))


def test_samples_of_a_scene_show_different_regions() -> None:
    scene = scenes.load("spi", {"board.region": {"size_mm": [6.0, 4.0]}})
    samples = [scenes.realise(scene, i) for i in range(3)]
    origins = {scenes.board_truth(sample).origin_mm for sample in samples}
    assert len(origins) == 3
    assert scenes.parse(scenes.dumps(samples[1])) == samples[1]


def test_cut_pads_are_not_printed_and_named() -> None:
    cutting = board(region={"centre_mm": [-6.0, 3.0], "size_mm": [5.3, 3.0]})
    layout = artwork(cutting)
    whole = artwork(board())
    frame = shapely.box(*layout.box)
    expected = {
        pad.id
        for pad in whole.pads
        if pad.outline.intersects(frame) and not frame.contains(pad.outline)
    }
    assert {pad.id for pad in layout.cut} == expected
    assert not expected & {deposit.pad.id for deposit in printed(cutting).deposits}


def test_all_bare_copper_in_view_is_a_pad_or_ignored() -> None:
    """What looks like a missing deposit either is one, or carries the label *ignore*."""
    scene = scenes.load(
        "spi",
        {
            "board.parts": PARTS,
            "board.size_mm": list(SIZE),
            "board.defects": {"missing": {"probability": 0.5}},
            "board.region": {"centre_mm": [-6.0, 3.0], "size_mm": [5.3, 3.0]},
            "camera.resolution": [530, 300],
            "camera.field_width_mm": 5.3,
        },
    )
    truth = render.truth(scene)
    notes = scenes.coco(scene, "picture.png")["annotations"]
    ignored = np.zeros(truth.label.shape, bool)
    for note in notes:
        is_ignore = CATEGORIES[note["category_id"] - 1] == IGNORE
        assert note["iscrowd"] == is_ignore
        if is_ignore:
            assert note["pad"] in scenes.board_truth(scene).cut
            ignored |= decoded(note["segmentation"])
    assert truth.pad is not None
    copper = truth.region("pad")
    unexplained = copper & (truth.pad == 0) & ~ignored
    # A thermal pad printed in panes belongs to several; its copper between them is printed around, not bare by fault.
    assert scene.board is not None
    layout = artwork(scene.board)
    panes = shapely.union_all([pad.outline for pad in layout.pads if "EP" in pad.name])
    x, y = layout.centre_mm
    near_panes = shapely.transform(panes.convex_hull.buffer(0.4), lambda xy: xy - [x, y])
    outside = unexplained & ~shapely.contains_xy(
        near_panes, truth.xyz_mm[..., 0].ravel(), truth.xyz_mm[..., 1].ravel()
    ).reshape(copper.shape)
    assert (copper & ignored).sum() > 1000
    # Pixels on an outline belong to one side or the other.
    assert outside.sum() < 0.02 * copper.sum()


def decoded(coded: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """The (row, col) mask of run lengths."""
    runs = np.repeat(np.arange(len(coded["counts"])) % 2, coded["counts"])
    return runs.reshape(coded["size"], order="F").astype(bool)
