"""Point clouds, read back by somebody else's reader."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scenes
from decode import Reconstruction
from evaluation import write_cloud
from evaluation.output.cloud import normals
from scenes.support.errors import FileError, ScoreError
from tests.evaluation.synthetic_truth import Floats, Grid, TruthMaker

SHAPE = (24, 32)


@pytest.fixture(scope="module")
def calibration() -> scenes.Calibration:
    """A telecentric camera over the grid of the other fixtures: 0.1 mm pixels."""
    overrides = {"camera.resolution": [32, 24], "camera.field_width_mm": 3.2}
    return scenes.load("chapter", overrides).calibration()


@pytest.fixture(scope="module")
def tilted(grid: Grid) -> Floats:
    """Heights of a plane that climbs 0.3 per mm in x and falls 0.1 per mm in y."""
    x, y = grid(SHAPE)
    return 0.3 * x - 0.1 * y


@pytest.fixture
def rec(calibration: scenes.Calibration, tilted: Floats) -> Reconstruction:
    valid = np.ones(SHAPE, bool)
    valid[:4] = False
    rec = Reconstruction.of_heights(tilted + 0.02, valid, calibration)
    ramp = np.broadcast_to(np.linspace(0.0, 80.0, SHAPE[1], dtype=np.float32), SHAPE)
    return replace(rec, sigma_mm=np.full(SHAPE, 0.01, np.float32), modulation_dn=ramp)


def test_cloud_is_read_by_trimesh(
    rec: Reconstruction, truth_of: TruthMaker, tilted: Floats, tmp_path: Path
) -> None:
    path = tmp_path / "cloud.ply"
    write_cloud(path, rec, truth_of(tilted))
    cloud = trimesh.load(path)
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(cloud.vertices, rec.xyz_mm[4:].reshape(-1, 3))
    np.testing.assert_array_equal(raw["scalar_sigma_mm"].ravel(), np.float32(0.01))
    # Truth and heights are float32 of at most 2 mm.
    np.testing.assert_allclose(raw["scalar_error_mm"].ravel(), 0.02, atol=2.0 * 2.0**-23)
    normal = np.stack([raw[k].ravel() for k in ("nx", "ny", "nz")], axis=-1)
    expected = np.array([-0.3, 0.1, 1.0]) / np.linalg.norm([-0.3, 0.1, 1.0])
    # Coordinates of up to 2 mm in float32, over a window of 0.2 mm.
    np.testing.assert_allclose(normal - expected, 0.0, atol=2.0 * 2.0**-23 / 0.2)
    colours = cloud.colors[:, :3].reshape(20, 32, 3)
    assert (colours[..., 0] == colours[..., 1]).all() and (colours[..., 0] == colours[..., 2]).all()
    assert colours[0, 0, 0] == 0 and colours[0, -1, 0] == 255
    assert (np.diff(colours[0, :, 0].astype(int)) >= 0).all()


def test_cloud_of_bare_heights_has_points_and_normals_only(
    calibration: scenes.Calibration, tilted: Floats, tmp_path: Path
) -> None:
    path = tmp_path / "cloud.ply"
    write_cloud(path, Reconstruction.of_heights(tilted, calibration=calibration))
    names = trimesh.load(path).metadata["_ply_raw"]["vertex"]["properties"]
    assert list(names) == ["x", "y", "z", "nx", "ny", "nz"]


def test_gray_image_is_the_colour(rec: Reconstruction, tmp_path: Path) -> None:
    path = tmp_path / "cloud.ply"
    write_cloud(path, rec, gray=np.tile(np.arange(SHAPE[0], dtype=float)[:, None], (1, SHAPE[1])))
    colours = trimesh.load(path).colors[:, 0].reshape(20, 32)
    assert (colours == colours[:, :1]).all()
    # White is the 99th percentile, here the brightest row.
    np.testing.assert_array_equal(colours[:, 0], np.arange(4, 24) * 255 // 23)


def test_normals_next_to_a_gap_are_those_of_the_plane(rec: Reconstruction) -> None:
    valid = rec.valid.copy()
    valid[10:13, 10:20] = False
    found = normals(np.where(valid[..., None], rec.xyz_mm, np.nan), valid)
    expected = np.array([-0.3, 0.1, 1.0]) / np.linalg.norm([-0.3, 0.1, 1.0])
    np.testing.assert_allclose(found[valid] - expected, 0.0, atol=2.0 * 2.0**-23 / 0.2)


def test_lone_point_has_a_normal_facing_up(rec: Reconstruction) -> None:
    valid = np.zeros(SHAPE, bool)
    valid[12, 12] = True
    np.testing.assert_array_equal(normals(rec.xyz_mm, valid)[12, 12], [0.0, 0.0, 1.0])


def test_cloud_without_points_is_refused(rec: Reconstruction, tmp_path: Path) -> None:
    nothing = replace(rec, reason=np.full(SHAPE, 3, np.uint8))
    with pytest.raises(ScoreError, match="no pixel of the reconstruction is valid"):
        write_cloud(tmp_path / "cloud.ply", nothing)
    assert not list(tmp_path.iterdir())


def test_gray_of_another_size_is_refused(rec: Reconstruction, tmp_path: Path) -> None:
    with pytest.raises(ScoreError, match="gray image"):
        write_cloud(tmp_path / "cloud.ply", rec, gray=np.zeros((3, 4)))


def test_missing_folder_is_refused_with_a_hint(rec: Reconstruction, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="choose a folder that exists"):
        write_cloud(tmp_path / "nowhere" / "cloud.ply", rec)
