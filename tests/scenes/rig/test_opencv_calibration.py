"""OpenCV calibrations: names, formats, conventions, and what is refused."""

import json
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from scipy.spatial.transform import Rotation

from scenes.rig.calibration_files import entries
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
        Source(files=(path,)).pair()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Source(files=(path,), mm_per_unit=1000.0).pair()
        Source(files=(write(path, PARTS | SIZES),)).pair()


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
    pair = Source(files=(path,)).pair()
    np.testing.assert_array_equal(pair.first.matrix, K1)
    np.testing.assert_array_equal(pair.second.matrix, K2)
    np.testing.assert_allclose(pair.second.distortion, D2)
    np.testing.assert_array_equal(pair.t_mm, T)


def test_names_unit_and_direction_given_by_the_caller_are_used(tmp_path: Path) -> None:
    inverse, back = R.T, -R.T @ T / 1000.0
    odd = {"A": K1, "B": K2, "turn": cv2.Rodrigues(inverse)[0], "move": back}
    names = {"first_matrix": "A", "second_matrix": "B", "rotation": "turn", "translation": "move"}
    path = write(tmp_path / "rig.yml", odd)
    pair = Source(files=(path,), names=names, mm_per_unit=1000.0, second_to_first=True).pair()
    np.testing.assert_allclose(pair.R, R, atol=1e-12)
    np.testing.assert_allclose(pair.t_mm, T, atol=1e-9)
    with pytest.raises(FileError, match="none is known as first_matrix"):
        Source(files=(path,)).pair()
    with pytest.raises(FileError, match="no 'a' for first_matrix"):
        Source(files=(path,), names={"first_matrix": "a"}).pair()
    with pytest.raises(FileError, match="did you mean 'rotation'"):
        Source(files=(path,), names={"rotatoin": "turn"}).pair()


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
    with pytest.raises(FileError, match=r"calibration '.*' (is not valid|has no named entries)"):
        Source(files=(path,)).pair()


def test_intrinsics_and_extrinsics_can_be_in_two_files(tmp_path: Path) -> None:
    inner = {k: v for k, v in PARTS.items() if k not in ("R", "T")}
    files = (
        write(tmp_path / "intrinsics.yml", inner | SIZES),
        write(tmp_path / "extrinsics.yml", {"R": R, "T": T}),
    )
    np.testing.assert_allclose(Source(files=files).pair().R, R)


def test_two_cameras_share_the_world_of_the_first(tmp_path: Path) -> None:
    pair = Source(files=(write(tmp_path / "rig.yml", PARTS | SIZES),)).pair()
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


