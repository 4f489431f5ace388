"""Truth of a board: which pad and which material every pixel sees."""

import numpy as np

import render
import scenes


def test_every_pixel_has_the_pad_and_material_it_sees() -> None:
    scene = scenes.load("spi", {"camera.resolution": [192, 144], "board.paste.step_mm": 0.03})
    truth, board = render.truth(scene), scenes.board_truth(scene)
    assert truth.pad is not None and truth.material is not None
    layers = dict(
        zip(scene.labels, ("laminate", "solder-mask-green", "gold", "solder-paste"), strict=False)
    )
    for label in ("base", "mask", "pad", "paste"):
        ids = np.unique(truth.material[truth.region(label)])
        assert [truth.materials[i - 1] for i in ids] == [layers[label]]
    assert not truth.pad[truth.region("mask")].any()
    assert truth.pad[truth.region("paste")].all()
    pixel_mm = 12.0 / 192
    for pad in board.pads:
        if pad.defects or pad.area_mm2 < 0.25:
            continue
        seen = truth.region("paste") & (truth.pad == pad.pad)
        # The camera is telecentric and looks straight down: a footprint's pixels differ from its area by their rim's.
        rim = 2 * sum(pad.size_mm)
        assert abs(seen.sum() * pixel_mm**2 - pad.area_mm2) < 0.5 * rim * pixel_mm
        x, y = truth.xyz_mm[seen][:, :2].mean(axis=0)
        assert (
            np.hypot(x - pad.x_mm - (pad.offset_x_mm or 0), y - pad.y_mm - (pad.offset_y_mm or 0))
            < pixel_mm / 2
        )
        # Heights are sampled on the same triangles the volume is integrated over; the rim's pixels are what is left.
        volume = (truth.xyz_mm[seen][:, 2] - board.pad_surface_mm).sum() * pixel_mm**2
        assert abs(volume - pad.volume_mm3) < 0.5 * rim * pixel_mm * pad.peak_height_mm


def test_scene_without_a_board_has_no_pads() -> None:
    truth = render.truth(scenes.load("step", {"camera.resolution": [64, 48]}))
    assert truth.pad is None
    assert truth.materials == ("grey-paint",)
