"""Contents of a data set, and reading it."""

import json
import pickle
from collections import Counter
from pathlib import Path

import numpy as np
import OpenEXR
import pyarrow.parquet as pq
import pytest
from pycocotools.coco import COCO

import fringebench
import render
import scenes
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.sample import Record
from fringebench.datasets.shards import write_shards
from scenes.support.errors import DatasetError

FILES = {"stack.exr", "truth.exr", "scene.toml", "labels.json", "picture.png"}


def test_every_sample_has_its_files_and_its_row(undisturbed: Path) -> None:
    rows = pq.read_table(undisturbed / "manifest.parquet").to_pylist()
    assert [row["index"] for row in rows] == list(range(6))
    for row in rows:
        assert row["status"] == "made"
        assert sorted(p.name for p in (undisturbed / row["folder"]).iterdir()) == sorted(FILES)
    assert not (undisturbed / "records").exists()
    assert not list(undisturbed.glob(".staging*"))
    for path in undisturbed.rglob("*.json"):
        json.loads(path.read_text(), parse_constant=pytest.fail)  # no NaN


def test_sample_is_what_its_scene_and_seeds_render(undisturbed: Path) -> None:
    sample = fringebench.Dataset(undisturbed)[3]
    transport = render.trace(sample.scene, seed=sample.labels["light_seed"])
    again = render.expose(transport, seed=sample.labels["noise_seed"])
    np.testing.assert_array_equal(again.frames, sample.frames)
    light = sample.scene.projectors[0]
    assert isinstance(light, scenes.PinholeProjector | scenes.TelecentricProjector)
    assert light.irradiance_w_m2 == pytest.approx(sample.drawn["projectors.0.irradiance_w_m2"])
    assert sample.board == scenes.board_truth(sample.scene)


def test_samples_differ_from_each_other(undisturbed: Path) -> None:
    samples = list(fringebench.Dataset(undisturbed))
    drawn = {sample.drawn["projectors.0.irradiance_w_m2"] for sample in samples}
    volumes = {_pads(sample)[0].volume_mm3 for sample in samples}
    assert len(drawn) == len(samples)
    # A missing deposit has volume 0 wherever it occurs; the others all differ.
    assert len(volumes) >= len(samples) - sum("missing" in _pads(s)[0].defects for s in samples)


def test_truth_and_frames_share_one_camera(undisturbed: Path) -> None:
    for sample in fringebench.Dataset(undisturbed):
        assert sample.frames.shape == (1, 6, 48, 64)
        assert sample.truth.height_mm.shape == (48, 64)
        assert sample.truth.labels == sample.scene.labels


def test_splits_are_disjoint_whole_and_in_order(undisturbed: Path) -> None:
    whole = [sample.index for sample in fringebench.Dataset(undisturbed)]
    parts = [
        [sample.index for sample in fringebench.Dataset(undisturbed, split=name)]
        for name in ("train", "val", "test")
    ]
    assert sorted(index for part in parts for index in part) == whole == list(range(6))
    assert all(part == sorted(part) for part in parts)


@pytest.mark.parametrize(
    "splits", [{"train": 0.8, "val": 0.1, "test": 0.1}, {"a": 0.37, "b": 0.63}]
)
def test_splits_take_their_stated_shares_exactly(
    plan: DatasetPlan, splits: dict[str, float]
) -> None:
    shared = plan.model_copy(update={"splits": splits, "variants": 1})
    seen: Counter[str] = Counter()
    for index in range(20_000):
        seen[shared.split_of(index)] += 1
        # Whatever the number of samples, no split is a whole one away from its share.
        assert all(abs(seen[name] - (index + 1) * share) < 1 for name, share in splits.items())


def test_sample_keeps_its_split_when_seed_or_count_change(plan: DatasetPlan) -> None:
    other = plan.model_copy(update={"seed": 99, "count": 1000})
    assert all(plan.split_of(i) == other.split_of(i) for i in range(200))


def _pads(sample: "fringebench.datasets.reader.Sample") -> "tuple[scenes.PadTruth, ...]":
    assert sample.board is not None
    return sample.board.pads


