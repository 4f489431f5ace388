"""Samples that share one light, shards of whole samples, and the data card."""

import io
import json
import tarfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import render
from evaluation.output.report import Grid
from fringebench.datasets.building import build
from fringebench.datasets.data_card import _volumes, card_sections, write_card
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.pictures import srgb
from fringebench.datasets.reader import Dataset
from fringebench.datasets.sample import attempt
from fringebench.datasets.shards import write_shards
from fringebench.datasets.verification import verify


@pytest.fixture(scope="module")
def varied(plan: DatasetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four samples of two lights, with colour pictures."""
    where = tmp_path_factory.mktemp("varied") / "set"
    noise = {"kind": "uniform", "low": 1.0, "high": 9.0}
    scene = plan.scene | {"randomise": {"sensor.read_noise_e": noise}}
    asked = {"variants": 2, "count": 4, "scene": scene, "ring_light": True, "modulation": True}
    build(plan.model_copy(update=asked), where)
    return where


def test_colour_picture_is_the_scene_under_ring_lights(varied: Path) -> None:
    sample = Dataset(varied)[1]
    linear = render.ring_light_picture(sample.scene, sample.labels["light_seed"])
    np.testing.assert_array_equal(sample.colour, srgb(linear))
    assert [ring["colour"] for ring in sample.labels["rings"]] == ["red", "green", "blue"]
    # The green mask covers most of the board.
    _red, green, blue = (int(np.median(channel)) for channel in np.moveaxis(sample.colour, 2, 0))
    assert green > blue
    assert len({s.record.files["colour.png"] for s in Dataset(varied)}) == 2


def test_variants_share_light_and_split_and_differ_in_noise(varied: Path, tmp_path: Path) -> None:
    found = Dataset(varied)
    assert [s.labels["light_index"] for s in found] == [0, 0, 1, 1]
    assert len({s.drawn["sensor.read_noise_e"] for s in found}) == 4
    for one, two in ((found[0], found[1]), (found[2], found[3])):
        assert one.split == two.split
        assert one.record.files["truth.exr"] == two.record.files["truth.exr"]
        assert one.board == two.board
        assert not np.array_equal(one.frames, two.frames)
        assert one.scene.sensor != two.scene.sensor
        assert two.stack.sensor == two.scene.sensor
    assert found[0].board != found[2].board
    # A variant made alone is the same.
    made = attempt(found.plan, found.plan.load_scene(), 3, tmp_path)
    assert made == found.records[3]


def test_shards_hold_the_samples_files_in_order(varied: Path) -> None:
    shards = write_shards(varied, samples=1)
    assert sum(shards.values()) == 4
    first = {name: (varied / name).read_bytes() for name in shards}
    keys = []
    for name in shards:
        split = Path(name).name.split("-")[0]
        with tarfile.open(varied / name) as shard:
            for entry in shard:
                key, field = entry.name.split(".", 1)
                original = varied / "samples" / key / field.replace("labels.txt", "labels.json")
                content = shard.extractfile(entry)
                assert content is not None
                assert content.read() == original.read_bytes()
                keys.append((split, key))
    assert set(keys) == {
        (record.split, f"{record.index:06d}") for record in Dataset(varied).records
    }
    assert write_shards(varied, samples=1).keys() == first.keys()
    assert all((varied / name).read_bytes() == content for name, content in first.items())
    assert verify(varied) == ()


def test_hugging_face_reads_the_shards_by_the_card(
    varied: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    datasets = pytest.importorskip("datasets")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    write_shards(varied)
    write_card(varied)
    found = datasets.load_dataset(str(varied), cache_dir=str(tmp_path))
    for split, rows in found.items():
        for row, sample in zip(rows, Dataset(varied, split=split), strict=True):
            np.testing.assert_array_equal(np.asarray(row["picture.png"]), sample.picture)
            np.testing.assert_array_equal(np.asarray(row["colour.png"]), sample.colour)
            step_dn = sample.labels["modulation_png"]["step_dn"]
            numbers = np.asarray(row["modulation.png"])
            np.testing.assert_array_equal(numbers * step_dn, sample.modulation_dn)
            assert json.loads(row["labels.txt"]) == sample.labels


# The library leaves closing its shards to the collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_webdataset_reads_pictures_as_they_are_stored(varied: Path) -> None:
    webdataset = pytest.importorskip("webdataset")
    # As the how-to has it: webdataset's own decoders of pictures keep 8 bits.
    as_stored = webdataset.handle_extension(
        "png", lambda png: np.asarray(Image.open(io.BytesIO(png)))
    )
    for name in write_shards(varied):
        split = Path(name).name.split("-")[0]
        rows = webdataset.WebDataset(str(varied / name), shardshuffle=False).decode(as_stored)
        for row, sample in zip(rows, Dataset(varied, split=split), strict=True):
            np.testing.assert_array_equal(row["picture.png"], sample.picture)
            np.testing.assert_array_equal(row["colour.png"], sample.colour)
            step_dn = sample.labels["modulation_png"]["step_dn"]
            assert row["modulation.png"].max() > 255
            np.testing.assert_array_equal(row["modulation.png"] * step_dn, sample.modulation_dn)
            assert json.loads(row["labels.txt"]) == sample.labels


def test_card_gives_mean_and_coefficient_of_variation_by_area_ratio() -> None:
    # Area ratio, volume in per cent.
    pads = np.array(
        [(0.4, 40.0), (0.49, 60.0), (0.5, 80.0), (5.0, 100.0), (6.0, 90.0), (7.0, 110.0)]
    )
    rows = [row[1:] for row in _volumes(pads).rows]
    assert rows == [
        ["2", "50.0", "20.0"],
        ["1", "80.0", "0.0"],
        ["3", "100.0", f"{np.sqrt(200 / 3):.1f}"],
    ]


def test_card_counts_a_pad_without_defect_once_for_each_light(
    undisturbed: Path, varied: Path
) -> None:
    for where, variants in ((undisturbed, 1), (varied, 2)):
        found = Dataset(where)
        pads = [len([p for p in s.labels["board"]["pads"] if not p["defects"]]) for s in found]
        (volumes,) = (s.blocks for s in card_sections(found) if s.title == "Volumes")
        assert isinstance(volumes[0], Grid)
        assert sum(int(row[1]) for row in volumes[0].rows) == sum(pads) / variants > 0


def test_card_counts_what_the_labels_hold(varied: Path) -> None:
    write_shards(varied)
    write_card(varied)
    text = (varied / "README.md").read_text()
    notes = [note for s in Dataset(varied) for note in s.labels["annotations"]]
    good = [line for line in text.splitlines() if line.startswith("| good ")]
    counts = [int(cell) for cell in good[0].split("|")[3:-1]]
    assert sum(counts) == sum(note["category_id"] == 1 for note in notes) > 0
    assert "sensor.read_noise_e" in text
    assert "read_noise_e 2.5" in text
    step_dn = Dataset(varied)[0].labels["modulation_png"]["step_dn"]
    assert (
        f"| modulation.png | modulation_dn = {step_dn:g} * number, at the shortest exposure; "
        in text
    )
    front = text.split("---")[1]
    for split in {record.split for record in Dataset(varied).records}:
        assert f"path: webdataset/{split}-*.tar" in front
    assert json.dumps({"kind": "uniform", "low": 1.0, "high": 9.0}) in text
