"""What other programs read: pictures, measured heights, and COCO masks over them."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from pycocotools.coco import COCO

import decode
import fringebench
import render
import scenes
from evaluation.output.height_image import HeightCode
from fringebench.datasets.building import build
from fringebench.datasets.dataset_plan import DatasetPlan
from fringebench.datasets.pictures import camera_picture, modulation_picture
from fringebench.datasets.verification import verify
from scenes.board.defects import CLASSES
from scenes.labels.coco_format import CATEGORIES, run_lengths
from scenes.support.errors import DatasetError

GERBER = """%FSLAX46Y46*%
%MOMM*%
%LPD*%
%ADD10C,0.9X0.4*%
%ADD11R,0.8X0.5*%
D10*
X-600000Y0D03*
D11*
X600000Y0D03*
M02*
"""


@pytest.fixture(scope="module")
def measured_set(plan: DatasetPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two samples with all that is measured."""
    folder = tmp_path_factory.mktemp("measured") / "set"
    asked = dict.fromkeys(("heights", "modulation", "height_tiff"), True)
    build(plan.model_copy(update={"count": 2, **asked}), folder)
    return folder


def test_picture_is_eight_bits_of_the_cameras_view(undisturbed: Path) -> None:
    for sample in fringebench.Dataset(undisturbed):
        with Image.open(undisturbed / sample.record.folder / "picture.png") as image:
            assert (image.mode, image.size) == ("L", (64, 48))
            picture = np.asarray(image)
        np.testing.assert_array_equal(picture, sample.picture)
        np.testing.assert_array_equal(picture, camera_picture(sample.stack))
        # Fringes cancel: the mean over all phases is the light without fringes, and brighter light is brighter.
        mean = sample.frames[0].mean(axis=0)
        order = np.argsort(mean.ravel())
        assert (np.diff(picture.ravel()[order].astype(int)) >= 0).all()


def test_picture_is_black_at_the_black_level_and_white_at_saturation() -> None:
    sensor = scenes.Emva(bits=12, black_level_dn=64.0)
    shown = scenes.PhaseShift(steps=4, periods_px=(16.0,)).frames()
    frames = np.full((1, 4, 1, 3), 64, np.uint16)
    stack = scenes.Stack(frames, shown, (1.0,), sensor)
    white = round(stack.saturation_dn)
    frames[..., 1], frames[..., 2] = white, 64 + round(0.2140 * (white - 64))
    # sRGB gives half of 255 to 21.4 % of the light (IEC 61966-2-1).
    np.testing.assert_allclose(camera_picture(stack), [[0, 255, 127.5]], atol=1)


def test_height_picture_is_the_reconstruction_within_half_a_step(measured_set: Path) -> None:
    assert verify(measured_set) == ()
    for sample in fringebench.Dataset(measured_set):
        stated = dict(sample.labels["height_png"])
        assert stated.pop("no_height") == 0
        code = HeightCode(**stated)
        with Image.open(measured_set / sample.record.folder / "height.png") as image:
            number = np.asarray(image)
        assert number.dtype == np.uint16
        found = sample.reconstruction
        again = decode.reconstruct(sample.stack)
        np.testing.assert_array_equal(found.height_mm, again.height_mm)
        low, high = sample.scene.height_range_mm
        inside = found.valid & (found.height_mm >= low) & (found.height_mm <= high)
        assert inside.mean() > 0.5
        np.testing.assert_array_equal(number > 0, inside)
        # float32 heights of half a millimetre are exact to 3e-8 mm.
        error = np.abs(code.offset_mm + code.step_mm * number - found.height_mm)[inside]
        assert error.max() <= code.step_mm / 2 + 1e-7


def test_height_tiff_is_the_reconstruction_in_millimetres(measured_set: Path) -> None:
    for sample in fringebench.Dataset(measured_set):
        with Image.open(measured_set / sample.record.folder / "height.tiff") as image:
            assert (image.mode, image.size) == ("F", (64, 48))
            height_mm = np.asarray(image)
        found = sample.reconstruction
        np.testing.assert_array_equal(np.isfinite(height_mm), found.valid)
        np.testing.assert_array_equal(height_mm[found.valid], found.height_mm[found.valid])


