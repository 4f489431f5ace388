"""Exported stacks read back the same."""

import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from fringebench.exchange.capture_export import export
from fringebench.gate.cases import CASES, RENDERED, plane_stack
from scenes.acquisition.patterns import gray_frames
from scenes.files.capture import Capture
from scenes.support.errors import FileError
from tests.fringebench.exchange.numpy_decoder import heights_mm


def stack(name: str = "bench", dtype: type = np.uint16) -> scenes.Stack:
    """Random counts under a shipped scene's patterns: files do not care what they show."""
    scene = scenes.load(name, {"camera.resolution": [20, 15]})
    shape = (scene.exposures.count, len(scene.frames), 15, 20)
    counts: np.ndarray = np.random.default_rng(1).integers(0, 200, shape).astype(dtype)
    times = tuple(float(2**e) for e in range(shape[0]))
    return scenes.Stack(counts, scene.frames, times, scene.sensor, scene.calibration())


@pytest.mark.parametrize(("name", "dtype"), [("bench", np.uint16), ("chapter", np.uint8)])
def test_exported_stack_reads_back_the_same(tmp_path: Path, name: str, dtype: type) -> None:
    ours = stack(name, dtype)
    back = Capture.load(export(ours, tmp_path / "out")).stack()
    np.testing.assert_array_equal(back.frames, ours.frames)
    assert back.frames.dtype == ours.frames.dtype
    assert back.patterns == ours.patterns
    assert back.exposure_ms == ours.exposure_ms
    assert back.sensor == ours.sensor
    rig = back.calibration
    assert rig is not None and ours.calibration is not None
    for one, two in (
        (rig.camera, ours.calibration.camera),
        (rig.projectors[0], ours.calibration.projectors[0]),
    ):
        np.testing.assert_allclose(one.projection().R, two.projection().R, atol=1e-12)
        np.testing.assert_allclose(one.projection().t, two.projection().t, atol=1e-9)


