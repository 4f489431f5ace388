"""Manifests and image files: what comes in, and what is refused."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tomli_w

import decode
from decode.checks.stack_check import check
from scenes.acquisition.patterns import GrayCode, PhaseShift
from scenes.files import images
from scenes.files.capture import Capture
from scenes.files.noise_estimate import noise_dn
from scenes.support.errors import FileError

SHAPE = (12, 16)
MANIFEST: dict[str, Any] = {
    "files": ["img*.png"],
    "projector_resolution": [640, 480],
    "frames": [{"kind": "fringes", "axis": "column", "period_px": 20.0, "steps": 4}],
}


def write(folder: Path, count: int = 4, suffix: str = ".png", dtype: Any = np.uint8) -> np.ndarray:
    """Random images img1 ... img<count>, and their counts."""
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 200, (count, *SHAPE)).astype(dtype)
    for i, plane in enumerate(counts):
        cv2.imwrite(str(folder / f"img{i + 1}{suffix}"), plane)
    return counts


def load(folder: Path, **changes: Any) -> Capture:
    (folder / "capture.toml").write_text(tomli_w.dumps({**MANIFEST, **changes}))
    return Capture.load(folder / "capture.toml")


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp"])
def test_8_bit_counts_are_read_exactly(tmp_path: Path, suffix: str) -> None:
    counts = write(tmp_path, suffix=suffix)
    stack = load(tmp_path, files=[f"img*{suffix}"]).stack()
    np.testing.assert_array_equal(stack.frames[0], counts)
    assert stack.patterns == PhaseShift(steps=4, periods_px=(20.0,)).frames()


def test_16_bit_counts_are_read_exactly(tmp_path: Path) -> None:
    counts = write(tmp_path, suffix=".tiff", dtype=np.uint16)
    counts[0, 0, 0] = 3000
    cv2.imwrite(str(tmp_path / "img1.tiff"), counts[0])
    stack = load(tmp_path, files=["img*.tiff"], bits=12).stack()
    np.testing.assert_array_equal(stack.frames[0], counts)
    assert stack.saturation_dn == 4095.0


def test_files_sort_by_number_and_brackets_are_literal(tmp_path: Path) -> None:
    names = ["f10.png", "f9.png", "f1_[00-1].png"]
    for name in names:
        cv2.imwrite(str(tmp_path / name), np.zeros(SHAPE, np.uint8))
    assert [p.name for p in images.find(tmp_path, ["f*.png"])] == [
        "f1_[00-1].png",
        "f9.png",
        "f10.png",
    ]
    assert images.find(tmp_path, ["f1_[00-1].png"])[0].name == "f1_[00-1].png"


def test_colour_channel_is_taken_as_stated_and_never_guessed(tmp_path: Path) -> None:
    colour = np.zeros((*SHAPE, 3), np.uint8)
    colour[..., 0], colour[..., 1], colour[..., 2] = 10, 20, 30
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"img{i}.png"), colour)
    for channel, dn in (("blue", 10), ("green", 20), ("red", 30), ("luma", 22)):
        assert (load(tmp_path, channel=channel).stack().frames == dn).all()
    with pytest.raises(FileError, match="in colour: set channel"):
        load(tmp_path).stack()


def test_frames_follow_the_formula_of_shift_direction_and_origin() -> None:
    shown = {"kind": "fringes", "axis": "row", "period_px": 20.0, "steps": 3}
    shown |= {"first_phase_deg": -90.0, "direction": -1, "origin_px": 0.5}
    frames = Capture.model_validate({"files": ["x"], "frames": [shown]}).patterns
    index = np.arange(40.0)
    for k, frame in enumerate(frames):
        # a sine computed from the pixel's index, shifted backwards
        wanted = 0.5 + 0.5 * np.sin(2 * np.pi * index / 20.0 - 2 * np.pi * k / 3)
        np.testing.assert_allclose(frame.commanded(index + 0.5), wanted, atol=1e-12)


def test_orders_of_a_gray_code_hold_the_same_frames() -> None:
    def frames(**keys: Any) -> Any:
        shown = {"kind": "gray", "axis": "column", "bits": 4, **keys}
        return Capture.model_validate({"files": ["x"], "frames": [shown]}).patterns

    usual = frames()
    assert usual == GrayCode(bits=(4,), flat=False).frames()
    for keys in ({"order": "fine-first"}, {"inverse": "after-all"}):
        assert frames(**keys) != usual
        assert sorted(frames(**keys), key=str) == sorted(usual, key=str)
    assert [f.step for f in frames(inverse="none", order="fine-first")] == [3, 2, 1, 0]


def test_exposures_inside_or_outside_the_sequence(tmp_path: Path) -> None:
    counts = write(tmp_path, count=8)
    outer = load(tmp_path, exposures_ms=[1.0, 4.0]).stack()
    np.testing.assert_array_equal(outer.frames, counts.reshape(2, 4, *SHAPE))
    inner = load(tmp_path, exposures_ms=[1.0, 4.0], exposures_innermost=True).stack()
    np.testing.assert_array_equal(inner.frames, counts.reshape(4, 2, *SHAPE).swapaxes(0, 1))


def test_skipped_images_are_left_out(tmp_path: Path) -> None:
    counts = write(tmp_path, count=6)
    stack = load(tmp_path, frames=[{"kind": "skip", "count": 2}, *MANIFEST["frames"]]).stack()
    np.testing.assert_array_equal(stack.frames[0], counts[2:])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"files": ["img1.png", "img2.png", "img3.png", "gone.png"]}, "gone.png' is missing"),
        (
            {"files": ["img1.png", "img2.png", "img3.png"]},
            "3 images .* 4 frames: add the missing 1",
        ),
        ({"exposures_ms": [1.0, 2.0]}, "4 frames at 2 exposures: add the missing 4"),
        ({"files": ["img1.png", "img*.png"]}, "listed twice"),
        ({"files": ["img1.png", "../{folder}/img*.png"]}, r"listed twice.*\['img1.png'\]"),
        ({"bits": 12}, "8-bit numbers: set bits = 8"),
        ({"channel": "red"}, "is grey, but channel is 'red'"),
        ({"frame": []}, "unknown key 'frame': did you mean 'frames'"),
        ({"frames": [{"kind": "fringes", "axis": "column", "steps": 4}]}, "period_px' is missing"),
        ({"frames": [{**MANIFEST["frames"][0], "shifts_deg": [0.0, 1.0]}]}, "2 values for 4 steps"),
        ({"frames": [{**MANIFEST["frames"][0], "steps": 2}]}, "kind = 'grey'"),
        ({"calibration": {"files": ["none.yml"]}}, "none.yml' does not exist"),
    ],
)
def test_invalid_manifest_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    write(tmp_path)
    if "files" in changes:
        changes = {"files": [name.format(folder=tmp_path.name) for name in changes["files"]]}
    with pytest.raises(FileError, match=said):
        load(tmp_path, **changes).stack()


def test_patterns_may_leave_the_manifest_s_folder(tmp_path: Path) -> None:
    """A user's own file names them, and nothing but images is read: it is allowed, as absolute paths are."""
    (tmp_path / "images").mkdir()
    (tmp_path / "setup").mkdir()
    counts = write(tmp_path / "images")
    absolute = [str(tmp_path / "images" / f"img{i}.png") for i in (1, 2, 3, 4)]
    for files in (["../images/img*.png"], absolute):
        found = load(tmp_path / "setup", files=files).stack().frames[0]
        np.testing.assert_array_equal(found, counts)