def test_modulation_picture_is_the_measured_amplitude_within_half_a_step(
    measured_set: Path,
) -> None:
    for sample in fringebench.Dataset(measured_set):
        stated = sample.labels["modulation_png"]
        # A sensor of 12 bits: 65536 numbers for 4096 DN.
        once = sample.stack.exposure_ms[0]
        assert stated == {"step_dn": 1.0 / 16.0, "exposure_ms": once, "no_modulation": 0}
        with Image.open(measured_set / sample.record.folder / "modulation.png") as image:
            number = np.asarray(image)
        assert number.dtype == np.uint16
        assert number.shape == (48, 64)
        np.testing.assert_array_equal(sample.modulation_dn, number / 16.0)
        # Seen light has fringes: amplitudes by the three-step formula of the finest set, one exposure.
        i0, i1, i2 = sample.frames[0, :3].astype(np.float64)
        amplitude = np.sqrt(3.0 * (i1 - i2) ** 2 + (2.0 * i0 - i1 - i2) ** 2) / 3.0
        valid = sample.reconstruction.valid
        assert np.abs(number / 16.0 - amplitude)[valid].max() <= 0.5 / 16.0 + 1e-3


def test_number_zero_of_a_modulation_picture_is_unknown_and_the_last_is_that_or_more() -> None:
    shown = scenes.PhaseShift(steps=4, periods_px=(16.0,)).frames()
    stack = scenes.Stack(np.zeros((1, 4, 1, 3), np.uint8), shown, (1.0,), scenes.Emva(bits=8))
    given, once = np.array([[np.nan, 1.0, 300.0]]), np.array([[255, 0, 0]], np.uint8)
    np.testing.assert_array_equal(modulation_picture(given, once, stack), [[0, 256, 65535]])


def test_modulation_of_all_exposures_is_as_at_the_shortest() -> None:
    shown = scenes.PhaseShift(steps=4, periods_px=(16.0,)).frames()
    times = (4.0, 1.0, 2.0)
    stack = scenes.Stack(np.zeros((3, 4, 1, 4), np.uint8), shown, times, scenes.Emva(bits=8))
    # The same light at three exposures, and a pixel of which the exposure is not known.
    given, used = np.array([[8.0, 2.0, 4.0, 2.0]]), np.array([[0, 1, 2, 255]], np.uint8)
    np.testing.assert_array_equal(modulation_picture(given, used, stack), [[512, 512, 512, 0]])


def test_number_zero_of_a_height_picture_is_no_height() -> None:
    code = HeightCode(offset_mm=-1.0, step_mm=0.25)
    np.testing.assert_array_equal(code.encode([np.nan, -1.0, -0.75, 0.0]), [0, 0, 1, 4])