def test_exported_files_are_numbered_in_order_and_hold_the_counts(tmp_path: Path) -> None:
    ours = stack()
    manifest = tomllib.loads(export(ours, tmp_path).read_text())
    assert manifest["files"][:2] == ["e00_f000.png", "e00_f001.png"]
    assert len(manifest["files"]) == ours.frames.shape[0] * ours.frames.shape[1]
    last = cv2.imread(str(tmp_path / manifest["files"][-1]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(last, ours.frames[-1, -1])
    assert manifest["saturation_dn"] == ours.saturation_dn


def test_gray_code_and_uneven_steps_read_back_the_same(tmp_path: Path) -> None:
    ours = stack()
    fringes = [
        replace(f, phase_shift_rad=f.phase_shift_rad + 0.1 * f.step) for f in ours.patterns[:4]
    ]
    gray = gray_frames("column", 3, 8.0, inverted=True)
    uniform = [scenes.Frame("column", 0.0, 0, 1, 0.0, 0, kind) for kind in ("white", "black")]
    shown = (*fringes, *gray, *uniform)
    mixed = replace(ours, frames=ours.frames[:, : len(shown)], patterns=shown)
    back = Capture.load(export(mixed, tmp_path)).stack()
    assert [f.kind for f in back.patterns] == [f.kind for f in shown]
    np.testing.assert_allclose(
        [f.phase_shift_rad for f in back.patterns], [f.phase_shift_rad for f in shown], atol=1e-12
    )
    assert back.patterns[4:] == shown[4:]


def test_codings_against_indirect_light_read_back_the_same(tmp_path: Path) -> None:
    codings: tuple[scenes.UnevenSteps | scenes.ModulatedPhaseShift, ...] = (
        scenes.UnevenSteps(periods_px=(14.57, 16.09, 16.24), steps=(3, 1, 1)),
        scenes.UnevenSteps(periods_px=(14.0, 16.0), steps=(3, 2), axes=("row",)),
        scenes.ModulatedPhaseShift(periods_px=(128.0, 1024.0), carrier_px=16.0, carrier_steps=4),
    )
    for k, coding in enumerate(codings):
        shown = coding.frames()
        counts = np.random.default_rng(1).integers(0, 200, (1, len(shown), 15, 20), np.uint16)
        ours = replace(stack(), frames=counts, patterns=shown, exposure_ms=(1.0,))
        back = Capture.load(export(ours, tmp_path / str(k))).stack()
        assert back.patterns == shown


def test_stack_that_png_or_manifest_cannot_hold_is_refused(tmp_path: Path) -> None:
    ours = stack()
    with pytest.raises(FileError, match="float32"):
        export(replace(ours, frames=ours.frames.astype(np.float32)), tmp_path)
    with pytest.raises(FileError, match="complete fringe sets"):
        export(replace(ours, frames=ours.frames[:, 1:], patterns=ours.patterns[1:]), tmp_path)
    two = (*ours.patterns[:-4], *(replace(f, projector=1) for f in ours.patterns[-4:]))
    pair = (*ours.patterns[:-4], *(replace(f, camera=1) for f in ours.patterns[-4:]))
    with pytest.raises(FileError, match="second camera"):
        export(replace(ours, patterns=pair), tmp_path)
    with pytest.raises(FileError, match="--projector"):
        export(replace(ours, patterns=two), tmp_path)
    assert not (tmp_path / "manifest.toml").exists()
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="folder"):
        export(ours, tmp_path / "file")


def test_intrinsics_are_those_of_the_exported_images(tmp_path: Path) -> None:
    ours = stack()  # shipped at 640 x 480, here at 20 x 15
    camera = tomllib.loads(export(ours, tmp_path).read_text())["rig"]["camera"]
    assert ours.calibration is not None
    geometry = ours.calibration.camera.projection()
    assert camera["resolution"] == [20, 15]
    assert (camera["fx_px"], camera["cx_px"]) == (geometry.fx, geometry.cx) == (150.0, 10.0)
    assert "calibrated_at" not in camera


def test_decoder_written_from_the_manifest_alone_finds_the_heights(tmp_path: Path) -> None:
    scene = scenes.load(
        "step", {"camera.resolution": [160, 120], "sampling.samples": 16, "sensor.psf": "none"}
    )
    light = render.trace(scene)
    truth = render.truth(scene, light)
    manifest = export(render.expose(light), tmp_path)
    found = heights_mm(manifest)
    rec = decode.reconstruct(render.expose(light))
    base = evaluation.scored(truth, "base") & rec.valid & np.isfinite(found)
    assert base.sum() > 0.9 * evaluation.scored(truth, "base").sum()
    error = (found - truth.height_mm)[base]
    # The noise that our decoder predicts for the same frames; wrong intrinsics err by millimetres everywhere.
    predicted = float(np.sqrt(np.mean(rec.sigma_mm[base] ** 2)))
    assert np.sqrt(np.mean(error**2)) < 1.2 * predicted
    assert abs(error.mean()) < 0.3 * predicted


@pytest.mark.parametrize("case", CASES)
def test_manifest_says_all_that_a_decoder_needs_for_each_case_of_the_gate(
    case: str, tmp_path: Path
) -> None:
    """Pinhole and telecentric rigs, and coarse fringes narrower than the image, without noise."""
    name, keys = RENDERED.get(case, ("chapter", {"camera.resolution": [240, 80]}))
    shown = plane_stack(scenes.load(name, keys))
    low, high = shown.calibration.height_range_mm if shown.calibration else (0.0, 0.0)
    error = heights_mm(export(shown, tmp_path)) - (low + high) / 2.0
    # Counts are rounded: errors below 1/500 of the range; a wrong order errs by more than the whole range.
    lit = np.isfinite(error)
    assert lit.mean() > 0.9
    assert np.abs(error[lit]).max() < 0.02 * (high - low)
