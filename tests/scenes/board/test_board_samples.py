"""Samples of a data set, and their COCO labels."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import scenes
from scenes.labels.coco_format import CATEGORIES
from scenes.support.errors import SceneError

CAMERA = {"camera.resolution": [160, 120], "board.paste.step_mm": 0.04}
RANDOM: dict[str, Any] = {
    "randomise": {
        "sensor.read_noise_e": {"kind": "uniform", "low": 1.0, "high": 6.0},
        "projectors.0.irradiance_w_m2": {"kind": "lognormal", "median": 100.0, "sigma": 0.2},
        "patterns.periods_px": {"kind": "choice", "values": [[16.0, 128.0], [20.0, 160.0]]},
        "board.layers.mask_material": {
            "kind": "choice",
            "values": ["solder-mask-green", "black-ink"],
        },
    }
}


def spi(**overrides: Any) -> scenes.Scene:
    return scenes.load("spi", CAMERA | RANDOM | overrides)


def test_sample_depends_on_seed_and_index_alone() -> None:
    scene = spi()
    forward = [scenes.realise(scene, i, seed=3) for i in range(6)]
    backward = [scenes.realise(spi(), i, seed=3) for i in reversed(range(6))]
    assert forward == backward[::-1]
    seeds = {s.board.seed for s in forward if s.board}
    noises = {s.sensor.model_dump()["read_noise_e"] for s in forward}
    assert len(seeds) == len(noises) == 6
    assert scenes.realise(scene, 0, seed=4) != forward[0]


def test_sample_is_the_same_after_a_toml_round_trip() -> None:
    sample = scenes.realise(spi(), 2)
    assert sample.randomise == {}
    again = scenes.parse(scenes.dumps(sample))
    assert again == sample
    for label, mesh in scenes.meshes(sample).items():
        other = scenes.meshes(again)[label]
        np.testing.assert_array_equal(mesh.vertices, other.vertices)
        np.testing.assert_array_equal(mesh.faces, other.faces)
    assert scenes.board_truth(again) == scenes.board_truth(sample)


def test_randomised_keys_draw_independently() -> None:
    few = {"randomise": {"sensor.read_noise_e": RANDOM["randomise"]["sensor.read_noise_e"]}}
    one, all_ = (scenes.realise(spi(**extra), 1) for extra in (few, {}))
    assert one.sensor == all_.sensor
    assert one.board is not None and all_.board is not None
    assert one.board.seed == all_.board.seed


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            '"sensor.raed_noise_e" = { kind = "constant", value = 1 }',
            "unknown key 'sensor.raed_noise_e': did you mean 'read_noise_e'?",
        ),
        (
            '"camera.resolution.7" = { kind = "constant", value = 1 }',
            "key 'camera.resolution.7': '7' is not an index into a list of 2: use 0 to 1",
        ),
        ('"name.x" = { kind = "constant", value = 1 }', "'name' is a value, not a table"),
        (
            '"camera.resolution.0" = { kind = "uniform", low = 100.5, high = 200 }',
            "camera.resolution.0: Input should be a valid integer",
        ),
        (
            '"sensor.read_noise_e" = { kind = "choice", values = ["much"] }',
            "sensor.read_noise_e: Input should be a valid number",
        ),
    ],
)
def test_unknown_randomised_key_is_refused_on_load(line: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    text = scenes.source("spi") + f"\n[randomise]\n{line}\n"
    file.write_text(text)
    with pytest.raises(SceneError) as caught:
        scenes.load(file)
    assert str(caught.value).startswith(f"{file}:{len(text.splitlines())}: randomise: ")
    assert message in str(caught.value)


def test_drawn_value_out_of_range_is_refused() -> None:
    # In range or not is decided for each sample: a normal distribution reaches everywhere.
    scene = spi(randomise={"sensor.read_noise_e": {"kind": "constant", "value": -1}})
    with pytest.raises(SceneError, match="greater than or equal to 0"):
        scenes.realise(scene, 5)


def test_negative_index_is_refused() -> None:
    with pytest.raises(SceneError, match="count from 0"):
        scenes.realise(spi(), -1)


def test_outlines_cover_their_pads_in_the_image() -> None:
    scene = spi(**{"board.defects": {}})
    truth, notes = scenes.board_truth(scene), scenes.coco(scene, "0.png")["annotations"]
    camera = scene.camera.projection()
    inside = [p for p in truth.pads if abs(p.x_mm) < 5.2 and abs(p.y_mm) < 3.8]
    found = {note["pad"]: note for note in notes}
    for pad in inside:
        place = np.array(
            [pad.x_mm + (pad.offset_x_mm or 0), pad.y_mm + (pad.offset_y_mm or 0), 0.04]
        )
        pixel, _ = camera.project(place)
        x, y, width, height = found[pad.pad]["bbox"]
        # Half a pixel: the centre of volume is not quite the middle of the outline.
        np.testing.assert_allclose([x + width / 2, y + height / 2], pixel, atol=0.5)
        pixel_mm = 12.0 / 160
        assert found[pad.pad]["area"] * pixel_mm**2 == pytest.approx(pad.area_mm2, rel=0.01)
    assert all(note["category_id"] == 1 for note in notes)


def test_every_defect_has_its_own_annotation() -> None:
    for name in ("missing", "smear", "contamination", "bridge"):
        scene = spi(**{"board.defects": {name: {"probability": 1.0}}})
        names = {
            CATEGORIES[n["category_id"] - 1] for n in scenes.coco(scene, "0.png")["annotations"]
        }
        assert name in names