@pytest.mark.usefixtures("here")
def test_picture_of_a_set_made_without_them_is_refused(plan: DatasetPlan, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    build(plan.model_copy(update={"count": 1, "picture": False}), folder)
    sample = fringebench.Dataset(folder)[0]
    assert sample.labels["images"][0]["file_name"] == "samples/000000/stack.exr"
    with pytest.raises(DatasetError, match="not part of this data set"):
        _ = sample.picture
    with pytest.raises(DatasetError, match="not part of this data set"):
        _ = sample.modulation_dn
    with pytest.raises(DatasetError, match="picture False, not True"):
        build(plan, folder)


def test_coco_images_open_with_pillow(undisturbed: Path) -> None:
    """As torchvision's CocoDetection does: the data set as root, PIL, annotations by image."""
    seen = 0
    for split in ("train", "val", "test"):
        coco = COCO(str(undisturbed / "coco" / f"{split}.json"))
        for number in sorted(coco.imgs):
            (image,) = coco.loadImgs(number)
            with Image.open(undisturbed / image["file_name"]) as picture:
                rgb = picture.convert("RGB")
            assert rgb.size == (image["width"], image["height"])
            assert len(coco.loadAnns(coco.getAnnIds(number))) > 0
            seen += 1
    assert seen == 6


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_torchvision_loads_pictures_and_masks_of_every_split(undisturbed: Path) -> None:
    detection = pytest.importorskip("torchvision.datasets")
    for split in ("train", "val", "test"):
        found = detection.CocoDetection(undisturbed, str(undisturbed / "coco" / f"{split}.json"))
        samples = fringebench.Dataset(undisturbed, split=split)
        for (picture, notes), sample in zip(found, samples, strict=True):
            assert picture.mode == "RGB"
            np.testing.assert_array_equal(np.asarray(picture)[..., 0], sample.picture)
            assert [n["bbox"] for n in notes] == [n["bbox"] for n in sample.labels["annotations"]]
            for note in notes:
                mask = found.coco.annToMask(note)
                assert (mask.shape, mask.max()) == (sample.picture.shape, 1)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
@pytest.mark.parametrize("resolution", [(480, 240), (240, 120)])
def test_masks_are_the_truths_pads_holes_included(
    tmp_path: Path, resolution: tuple[int, int]
) -> None:
    (tmp_path / "paste.gtp").write_text(GERBER)
    text = scenes.source("spi")
    start, end = text.index("[board]"), text.index("[board.paste]")
    board = f'[board]\nkind = "gerber"\nfiles = {{ paste = "{tmp_path}/paste.gtp" }}\n\n'
    scene = scenes.parse(
        text[:start] + board + text[end:],
        {
            "camera.resolution": list(resolution),
            "camera.field_width_mm": 2.4,
            "board.defects": {},
            "board.region": {"centre_mm": [0.0, 0.0], "size_mm": [2.4, 1.2]},
        },
    )
    truth = render.truth(scene)
    (tmp_path / "coco.json").write_text(json.dumps(scenes.coco(scene, "picture.png")))
    coco = COCO(str(tmp_path / "coco.json"))
    notes = coco.loadAnns(coco.getAnnIds())
    assert {CATEGORIES[note["category_id"] - 1] for note in notes} == {"good"}
    assert [note["iscrowd"] for note in notes] == [0, 0]
    paste = truth.region("paste")
    for note in notes:
        mask = coco.annToMask(note).astype(bool)
        true = paste & (truth.pad == note["pad"])
        assert (mask & true).sum() >= 0.98 * (mask | true).sum()
        # A box of the hole's size around the ring's middle is free of its mask.
        assert mask.sum() == pytest.approx(note["area"], rel=0.02)
    assert {type(note["segmentation"]) for note in notes} == {dict, list}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_masks_of_every_class_are_what_is_seen() -> None:
    names = [name.replace("-", "_") for name in CLASSES]
    scene = scenes.load("spi", {f"board.defects.{name}.probability": 0.1 for name in names})
    truth, coco = render.truth(scene), COCO()
    coco.dataset = scenes.coco(scene, "picture.png")
    coco.createIndex()
    masks: dict[str, list[tuple[int, NDArray[np.bool_]]]] = {name: [] for name in CATEGORIES}
    for note in coco.dataset["annotations"]:
        mask = coco.annToMask(note).astype(bool)
        masks[CATEGORIES[note["category_id"] - 1]].append((note["pad"], mask))
    assert all(masks[name] for name in ("good", *CLASSES))
    assert truth.pad is not None
    thin = np.any([m for name in ("smear", "bridge") for _, m in masks[name]], axis=0)
    for name in ("good", *CLASSES):
        own = np.any([m for _, m in masks[name]], axis=0)
        pads = np.isin(truth.pad, [pad for pad, _ in masks[name]])
        if name == "contamination":
            true = truth.region("contamination")
        elif name == "missing":
            true = truth.region("pad") & pads
        elif name in ("smear", "bridge"):
            # Of the paste that no deposit's own mask covers.
            rest = [
                m
                for other in CATEGORIES
                if other not in ("smear", "bridge")
                for _, m in masks[other]
            ]
            true = truth.region("paste") & ~np.any(rest, axis=0) & own
            own = own & ~np.any(rest, axis=0)
        else:
            true, own = truth.region("paste") & pads & ~thin, own & ~thin
        # Deposits of one class may touch those of another: one pixel of rim.
        assert (own & true).sum() >= 0.98 * (own | true).sum(), name


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")
def test_run_lengths_are_cocos() -> None:
    rng = np.random.default_rng(1)
    from pycocotools import mask as masks

    cases: list[NDArray[np.bool_]] = [rng.random((5, 7)) < share for share in (0.0, 0.3, 0.7, 1.0)]
    for case in cases:
        coded = masks.frPyObjects({"size": [5, 7], "counts": run_lengths(case)}, 5, 7)
        np.testing.assert_array_equal(masks.decode(coded).astype(bool), case)