@pytest.mark.parametrize("name", ["rig.yml", "rig.xml", "rig.json"])
@pytest.mark.parametrize(
    "text", ["", "nonsense {", "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3"]
)
def test_broken_file_is_refused(tmp_path: Path, name: str, text: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(FileError, match=r"rig"):
        Source(files=(path,)).pair()


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
    with pytest.raises(FileError, match=f"nothing known as {part}, but '{name}' is unused"):
        Source(files=(path,)).pair()
    pair = Source(files=(path,), names={part: name}).pair()
    device = pair.first if part == "first_distortion" else pair.second
    np.testing.assert_allclose(device.distortion[:4], D2[:4])
    pair = Source(files=(path,), names={part: "none"}).pair()
    device = pair.first if part == "first_distortion" else pair.second
    assert not any(device.distortion)


def test_unused_entries_of_a_complete_calibration_are_ignored(tmp_path: Path) -> None:
    extra = {"rms": 0.3, "P1": np.zeros((3, 4)), "per_view": np.arange(12.0), "errors": D1}
    Source(files=(write(tmp_path / "rig.yml", PARTS | SIZES | extra),)).pair()


def same(pair: Pair, scale: float = 1.0) -> None:
    """The pair is the one of `PARTS`."""
    np.testing.assert_allclose(pair.first.matrix, K1, rtol=1e-6)
    np.testing.assert_allclose(pair.second.matrix, K2, rtol=1e-6)
    np.testing.assert_allclose(pair.first.distortion, D1, atol=1e-9)
    np.testing.assert_allclose(pair.second.distortion, D2, atol=1e-9)
    np.testing.assert_allclose(pair.R, R, atol=1e-6)
    np.testing.assert_allclose(pair.t_mm, T * scale, rtol=1e-6)


@pytest.mark.parametrize("matrices", [True, False])
def test_matlab_toolbox_files_are_read(tmp_path: Path, matrices: bool) -> None:
    nodes: dict[str, Any] = {
        "R": R,
        "T": T[:, None],
        "om": cv2.Rodrigues(R)[0],
        "nx": 2592,
        "ny": 1944,
    }
    for side, K, D in (("left", K1, D1), ("right", K2, D2)):
        nodes |= {f"kc_{side}": np.asarray(D)[:, None], f"kc_error_{side}": np.full((5, 1), 0.01)}
        if matrices:
            nodes[f"KK_{side}"] = K
        else:
            nodes |= {
                f"fc_{side}": K.diagonal()[:2, None],
                f"cc_{side}": K[:2, 2:],
                f"alpha_c_{side}": 0.0,
            }
    scipy.io.savemat(tmp_path / "Calib_Results_stereo.mat", nodes)
    pair = Source(files=(tmp_path / "Calib_Results_stereo.mat",)).pair()
    same(pair)
    assert pair.first.size == (2592, 1944)
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    with pytest.raises(FileError, match="no readable"):
        Source(files=(tmp_path / "broken.mat",)).pair()


def test_skew_of_the_matlab_toolbox_is_refused_with_its_size(tmp_path: Path) -> None:
    # The toolbox stores skew over focal length: 0.001 x 2000 px = 2 px.
    nodes: dict[str, Any] = {"R": R, "T": T[:, None], "nx": 2592, "ny": 1944}
    for side in ("left", "right"):
        nodes |= {
            f"fc_{side}": np.array([2000.0, 1900.0]),
            f"cc_{side}": np.array([1296.0, 972.0]),
            f"alpha_c_{side}": 0.001,
            f"kc_{side}": np.zeros(5),
        }
    scipy.io.savemat(tmp_path / "skew.mat", nodes)
    with pytest.raises(FileError, match="has skew 2:"):
        Source(files=(tmp_path / "skew.mat",)).pair()


def rows(array: Any) -> str:
    return "\n".join(" ".join(f"{x:.12g}" for x in row) for row in np.atleast_2d(array)) + "\n"


def numbered(label: str, array: Any) -> str:
    return f"{label}\n{rows(array)}"


POSE_1 = np.column_stack([cv2.Rodrigues(np.array([0.1, 0.2, -0.1]))[0], [10.0, -20.0, 700.0]])
POSE_2 = np.column_stack([R @ POSE_1[:, :3], R @ POSE_1[:, 3] + T])


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(map(rows, (K1, D1, K2, D2, R, T))),
        "\n".join(map(rows, (K1, D1, K2, D2, np.column_stack([R, T])))),
        "\n".join(map(rows, (K1, D1, K2, D2, POSE_1, POSE_2))),
        "\n".join(map(rows, (K1 @ POSE_1, -3.0 * K2 @ POSE_2, D1, D2))),
        "# calibration\n"
        + "".join(
            numbered(f"{name}:", value)
            for name, value in zip(("K1", "D1", "K2", "D2", "R", "T"), PARTS.values(), strict=True)
        ),
        "".join(
            f"{name} = [{'; '.join(' '.join(f'{x:.12g}' for x in row) for row in np.atleast_2d(value))}];\n"
            for name, value in PARTS.items()
        ),
    ],
    ids=["R and T", "pose", "two poses", "projection matrices", "labels", "matlab"],
)
def test_numbers_in_a_text_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "calibration.txt").write_text(text)
    same(Source(files=(tmp_path / "calibration.txt",)).pair())


