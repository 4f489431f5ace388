"""Outside decoders on rendered stacks; without an environment that has them, only what needs none."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import decode
import scenes
from benchmarks import outside_decoders
from benchmarks.outside_decoders import (
    OutsideRow,
    compare_with_outside,
    eight_bits,
    run_adapter,
    table,
)
from scenes.support.errors import FileError

needs_outside = pytest.mark.skipif(
    not os.environ.get(outside_decoders.VARIABLE),
    reason=f"{outside_decoders.VARIABLE} names no environment with opencv-contrib and fringes",
)


@pytest.fixture(scope="module", params=["bench", "step", "ink"])
def rows(request: pytest.FixtureRequest) -> dict[tuple[str, str], OutsideRow]:
    return {(row.patterns, row.decoder): row for row in compare_with_outside(request.param)}


@needs_outside
@pytest.mark.slow
def test_opencv_decodes_gray_code_to_the_same_cells(
    rows: dict[tuple[str, str], OutsideRow],
) -> None:
    theirs = rows["Gray code", "OpenCV structured_light"]
    assert theirs.agreement >= 0.99
    assert theirs.coverage > 0.5
    assert rows["Gray code", "fringebench"].coverage >= theirs.coverage


@needs_outside
@pytest.mark.slow
def test_fringes_decodes_sinusoids_to_the_same_phase(
    rows: dict[tuple[str, str], OutsideRow],
) -> None:
    theirs, ours = rows["4 steps", "fringes"], rows["4 steps", "fringebench"]
    # Both are float32 arctangents of the same counts.
    assert theirs.agreement > 0.9999
    assert theirs.phase_rad == pytest.approx(ours.phase_rad, rel=0.05)
    assert ours.outliers <= theirs.outliers


@needs_outside
@pytest.mark.slow
def test_opencv_sinusoids_find_a_blurred_phase(rows: dict[tuple[str, str], OutsideRow]) -> None:
    theirs, ours = rows["3 steps", "OpenCV structured_light"], rows["3 steps", "fringebench"]
    # Its filter mixes neighbours, so no pixel agrees exactly; sign and origin of the phase do.
    assert theirs.phase_rad < 0.05
    assert theirs.phase_rad > ours.phase_rad


def test_heights_of_the_true_columns_are_the_true_heights() -> None:
    rig = scenes.load("step").calibration()
    camera, light = rig.camera.projection(), rig.projectors[0].projection()
    height = np.random.default_rng(0).uniform(0.0, 2.0, (camera.height, camera.width))
    column = light.project(camera.points_at(height))[0][..., 0]
    np.testing.assert_allclose(decode.triangulate(column, rig), height, atol=1e-8)
    column[0, 0] = np.nan
    assert np.isnan(decode.triangulate(column, rig)[0, 0])


def test_eight_bit_sensor_has_the_same_scale_of_light() -> None:
    for name in ("step", "chapter"):
        sensor = scenes.load(name).sensor
        fewer = eight_bits(sensor)
        assert fewer.bits == 8
        scale = 2.0 ** (8 - sensor.bits)
        for radiance in (0.0, 1.0, 5.0):
            wanted = sensor.mean_dn(radiance, 2.0) * scale
            assert fewer.mean_dn(radiance, 2.0) == pytest.approx(float(wanted), rel=1e-9)


def test_missing_outside_environment_is_explained(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(outside_decoders.VARIABLE, raising=False)
    with pytest.raises(FileError, match=outside_decoders.VARIABLE):
        run_adapter(outside_decoders.OPENCV, tmp_path / "manifest.toml")
    # This environment lacks structured_light, so the adapter fails; its reason is passed on.
    with pytest.raises(FileError, match=r"adapter opencv_structured_light failed"):
        run_adapter(outside_decoders.OPENCV, tmp_path / "none.toml", 0, sys.executable)
    with pytest.raises(FileError, match="did not run"):
        run_adapter(outside_decoders.OPENCV, tmp_path / "none.toml", 0, str(tmp_path / "no-python"))


def test_table_leaves_out_figures_that_do_not_apply() -> None:
    nan = float("nan")
    text = table([OutsideRow("step", "3 steps", "theirs", 1.0, 0.5, 0.01, nan, nan, 1.0)])
    assert (
        text.splitlines()[-1] == "| step | 3 steps | theirs | 100.00% | 50.00% | 10.0 mrad |  |  |"
    )
