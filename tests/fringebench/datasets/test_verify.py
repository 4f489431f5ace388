"""Damage is found, reported and repaired; nothing else is changed."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fringebench.datasets.building import build, repair
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.verification import verify
from scenes.support.errors import DatasetError

pytestmark = pytest.mark.usefixtures("here")
Checksums = Callable[[Path], dict[str, str]]


def test_undisturbed_set_has_no_problems(undisturbed: Path) -> None:
    assert verify(undisturbed) == ()


def test_every_kind_of_damage_is_found_and_repaired(
    copy: Path, undisturbed: Path, checksums: Checksums
) -> None:
    samples = copy / "samples"
    (samples / "000000/truth.exr").unlink()
    flipped = bytearray((samples / "000001/stack.exr").read_bytes())
    flipped[len(flipped) // 2] ^= 1
    (samples / "000001/stack.exr").write_bytes(bytes(flipped))
    for path in (samples / "000002").iterdir():
        path.unlink()
    (samples / "000002").rmdir()
    (samples / "000003/notes.txt").write_text("mine")
    # The set's samples are numbered from 0: its count is no number of a sample.
    beyond = f"{len(list(samples.iterdir())) + 1:06d}"
    (samples / "stray").mkdir()
    (samples / beyond).mkdir()
    (copy / "coco/val.json").write_text("{}")
    untouched = (samples / "000004/stack.exr").stat().st_mtime_ns
    found = {(p.file, p.what) for p in verify(copy)}
    assert found == {
        ("samples/000000/truth.exr", "missing"),
        ("samples/000001/stack.exr", "altered"),
        *((f"samples/000002/{n}", "missing") for n in ("stack.exr", "truth.exr")),
        *((f"samples/000002/{n}", "missing") for n in ("scene.toml", "labels.json", "picture.png")),
        ("samples/000003/notes.txt", "surplus"),
        ("samples/stray", "surplus"),
        (f"samples/{beyond}", "surplus"),
        ("coco/val.json", "altered"),
    }
    done = repair(copy)
    assert {(p.file, p.what) for p in done.problems} == found
    assert done.repaired == (0, 1, 2)
    assert done.differing == ()
    assert checksums(copy) == checksums(undisturbed)
    assert (samples / "000004/stack.exr").stat().st_mtime_ns == untouched


@pytest.mark.parametrize("damage", ["missing", "damaged"])
def test_lost_manifest_is_made_again(
    copy: Path, undisturbed: Path, checksums: Checksums, damage: str
) -> None:
    if damage == "missing":
        (copy / "manifest.parquet").unlink()
    else:
        content = bytearray((copy / "manifest.parquet").read_bytes())
        content[100] ^= 0xFF
        (copy / "manifest.parquet").write_bytes(bytes(content))
    assert ("manifest.parquet", damage) in {(p.file, p.what) for p in verify(copy)}
    repair(copy)
    assert checksums(copy) == checksums(undisturbed)


@pytest.mark.parametrize("step", [12, pytest.param(1, marks=pytest.mark.slow)])
def test_any_changed_byte_of_the_manifest_is_detected(copy: Path, step: int) -> None:
    from fringebench.datasets.manifest import Manifest

    content = (copy / "manifest.parquet").read_bytes()
    rng = np.random.default_rng(0)
    for place in range(0, len(content), step):
        changed = bytearray(content)
        changed[place] ^= int(rng.integers(1, 256))
        with pytest.raises(DatasetError, match="damaged"):
            Manifest.of_bytes(bytes(changed), "")


def test_sample_that_differs_from_the_manifest_is_reported_and_kept(copy: Path) -> None:
    from fringebench.datasets.contents import read_manifest
    from fringebench.datasets.manifest import Manifest
    from fringebench.datasets.store import open_store

    # As on another kind of machine: the manifest states other bytes than are made here.
    manifest = read_manifest(open_store(copy))
    assert manifest is not None
    record = manifest.records[1]
    stack = record.files["stack.exr"].model_copy(update={"sha256": "0" * 64})
    other = record.model_copy(update={"files": record.files | {"stack.exr": stack}})
    records = (manifest.records[0], other, *manifest.records[2:])
    (copy / "manifest.parquet").write_bytes(Manifest(records, manifest.files).to_bytes())
    before = (copy / "samples/000001/stack.exr").read_bytes()
    assert repair(copy).differing == (1,)
    assert (copy / "samples/000001/stack.exr").read_bytes() == before
    assert [p.index for p in verify(copy)] == [1]


def test_altered_plan_is_not_repaired_from(copy: Path) -> None:
    text = (copy / "dataset.toml").read_text()
    (copy / "dataset.toml").write_text(text.replace("seed = 7", "seed = 8", 1))
    (copy / "samples/000001/stack.exr").unlink()
    assert ("dataset.toml", "altered") in {(p.file, p.what) for p in verify(copy)}
    with pytest.raises(DatasetError, match="altered since"):
        repair(copy)


def test_another_scene_seed_or_split_never_mixes_into_a_set(plan: DatasetPlan, copy: Path) -> None:
    scene = json.loads(json.dumps(plan.scene))
    scene["board"]["paste"]["volume"]["sd"] = 0.2
    for change, message in (
        ({"scene": scene}, r"another scene \(they differ in board.paste.volume.sd\)"),
        ({"seed": 8}, "seed 7, not 8"),
        ({"splits": {"all": 1.0}}, "splits"),
        ({"count": 3}, "grow, not shrink"),
    ):
        with pytest.raises(DatasetError, match=message):
            build(plan.model_copy(update=change), copy)
    assert verify(copy) == ()


def test_other_versions_cannot_continue_a_set(plan: DatasetPlan, copy: Path) -> None:
    from fringebench.datasets import building

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(building, "made_with", lambda: {"mitsuba": "2.0"})
        with pytest.raises(DatasetError, match=r"made with fringebench .* here is none"):
            build(plan.model_copy(update={"count": 9}), copy)
    assert verify(copy) == ()
