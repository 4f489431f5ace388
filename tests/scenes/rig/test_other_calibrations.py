"""Calibrations of other programs: the MATLAB toolbox, texts, ROS and COLMAP give the same rig."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import scipy.io
import yaml
from scipy.spatial.transform import Rotation

from scenes.rig.colmap_files import colmap_nodes
from scenes.rig.opencv_calibration import Pair, Source
from scenes.support.errors import FileError
from tests.scenes.rig.test_opencv_calibration import (
    D1,
    D2,
    K1,
    K2,
    PARTS,
    SIZES,
    R,
    T,
    pair_of,
    refused,
)


def same(pair: Pair) -> None:
    """The pair is the one of `PARTS`."""
    np.testing.assert_allclose(pair.first.matrix, K1, rtol=1e-6)
    np.testing.assert_allclose(pair.second.matrix, K2, rtol=1e-6)
    np.testing.assert_allclose(pair.first.distortion, D1, atol=1e-9)
    np.testing.assert_allclose(pair.second.distortion, D2, atol=1e-9)
    np.testing.assert_allclose(pair.R, R, atol=1e-6)
    np.testing.assert_allclose(pair.t_mm, T, rtol=1e-6)


@pytest.mark.parametrize("matrices", [True, False])
def test_matlab_toolbox_files_are_read(tmp_path: Path, matrices: bool) -> None:
    nodes: dict[str, Any] = {"R": R, "T": T[:, None], "nx": 2592, "ny": 1944}
    nodes["om"] = cv2.Rodrigues(R)[0]
    for side, K, D in (("left", K1, D1), ("right", K2, D2)):
        nodes |= {f"kc_{side}": np.asarray(D)[:, None], f"kc_error_{side}": np.full((5, 1), 0.01)}
        if matrices:
            nodes[f"KK_{side}"] = K
        else:
            nodes |= {f"fc_{side}": K.diagonal()[:2, None], f"cc_{side}": K[:2, 2:]}
            nodes[f"alpha_c_{side}"] = 0.0
    scipy.io.savemat(tmp_path / "Calib_Results_stereo.mat", nodes)
    pair = pair_of(tmp_path / "Calib_Results_stereo.mat")
    same(pair)
    assert pair.first.size == (2592, 1944)
    (tmp_path / "broken.mat").write_bytes(b"MATLAB 5.0 MAT-file" + bytes(200))
    refused("no readable", tmp_path / "broken.mat")


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
    refused("has skew 2:", tmp_path / "skew.mat")


def rows(array: Any) -> str:
    return "\n".join(" ".join(f"{x:.12g}" for x in row) for row in np.atleast_2d(array)) + "\n"


POSE_1 = np.column_stack([cv2.Rodrigues(np.array([0.1, 0.2, -0.1]))[0], [10.0, -20.0, 700.0]])
POSE_2 = np.column_stack([R @ POSE_1[:, :3], R @ POSE_1[:, 3] + T])


LABELS = dict(zip(("K1", "D1", "K2", "D2", "R", "T"), PARTS, strict=True))


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(map(rows, (K1, D1, K2, D2, R, T))),
        "\n".join(map(rows, (K1, D1, K2, D2, np.column_stack([R, T])))),
        "\n".join(map(rows, (K1, D1, K2, D2, POSE_1, POSE_2))),
        "\n".join(map(rows, (K1 @ POSE_1, -3.0 * K2 @ POSE_2, D1, D2))),
        "# calibration\n" + "".join(f"{name}:\n{rows(PARTS[key])}" for name, key in LABELS.items()),
        "".join(
            f"{name} = [{'; '.join(rows(value).splitlines())}];\n" for name, value in PARTS.items()
        ),
    ],
    ids=["R and T", "pose", "two poses", "projection matrices", "labels", "matlab"],
)
def test_numbers_in_a_text_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "calibration.txt").write_text(text)
    same(pair_of(tmp_path / "calibration.txt"))


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
    pair = pair_of(left, right)
    same(pair)
    assert (pair.first.size, pair.second.size) == ((2592, 1944), (1280, 800))
    right.write_text(camera_info(K2, D2, (1280, 800), R2, P2, distortion_model="equidistant"))
    refused("distortion model 'equidistant'", left, right)
    right.write_text(camera_info(K2, D2, (1280, 800), np.eye(3), P1))
    refused("no baseline", left, right)


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


@pytest.mark.parametrize(
    ("model", "params", "focal", "distortion"),
    [
        ("SIMPLE_PINHOLE", (9, 4, 3), (9, 9), (0, 0, 0, 0)),
        ("PINHOLE", (9, 8, 4, 3), (9, 8), (0, 0, 0, 0)),
        ("SIMPLE_RADIAL", (9, 4, 3, 0.1), (9, 9), (0.1, 0, 0, 0)),
        ("RADIAL", (9, 4, 3, 0.1, 0.2), (9, 9), (0.1, 0.2, 0, 0)),
        ("OPENCV", (9, 8, 4, 3, 0.1, 0.2, 0.3, 0.4), (9, 8), (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_parameters_of_colmaps_models_are_in_colmaps_order(
    model: str, params: tuple[float, ...], focal: tuple[float, float], distortion: tuple[float, ...]
) -> None:
    """Focal lengths 9 and 8, centre (4, 3): src/colmap/sensor/models.h of COLMAP."""
    text = f"1 {model} 8 6 {' '.join(map(str, params))}\n"
    nodes = colmap_nodes(text, Path("cameras.txt"))
    assert nodes is not None
    (camera,) = nodes["COLMAP cameras"].values()
    expected = [[focal[0], 0, 3.5], [0, focal[1], 2.5], [0, 0, 1]]
    np.testing.assert_array_equal(camera["matrix"], expected)
    assert tuple(camera["distortion"]) == distortion


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
