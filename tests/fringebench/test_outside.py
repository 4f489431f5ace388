"""Outside decoders on our stacks; where no environment has them, only what needs none."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

import scenes
from fringebench import outside
from fringebench.outside import Row, compare, eight_bits, heights_mm, run_adapter, table
from scenes import Calibration
from scenes.errors import FileError

needs_outside = pytest.mark.skipif(
    not os.environ.get(outside.VARIABLE),
    reason=f"{outside.VARIABLE} names no environment with opencv-contrib and fringes",
)


@pytest.fixture(scope="module", params=["bench", "step", "ink"])
def rows(request: pytest.FixtureRequest) -> dict[tuple[str, str], Row]:
    return {(row.patterns, row.decoder): row for row in compare(request.param)}


@needs_outside
@pytest.mark.slow
def test_opencv_reads_our_gray_code_pixel_by_pixel_as_we_do(
    rows: dict[tuple[str, str], Row],
) -> None:
    theirs = rows["Gray code", "OpenCV structured_light"]
    assert theirs.agreement >= 0.99
    assert theirs.coverage > 0.5
    assert rows["Gray code", "fringebench"].coverage >= theirs.coverage


@needs_outside
@pytest.mark.slow
def test_fringes_reads_our_sinusoids_to_a_thousandth_of_a_radian(
    rows: dict[tuple[str, str], Row],
) -> None:
    theirs, ours = rows["4 steps", "fringes"], rows["4 steps", "fringebench"]
    # float32 arctangents of the same counts
    assert theirs.agreement > 0.9999
    assert theirs.phase_rad == pytest.approx(ours.phase_rad, rel=0.05)
    assert ours.outliers <= theirs.outliers


@needs_outside
@pytest.mark.slow
def test_opencv_sinusoids_find_the_phase_but_blur_it(rows: dict[tuple[str, str], Row]) -> None:
    theirs, ours = rows["3 steps", "OpenCV structured_light"], rows["3 steps", "fringebench"]
    # its filter mixes neighbours, so no pixel is the same; the phase is still the phase, in sign and origin
    assert theirs.phase_rad < 0.05
    assert theirs.phase_rad > ours.phase_rad


def test_heights_of_the_true_columns_are_the_true_heights() -> None:
    rig = Calibration.of(scenes.load("step"))
    camera, light = rig.camera.projection(), rig.projectors[0].projection()
    origin, direction = camera.rays(camera.pixel_centres())
    height = np.random.default_rng(0).uniform(0.0, 2.0, origin.shape[:2])
    points = origin + ((height - origin[..., 2]) / direction[..., 2])[..., None] * direction
    column = light.project(points)[0][..., 0]
    np.testing.assert_allclose(heights_mm(rig, column), height, atol=1e-8)
    column[0, 0] = np.nan
    assert np.isnan(heights_mm(rig, column)[0, 0])


def test_eight_bits_see_the_same_light() -> None:
    for name in ("step", "chapter"):
        sensor = scenes.load(name).sensor
        fewer = eight_bits(sensor)
        assert fewer.bits == 8
        scale = 2.0 ** (8 - sensor.bits)
        for radiance in (0.0, 1.0, 5.0):
            wanted = sensor.mean_dn(radiance, 2.0) * scale
            assert fewer.mean_dn(radiance, 2.0) == pytest.approx(float(wanted), rel=1e-9)


def test_without_an_environment_the_way_to_get_one_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv(outside.VARIABLE, raising=False)
    with pytest.raises(FileError, match=outside.VARIABLE):
        run_adapter(outside.OPENCV, tmp_path / "manifest.toml")
    # this environment lacks structured_light, so the adapter fails; its reason is passed on
    with pytest.raises(FileError, match=r"adapter opencv_structured_light failed"):
        run_adapter(outside.OPENCV, tmp_path / "none.toml", 0, sys.executable)
    with pytest.raises(FileError, match="did not run"):
        run_adapter(outside.OPENCV, tmp_path / "none.toml", 0, str(tmp_path / "no-python"))


def test_table_leaves_out_what_does_not_apply() -> None:
    nan = float("nan")
    text = table([Row("step", "3 steps", "theirs", 1.0, 0.5, 0.01, nan, nan, 1.0)])
    assert (
        text.splitlines()[-1] == "| step | 3 steps | theirs | 100.00% | 50.00% | 10.0 mrad |  |  |"
    )