def camera_info(K: Any, D: Any, size: tuple[int, int], R_rect: Any, P: Any, **changes: Any) -> str:
    def matrix(value: Any) -> dict[str, Any]:
        array = np.atleast_2d(value)
        return {"rows": len(array), "cols": array.shape[1], "data": array.ravel().tolist()}

    info = {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": "narrow_stereo",
        "camera_matrix": matrix(K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": matrix(D),
        "rectification_matrix": matrix(R_rect),
        "projection_matrix": matrix(P),
    }
    return str(yaml.safe_dump(info | changes))


def test_ros_camera_infos_of_a_pair_are_read_in_metres(tmp_path: Path) -> None:
    metres = T[:, None] / 1000.0
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        K1, np.array(D1), K2, np.array(D2), (2592, 1944), R, metres
    )
    left, right = tmp_path / "left.yaml", tmp_path / "right.yaml"
    left.write_text(camera_info(K1, D1, (2592, 1944), R1, P1))
    right.write_text(camera_info(K2, D2, (1280, 800), R2, P2))
    pair = Source(files=(left, right)).pair()
    same(pair)
    assert (pair.first.size, pair.second.size) == ((2592, 1944), (1280, 800))
    right.write_text(camera_info(K2, D2, (1280, 800), R2, P2, distortion_model="equidistant"))
    with pytest.raises(FileError, match="distortion model 'equidistant'"):
        Source(files=(left, right)).pair()
    right.write_text(camera_info(K2, D2, (1280, 800), np.eye(3), P1))
    with pytest.raises(FileError, match="no baseline"):
        Source(files=(left, right)).pair()


def colmap(
    folder: Path, models: tuple[str, str] = ("OPENCV", "OPENCV"), names: Any = None
) -> Source:
    """COLMAP's two texts of the rig of `PARTS`, k3 apart, seen from a world of its own, with lengths in metres."""
    params = [
        " ".join(f"{x:.17g}" for x in (K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *D[:4]))
        for K, D in ((K1, D1), (K2, D2))
    ]
    cameras = [
        f"{n} {models[n - 1]} {w} {h} {params[n - 1]}"
        for n, (w, h) in ((1, SIZES["cam_size"]), (2, SIZES["pro_size"]))
    ]
    (folder / "cameras.txt").write_text("# Camera list\n" + "\n".join(cameras) + "\n")
    lines = []
    for n, (pose, camera) in enumerate(((POSE_1, 1), (POSE_2, 2), (POSE_1 * 2.0, 1)), 1):
        rotation = Rotation.from_matrix(pose[:, :3] / np.cbrt(np.linalg.det(pose[:, :3])))
        x, y, z, w = rotation.as_quat()
        t = " ".join(f"{v / 1000.0:.17g}" for v in pose[:, 3])
        lines += [
            f"{n} {w:.17g} {x:.17g} {y:.17g} {z:.17g} {t} {camera} im {n}.png",
            "10.5 20.5 -1 3 4 7" if n == 1 else "",
        ]
    (folder / "images.txt").write_text(
        "# Image list\n" + "\n".join(lines if names else lines[:4]) + "\n"
    )
    return Source(
        files=(folder / "cameras.txt", folder / "images.txt"), mm_per_unit=1000.0, names=names or {}
    )


@pytest.mark.parametrize("names", [None, {"first_matrix": "im 1.png", "second_matrix": "im 2.png"}])
def test_colmap_texts_are_read(tmp_path: Path, names: Any) -> None:
    pair = colmap(tmp_path, names=names).pair()
    np.testing.assert_allclose(pair.first.matrix, K1)
    np.testing.assert_allclose(pair.second.matrix, K2)
    np.testing.assert_allclose(pair.second.distortion, (*D2[:4], 0.0))
    np.testing.assert_allclose(pair.R, R, atol=1e-12)
    np.testing.assert_allclose(pair.t_mm, T, rtol=1e-12)
    assert (pair.first.size, pair.second.size) == ((2592, 1944), (1280, 800))


def test_colmap_texts_without_scale_images_or_known_lens_are_refused(tmp_path: Path) -> None:
    good = colmap(tmp_path)
    with pytest.raises(FileError, match="no unit: set mm_per_unit"):
        good.model_copy(update={"mm_per_unit": None}).pair()
    with pytest.raises(FileError, match=r"both cameras\.txt and images\.txt"):
        good.model_copy(update={"files": good.files[:1]}).pair()
    with pytest.raises(FileError, match=r"no image 'im 3\.png'"):
        good.model_copy(update={"names": {"first_matrix": "im 3.png"}}).pair()
    with pytest.raises(FileError, match="say which two"):
        colmap(tmp_path, names={"rotation": "R"}).pair()
    with pytest.raises(FileError, match="OPENCV_FISHEYE is not Brown's"):
        colmap(tmp_path, ("OPENCV_FISHEYE", "OPENCV")).pair()