def test_mixed_sizes_depths_and_broken_files_are_refused(tmp_path: Path) -> None:
    write(tmp_path)
    cv2.imwrite(str(tmp_path / "img3.png"), np.zeros((5, 5), np.uint8))
    with pytest.raises(FileError, match="5 x 5 pixels of 8 bits"):
        load(tmp_path).stack()
    cv2.imwrite(str(tmp_path / "img3.png"), np.zeros(SHAPE, np.uint16))
    with pytest.raises(FileError, match="of 16 bits"):
        load(tmp_path).stack()
    whole = (tmp_path / "img1.png").read_bytes()
    (tmp_path / "img3.png").write_bytes(whole[: len(whole) // 3])
    with pytest.raises(FileError, match="no readable image"):
        load(tmp_path).stack()
    (tmp_path / "img3.png").write_bytes(b"")
    with pytest.raises(FileError, match="no readable image"):
        load(tmp_path).stack()


def test_too_few_and_too_many_bits_are_refused(tmp_path: Path) -> None:
    counts = write(tmp_path, dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "img1.png"), np.full(SHAPE, 5000, np.uint16))
    with pytest.raises(FileError, match="bits = 12 ends at 4095, but the brightest sample is 5000"):
        load(tmp_path, bits=12).stack()
    # a 12-bit camera that clips, said to have 16 bits: saturation would go unseen
    cv2.imwrite(str(tmp_path / "img1.png"), np.full(SHAPE, 4095, np.uint16))
    with pytest.raises(FileError, match="the camera has 12 bits"):
        load(tmp_path, bits=16).stack()
    assert counts.dtype == np.uint16


@pytest.mark.parametrize("sigma_dn", [1.0, 4.0])
def test_noise_is_estimated_despite_texture_and_edges(sigma_dn: float) -> None:
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:300, :400]
    scene = 120.0 + 60.0 * np.cos(2 * np.pi * x / 16.0) + 0.1 * y + 20.0 * ((x // 100) % 2)
    frames = np.round(scene + rng.normal(0, sigma_dn, (1, 6, 300, 400))).astype(np.uint8)
    # rounding adds a twelfth of a DN squared; a period of 16 px curves by less than a tenth of it along rows and columns
    wanted = np.hypot(sigma_dn, 12.0**-0.5)
    assert noise_dn(frames) == pytest.approx(wanted, rel=0.05)


FOUR: dict[str, Any] = {"kind": "fringes", "axis": "column", "period_px": 20.0, "steps": 4}


@pytest.mark.parametrize("period_px", [20.0, 20.0 * (1.0 + 1e-9)])
def test_two_sets_of_one_axis_and_period_are_refused(tmp_path: Path, period_px: float) -> None:
    later = FOUR | {"steps": 3, "period_px": period_px}
    with pytest.raises(FileError, match=r"one set of 7 steps.*repeat = true in frames\.1"):
        load(tmp_path, frames=[FOUR, later])
    load(tmp_path, frames=[FOUR, FOUR | {"repeat": True}, FOUR | {"axis": "row"}])


def test_files_in_several_folders_are_read_folder_by_folder(tmp_path: Path) -> None:
    for number in (2, 10, 1):
        (tmp_path / f"step{number}").mkdir()
        cv2.imwrite(str(tmp_path / f"step{number}" / "view.png"), np.full(SHAPE, number, np.uint8))
    frames = load(tmp_path, files=["step*/view.png"], frames=[FOUR | {"steps": 3}]).stack().frames
    assert frames[0, :, 0, 0].tolist() == [1, 2, 10]


def test_colour_planes_of_a_file_are_frames_in_the_order_given(tmp_path: Path) -> None:
    # OpenCV writes blue, green, red.
    cv2.imwrite(str(tmp_path / "img1.png"), np.full((*SHAPE, 3), (30, 20, 10), np.uint8))
    cv2.imwrite(str(tmp_path / "img2.png"), np.full((*SHAPE, 3), (60, 50, 40), np.uint8))
    channels = {"channel": ["red", "green", "blue"]}
    stack = load(tmp_path, frames=[FOUR | {"steps": 6}], **channels).stack()
    assert stack.frames[0, :, 0, 0].tolist() == [10, 20, 30, 40, 50, 60]
    with pytest.raises(FileError, match=r"2 images of 3 frames.* describes 4 frames"):
        load(tmp_path, **channels).stack()


@pytest.mark.parametrize("code", ["reflected", "plain"])
@pytest.mark.parametrize("inverse", ["after-each", "none"])
@pytest.mark.parametrize("origin_px", [0.0, -212.0])
def test_codes_with_an_origin_decode_to_the_pixel_that_was_shown(
    tmp_path: Path, code: str, inverse: str, origin_px: float
) -> None:
    """A program that shows bit k of the number ``index - origin_px``, reflected or plain, of 600 columns."""
    column = np.broadcast_to(np.arange(600.0) + 0.5, (8, 600))
    number = np.floor(column - origin_px).astype(int)
    if code == "reflected":
        number = number ^ (number >> 1)
    images = []
    for bit in reversed(range(10)):
        on = (number >> bit) & 1
        images += [on] if inverse == "none" else [on, 1 - on]
    images += [np.ones_like(number), np.zeros_like(number)]
    for k, image in enumerate(images):
        cv2.imwrite(str(tmp_path / f"img{k}.png"), (20 + 150 * image).astype(np.uint8))
    gray = {"kind": "gray", "axis": "column", "bits": 10, "inverse": inverse, "code": code}
    shown = [gray | {"origin_px": origin_px}, {"kind": "white"}, {"kind": "black"}]
    stack = load(tmp_path, frames=shown, projector_resolution=[600, 400], noise_dn=1.0).stack()
    rec = decode.reconstruct(stack, height="phase")
    assert rec.valid.all()
    np.testing.assert_allclose(rec.phases["column"].coordinate_px, column, atol=1e-3)
    report = check(stack)
    assert {f.verdict for f in report.findings} <= {"ok", "unknown"}


@pytest.mark.parametrize(
    ("frame", "says"),
    [
        ({"kind": "binary"}, 'code = "plain"'),
        ({"kind": "gray_code"}, 'kind = "gray"'),
        ({"kind": "shifted gray"}, "origin_px"),
        ({"kind": "lines"}, "line-shift"),
        ({"kind": "ftp"}, "single-shot"),
        ({"kind": "carrier"}, "modulated"),
        ({"kind": "embedded"}, "steps = 1"),
        ({"kind": "speckle"}, "two cameras"),
    ],
)
def test_codes_a_manifest_cannot_express_are_refused_with_the_nearest(
    tmp_path: Path, frame: dict[str, Any], says: str
) -> None:
    with pytest.raises(FileError) as caught:
        load(tmp_path, frames=[FOUR | {"axis": "row"}, frame])
    assert says in str(caught.value)
    assert "frames.1" in str(caught.value)
