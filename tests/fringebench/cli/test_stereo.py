"""The command `stereo`, on two synthetic cameras: files in, heights and JSON out."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

import decode
from fringebench.exchange.capture_export import export
from scenes import Calibration, Stack
from scenes.acquisition.sensor import SimpleSensor
from scenes.rig import opencv_calibration
from scenes.rig.projectors import PinholeProjector
from scenes.support.safe_parse import parse_toml
from tests.conftest import Call
from tests.decode.test_stereo_phase import BOTH, camera, look


@pytest.fixture
def captured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Stacks and calibration of two cameras in files; the true depth in front of the left one."""
    monkeypatch.chdir(tmp_path)
    left, right = camera(-8.0), camera(8.0)
    lamp = PinholeProjector.model_validate(
        right.model_dump(exclude={"lens"}) | {"reference_mm": 60.0}
    )
    pair = Calibration(camera=left, projectors=(lamp,), height_range_mm=(-1.0, 4.0))
    opencv_calibration.write("pair.yml", pair)
    (one, height), (two, _) = look(left, BOTH, 0.0, 0), look(right, BOTH, 0.0, 1)
    one.write("left.exr")
    two.write("right.exr")
    eye = left.projection()
    return np.asarray(eye.project(eye.points_at(height))[1])


def test_stereo_from_files_finds_the_surface(captured: np.ndarray, call: Call) -> None:
    words = ("stereo", "left.exr", "right.exr", "pair.yml", "--depth-mm", 50, 70, "--json")
    status, out, err = call(*words)
    assert status == 0, err
    answer = json.loads(out)
    rec = decode.Reconstruction.read("reconstruction.exr")
    assert answer["reconstruction"] == "reconstruction.exr"
    assert answer["reasons"]["ok"] == pytest.approx(rec.valid.mean()) and rec.valid.mean() > 0.5
    # the bound that tests/decode/test_stereo.py derives, of the same cameras and surface
    assert np.abs(rec.height_mm + captured)[rec.valid].max() < 2e-3


def test_stereo_pair_that_does_not_fit_is_refused(captured: np.ndarray, call: Call) -> None:
    for words, said in (
        (("left.exr", "right.exr", "pair.yml", "--depth-mm", 500, 700), "match"),
        (("left.exr", "right.exr", "missing.yml", "--depth-mm", 50, 70), "missing.yml"),
        (("left.exr", "pair.yml", "pair.yml", "--depth-mm", 50, 70), "pair.yml"),
    ):
        status, out, err = call("stereo", *words)
        assert (status, out) == (2, "")
        assert said in err
        assert not Path("reconstruction.exr").exists()


def test_parts_of_other_names_are_found_by_name(captured: np.ndarray, call: Call) -> None:
    text = Path("pair.yml").read_text()
    Path("own.yml").write_text(text.replace("rotation", "Turn").replace("R:", "Turn:", 1))
    words = ("left.exr", "right.exr", "own.yml", "--depth-mm", 50, 70)
    status, _, _ = call("stereo", *words, "--name", "rotation=Turn", "--roi", 20, 60, 20, 80)
    assert status == 0
    rec = decode.Reconstruction.read("reconstruction.exr")
    assert rec.valid.any() and not rec.valid[:20].any()
    status, _, err = call("stereo", *words, "--name", "rotation")
    assert (status, "PART=NAME" in err) == (2, True)


def test_both_views_in_one_manifest_are_imported_and_decoded(
    captured: np.ndarray, call: Call
) -> None:
    for name in ("left", "right"):
        stack = Stack.read(f"{name}.exr")
        counts = np.rint(100.0 * stack.frames).astype(np.uint16)
        sensor = SimpleSensor(bits=16, sigma_dn=1.0)
        export(replace(stack, frames=counts, sensor=sensor, calibration=None), name)
    tree = parse_toml(Path("left/manifest.toml").read_text())
    files = tree.pop("files")
    views = {"files": files, "folder": "left", "second_view": {"files": files, "folder": "right"}}
    pair = {"calibration": {"files": ["pair.yml"], "depth_range_mm": [50.0, 70.0]}}
    Path("pair.toml").write_text(
        tomli_w.dumps({**tree, **views, "projector_resolution": [400, 400]} | pair)
    )
    status, out, err = call("import", "pair.toml", "-o", "pair.exr", "--json")
    assert status == 0, err
    names = {f["name"].split(",")[0] for f in json.loads(out)["findings"]}
    assert names == {"first view", "second view"}
    assert call("decode", "pair.exr", "-o", "heights.exr")[0] == 0
    rec = decode.Reconstruction.read("heights.exr")
    assert rec.valid.mean() > 0.5
    # the bound of the first test: rounding of 0.29 DN on a modulation of thousands adds nothing to it
    assert np.abs(rec.height_mm + captured)[rec.valid].max() < 2e-3
