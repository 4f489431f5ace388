"""OpenCV calibrations: names, formats, conventions, and what is refused."""

import json
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from scenes.rig.calibration_files import _is_rotation, entries
from scenes.rig.opencv_calibration import Pair, Source
from scenes.support.errors import FileError, FringebenchWarning

K1 = np.array([[2800.0, 0, 1500.0], [0, 2810.0, 1090.0], [0, 0, 1]])
K2 = np.array([[1650.0, 0, 620.0], [0, 1720.0, 360.0], [0, 0, 1]])
D1 = np.array([-0.23, 0.14, -9e-4, 1.3e-3, -0.03])
D2 = np.array([-0.05, 0.2, -7e-3, -2e-3, -0.1])
R = cv2.Rodrigues(np.array([0.05, 0.4, -0.1]))[0]
T = np.array([-183.0, -23.7, 60.7])
SIZES = {"cam_size": [2592, 1944], "pro_size": [1280, 800]}
PARTS: dict[str, Any] = {"cam_K": K1, "cam_kc": D1, "pro_K": K2, "pro_kc": D2, "R": R, "T": T}


def write(path: Path, parts: dict[str, Any]) -> Path:
    """A file as OpenCV writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in parts.items():
        storage.write(name, value if np.isscalar(value) else np.asarray(value, dtype=np.float64))
    storage.release()
    return path


def pair_of(*files: Path, **keys: Any) -> Pair:
    return Source(files=files, **keys).pair()


def refused(says: str, *files: Path, **keys: Any) -> None:
    with pytest.raises(FileError, match=says):
        pair_of(*files, **keys)


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_points_project_as_in_opencv_plus_half_a_pixel(tmp_path: Path, suffix: str) -> None:
    path = write(tmp_path / f"rig{suffix}", PARTS | SIZES)
    rig = Source(files=(path,), distance_mm=600.0).calibration()
    points = np.random.default_rng(0).uniform((-80, -80, 500), (80, 80, 700), (50, 3))
    world = points * (1, -1, -1) + (0, 0, 600.0)
    for device, K, D, rvec, t in (
        (rig.camera, K1, D1, np.zeros(3), np.zeros(3)),
        (rig.projectors[0], K2, D2, cv2.Rodrigues(R)[0], T),
    ):
        theirs = cv2.projectPoints(points, rvec, t, K, D)[0][:, 0]
        # both are float64: rounding of some thousand px
        np.testing.assert_allclose(device.projection().project(world)[0], theirs + 0.5, atol=1e-9)
    assert rig.camera.resolution == (2592, 1944)
    assert rig.projectors[0].resolution == (1280, 800)


def test_a_translation_in_metres_is_reported_by_its_length(tmp_path: Path) -> None:
    path = write(tmp_path / "rig.yml", PARTS | SIZES | {"T": T / 1000.0})
    with pytest.warns(FringebenchWarning, match=r"0\.194 mm apart: .*set mm_per_unit = 1000"):
        pair_of(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pair_of(path, mm_per_unit=1000.0)
        pair_of(write(path, PARTS | SIZES))


def test_working_volume_is_from_the_nearest_to_the_farthest_depth(tmp_path: Path) -> None:
    path = write(tmp_path / "rig.yml", PARTS | SIZES)
    stated = Source(files=(path,), distance_mm=600.0, depth_range_mm=(500.0, 650.0))
    # Heights rise towards the camera, 600 mm above z = 0: 650 mm away is -50, 500 mm away is 100.
    assert stated.calibration().height_range_mm == (-50.0, 100.0)
    # Not stated: half a baseline to fifty of them.
    baseline_mm = float(np.linalg.norm(T))
    found = Source(files=(path,)).calibration()
    assert found.height_range_mm == pytest.approx((-50.0 * baseline_mm, -0.5 * baseline_mm))
    with pytest.raises(FileError, match="the first must be below the second"):
        Source(files=(path,), depth_range_mm=(500.0, 500.0)).calibration()


@pytest.mark.parametrize(
    "names",
    [
        ("camera_matrix", "dist_coeffs", "projector_matrix", "projector_distortion", "R", "T"),
        ("M1", "D1", "M2", "D2", "R", "T"),
        ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2", "R", "T"),
        ("cam_int", "cam_dist", "proj_int", "proj_dist", "rotation", "translation"),
        ("Camera Matrix 1", "Dist.Coeffs.1", "K2", "D2", "r", "t"),
    ],
)
def test_common_names_of_calibrations_are_recognised(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    tree = {name: np.asarray(v).tolist() for name, v in zip(names, PARTS.values(), strict=True)}
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(tree))
    pair = pair_of(path)
    np.testing.assert_array_equal(pair.first.matrix, K1)
    np.testing.assert_array_equal(pair.second.matrix, K2)
    np.testing.assert_allclose(pair.second.distortion, D2)
    np.testing.assert_array_equal(pair.t_mm, T)


def test_names_unit_and_direction_given_by_the_caller_are_used(tmp_path: Path) -> None:
    inverse, back = R.T, -R.T @ T / 1000.0
    odd = {"A": K1, "B": K2, "turn": cv2.Rodrigues(inverse)[0], "move": back}
    names = {"first_matrix": "A", "second_matrix": "B", "rotation": "turn", "translation": "move"}
    path = write(tmp_path / "rig.yml", odd)
    pair = pair_of(path, names=names, mm_per_unit=1000.0, second_to_first=True)
    np.testing.assert_allclose(pair.R, R, atol=1e-12)
    np.testing.assert_allclose(pair.t_mm, T, atol=1e-9)
    refused("none is known as first_matrix", path)
    refused("no 'a' for first_matrix", path, names={"first_matrix": "a"})
    refused("did you mean 'rotation'", path, names={"rotatoin": "turn"})


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencv_reads_the_same_numbers(tmp_path: Path, suffix: str) -> None:
    rng = np.random.default_rng(1)
    numbers = {f"m{k}": rng.normal(size=(3, 4)) * 10.0 ** rng.integers(-30, 30) for k in range(20)}
    path = write(tmp_path / f"rig{suffix}", numbers | {"n": 7, "x": -2.5e-7, "word": "left"})
    theirs, mine = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ), entries(path)
    for name in numbers:
        np.testing.assert_array_equal(mine[name], theirs.getNode(name).mat())
    assert float(mine["n"]) == 7 and float(mine["x"]) == -2.5e-7
    assert mine["word"].strip('"') == "left"


# Found by fuzzing: cv2.FileStorage never returned from the one, and gave lists within lists without end of the other.
@pytest.mark.parametrize(
    "text", ["%YA3\n   c: 3\nr K: %YAML 0.2\n---\nR: [ 1!!o  \0 0.,  ., 0. ]", "A:" + "-" * 650]
)
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_text_on_which_opencv_hangs_is_refused(tmp_path: Path, suffix: str, text: str) -> None:
    path = tmp_path / f"rig{suffix}"
    path.write_text(text)
    refused(r"calibration '.*' (is not valid|has no named entries)", path)


def test_intrinsics_and_extrinsics_can_be_in_two_files(tmp_path: Path) -> None:
    inner = {k: v for k, v in PARTS.items() if k not in ("R", "T")}
    files = (
        write(tmp_path / "intrinsics.yml", inner | SIZES),
        write(tmp_path / "extrinsics.yml", {"R": R, "T": T}),
    )
    np.testing.assert_allclose(pair_of(*files).R, R)


def test_two_cameras_share_the_world_of_the_first(tmp_path: Path) -> None:
    pair = pair_of(write(tmp_path / "rig.yml", PARTS | SIZES))
    left, right = (camera.projection() for camera in pair.cameras())
    np.testing.assert_allclose(left.origin_mm, 0.0, atol=1e-12)
    assert np.linalg.norm(right.origin_mm) == pytest.approx(np.linalg.norm(T), rel=1e-12)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"R": np.diag([1.0, 1.0, -1.0])}, "is no rotation"),
        ({"R": 2 * R}, "is no rotation"),
        ({"T": np.zeros(3)}, "translation is zero"),
        ({"cam_K": np.eye(2)}, "first_matrix has not the shape"),
        ({"cam_kc": np.arange(1.0, 9.0)}, "rational"),
        ({"cam_K": np.where(K1 == 1500.0, 9000.0, K1)}, "another size"),
        ({"pro_K": np.where(K2 == 1650.0, 100.0, K2)}, "factor of two"),
        ({"pro_K": np.where(K2 == 620.0, 620.0, K2) + 5.0 * np.eye(3, k=1) * (K2 == 0)}, "skew"),
        ({"T": np.array([np.nan, 0, 1])}, "NaN or infinite"),
    ],
)
def test_invalid_calibration_is_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    path = write(tmp_path / "rig.yml", PARTS | SIZES | changes)
    with pytest.raises(FileError, match=said):
        Source(files=(path,)).calibration()


def test_camera_of_another_size_is_refused(tmp_path: Path) -> None:
    source = Source(files=(write(tmp_path / "rig.yml", PARTS | SIZES),))
    with pytest.raises(FileError, match="2592 x 1944 pixels, but here it has 1296 x 972"):
        source.calibration((1296, 972))
    unsized = Source(files=(write(tmp_path / "unsized.yml", PARTS),))
    with pytest.raises(FileError, match="does not say the second device's size"):
        unsized.calibration((2592, 1944))


def test_rotations_are_rotations_whatever_their_rounding_and_mirrors_are_none() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        rotation = cv2.Rodrigues(rng.normal(0.0, 1.0, 3))[0]
        assert _is_rotation(rotation)
        assert not _is_rotation(-rotation)
        # Nor is what also shrinks or stretches.
        assert not _is_rotation(0.9 * rotation) and not _is_rotation(1.1 * rotation)


@pytest.mark.parametrize("name", ["rig.yml", "rig.xml", "rig.json"])
@pytest.mark.parametrize(
    "text", ["", "nonsense {", "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3"]
)
def test_broken_file_is_refused(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    refused(r"rig", path)


@pytest.mark.parametrize("terms", [4, 5, 8])
@pytest.mark.parametrize(
    ("part", "name"), [("first_distortion", "lens"), ("second_distortion", "D4")]
)
def test_unused_entry_that_looks_like_a_missing_distortion_is_refused(
    tmp_path: Path, part: str, name: str, terms: int
) -> None:
    known = {"first_distortion": "cam_kc", "second_distortion": "pro_kc"}[part]
    parts = PARTS | SIZES | {name: np.resize(np.append(D2, np.zeros(9)), terms)}
    del parts[known]
    path = write(tmp_path / "rig.yml", parts)
    refused(f"nothing known as {part}, but '{name}' is unused", path)
    pair = pair_of(path, names={part: name})
    device = pair.first if part == "first_distortion" else pair.second
    np.testing.assert_allclose(device.distortion[:4], D2[:4])
    pair = pair_of(path, names={part: "none"})
    device = pair.first if part == "first_distortion" else pair.second
    assert not any(device.distortion)


def test_unused_entries_of_a_complete_calibration_are_ignored(tmp_path: Path) -> None:
    extra = {"rms": 0.3, "P1": np.zeros((3, 4)), "per_view": np.arange(12.0), "errors": D1}
    pair_of(write(tmp_path / "rig.yml", PARTS | SIZES | extra))