# pycocotools 2.0.11's masks do not know NumPy 2's copy keyword.
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_pycocotools_loads_every_split(undisturbed: Path) -> None:
    pads = 0
    for split in ("train", "val", "test"):
        coco = COCO(str(undisturbed / "coco" / f"{split}.json"))
        expected = list(fringebench.Dataset(undisturbed, split=split))
        assert sorted(coco.getImgIds()) == [sample.index + 1 for sample in expected]
        for sample in expected:
            (image,) = coco.loadImgs([sample.index + 1])
            assert (undisturbed / image["file_name"]).is_file()
            notes = coco.loadAnns(coco.getAnnIds(imgIds=[image["id"]]))
            assert {note["pad"] for note in notes} == {pad.pad for pad in _pads(sample)}
            for note in notes:
                # Polygons become masks of about their area: a rasterised outline errs by half a pixel along it.
                mask = coco.annToMask(note)
                assert mask.shape == (48, 64)
                reach = note["bbox"][2] + note["bbox"][3]
                assert abs(int(mask.sum()) - note["area"]) <= reach + 1
            pads += len(notes)
    assert pads == 6 * 4
    one = COCO(str(undisturbed / "samples" / "000002" / "labels.json"))
    assert one.getImgIds() == [3]


def test_plain_openexr_reads_the_files(undisturbed: Path) -> None:
    sample = fringebench.Dataset(undisturbed)[0]
    with OpenEXR.File(str(undisturbed / "samples/000000/stack.exr"), separate_channels=True) as f:
        plane = f.channels()["E00.F000"].pixels
    np.testing.assert_array_equal(plane.astype(np.uint16), sample.frames[0, 0])


def test_reader_can_be_pickled(undisturbed: Path) -> None:
    dataset = fringebench.Dataset(undisturbed, split="train", transform=_as_arrays)
    there = pickle.loads(pickle.dumps(dataset))
    assert len(there) == len(dataset) > 0
    np.testing.assert_array_equal(there[0]["frames"], dataset[0]["frames"])
    with pytest.raises(IndexError):
        dataset[len(dataset)]


def _as_arrays(sample: "fringebench.datasets.reader.Sample") -> dict[str, np.ndarray]:
    return {"frames": sample.frames.astype(np.float32), "height_mm": sample.truth.height_mm}


def test_set_that_a_run_has_yet_to_grow_is_refused(copy: Path) -> None:
    # A run writes the plan first and the manifest last; between the two the manifest lists the old samples.
    text = (copy / "dataset.toml").read_text()
    (copy / "dataset.toml").write_text(text.replace("count = 6", "count = 9"))
    for use in (fringebench.Dataset, write_shards):
        with pytest.raises(DatasetError, match="not finished"):
            use(copy)


def test_failed_samples_are_left_out(copy: Path) -> None:
    from fringebench.datasets.manifest import Manifest

    path = copy / "manifest.parquet"
    manifest = Manifest.of_bytes(path.read_bytes(), "")
    lost = Record(index=2, split=manifest.records[2].split, status="failed", reason="no light")
    records = (*manifest.records[:2], lost, *manifest.records[3:])
    path.write_bytes(Manifest(records, manifest.files).to_bytes())
    assert [sample.index for sample in fringebench.Dataset(copy)] == [0, 1, 3, 4, 5]


def test_reading_something_else_is_refused(tmp_path: Path, copy: Path) -> None:
    with pytest.raises(DatasetError, match="holds no data set"):
        fringebench.Dataset(tmp_path / "nowhere")
    with pytest.raises(DatasetError, match=r"no split 'tarin'.*did you mean 'train'"):
        fringebench.Dataset(copy, split="tarin")
    (copy / "samples/000001/truth.exr").unlink()
    with pytest.raises(DatasetError, match=r"000001/truth\.exr' is missing.*--repair"):
        _ = fringebench.Dataset(copy)[1].truth
    (copy / "manifest.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(DatasetError, match="damaged"):
        fringebench.Dataset(copy)
    (copy / "manifest.parquet").unlink()
    with pytest.raises(DatasetError, match="not finished"):
        fringebench.Dataset(copy)
