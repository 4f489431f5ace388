"""The map of methods: cells that theory foresees, words, files."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import decode
import fringebench as fb
import scenes
from fringebench.experiments.surface_methods import (
    METHODS,
    SURFACES,
    Cell,
    MethodMap,
    judged,
    map_scene,
)
from fringebench.pages.method_map_page import map_rows
from scenes.support.errors import ScoreError
from tests.conftest import Call


def cells(found: MethodMap) -> dict[tuple[str, str], Cell]:
    return {(cell.method, cell.surface): cell for cell in found.cells}


@pytest.mark.slow
def test_command_writes_cells_with_reasons_figure_and_page(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--method", "deflectometry", "--surface", "matt", "--surface", "mirror", "-o", "out")
    size = ("--resolution", 80, 60, "--samples", 4)
    status, out, err = call("methods", *words, *size, "--json")
    assert status == 0, err
    matt, mirror = json.loads(out)["cells"]
    assert (matt["coverage"], matt["why"], matt["rms_mm"]) == (0.0, "no-image", None)
    # Fringes fit the small image: at most the outline is lost, some 105 of its 30 x 22 pixels.
    assert mirror["coverage"] - mirror["wrong"] > 0.8
    assert json.loads(Path("out/methods.json").read_text())["cells"] == [matt, mirror]
    assert "no-image" in Path("out/report.html").read_text()
    assert Path("out/methods.png").stat().st_size > 0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("surface", SURFACES)
def test_all_devices_look_at_the_middle_of_the_object_and_see_it_whole(
    method: str, surface: str
) -> None:
    scene = map_scene(method, surface, (64, 48), 4)
    rig = scene.calibration()
    (thing,) = (part.mesh for part in scenes.parts(scene) if part.label == "object")
    below = [part.mesh.bounds for part in scenes.parts(scene) if part.label != "object"]
    # It rests on the smallest of what is below it, beyond which a grain of powder 3 reaches 0.0225 mm at most.
    assert (np.abs(thing.bounds[:, :2]) <= min(b[1, :2].min() for b in below) + 0.0226).all()
    devices = [rig.camera, *rig.projectors, *([rig.second_camera] if rig.second_camera else [])]
    for device in (one.projection() for one in devices):
        middle = device.project(np.zeros((1, 3)))[0][0]
        np.testing.assert_allclose(middle, np.array([device.width, device.height]) / 2, atol=1e-6)
        seen = device.project(np.asarray(thing.vertices))[0]
        assert ((seen > 0) & (seen < (device.width, device.height))).all()
    if rig.second_camera:
        eyes = [one.projection() for one in (rig.camera, rig.second_camera)]
        assert len({(eye.width, eye.height, eye.fx, eye.fy) for eye in eyes}) == 1


@pytest.mark.parametrize(
    ("columns", "periods_px"),
    # From 200 columns on fringes are as listed; below, as many camera pixels wide as there, up to the projector's width.
    [(320, [32.0, 256.0, 1024.0]), (100, [64.0, 512.0, 1024.0]), (40, [160.0, 1024.0])],
)
def test_small_camera_sees_wider_fringes(columns: int, periods_px: list[float]) -> None:
    patterns = map_scene("fringe-projection", "matt", (columns, columns * 3 // 4), 4).patterns
    assert isinstance(patterns, scenes.PhaseShift)
    assert list(patterns.periods_px) == periods_px


def test_random_dots_are_two_and_a_half_camera_pixels_wide() -> None:
    scene = map_scene("active-stereo", "matt", (320, 240), 4)
    rig = scene.calibration()
    camera, light = rig.camera.projection(), rig.projectors[0].projection()
    assert isinstance(scene.patterns, scenes.RandomDots)
    # Both stand 300 mm away, within some per mille.
    dot_mm = scene.patterns.dot_px / light.fx * np.linalg.norm(light.origin_mm)
    assert dot_mm * camera.fx / np.linalg.norm(camera.origin_mm) == pytest.approx(2.5, rel=0.01)


@pytest.mark.parametrize(
    ("wrong", "shadowed", "why"), [(10, 12, "shadow"), (14, 12, "wrong"), (2, 1, "")]
)
def test_cell_counts_the_objects_pixels_and_names_what_most_of_them_fail_by(
    wrong: int, shadowed: int, why: str
) -> None:
    region = np.zeros((10, 10), np.bool_)
    region[:5] = True
    off = np.full(100, 0.1)
    off[:wrong], off[50:] = -0.4, 9.0
    reason = np.zeros(100, np.uint8)
    reason[50 - shadowed :] = decode.Reason.SHADOW
    rec = decode.Reconstruction.of_heights(2.0 + off.reshape(10, 10))
    rec = replace(rec, reason=reason.reshape(10, 10))
    cell = judged("a", "b", rec, np.full((10, 10), 2.0), region, 0.3)
    good = 50 - wrong - shadowed
    assert (cell.pixels, cell.coverage, cell.wrong) == pytest.approx(
        (50, 1.0 - shadowed / 50, wrong / 50)
    )
    squares = (0.4**2 * wrong + 0.1**2 * good) / (wrong + good)
    assert (cell.rms_mm, cell.median_abs_mm) == pytest.approx((np.sqrt(squares), 0.1), rel=1e-5)
    share = {"shadow": shadowed / 50, "wrong": wrong / 50, "": 0.0}[why]
    assert cell.why == why
    assert cell.why_share == pytest.approx(share)


def test_unknown_names_are_refused_with_the_nearest() -> None:
    with pytest.raises(ScoreError, match=r"unknown surface 'miror'.*mirror"):
        fb.methods(surfaces=["miror"])
    with pytest.raises(ScoreError, match="unknown method 'stereo'"):
        fb.methods(["stereo"])


def test_row_holds_coverage_error_and_cause() -> None:
    found = MethodMap(
        (
            Cell("a", "matt", 100, 0.5, 0.1, 0.02, 0.01, "shadow", 0.5),
            Cell("b", "matt", 100, 0.0, 0.0, 1.0, 1.0, "no-image", 1.0),
        ),
        (80, 60),
    )
    row = ["matt", "50 %\n20 µm\nshadow 50 %", "0 %\nno-image 100 %"]
    # Numbers and units stay in one line.
    joined = [re.sub(" (?=[%µ])", "\u00a0", cell) for cell in row]
    assert map_rows(found) == (["a", "b"], [joined])


@pytest.mark.trust
def test_every_method_fails_where_theory_says_and_nowhere_else() -> None:
    found = cells(fb.methods())
    assert set(found) == {(method, surface) for method in METHODS for surface in SURFACES}
    right = {pair: cell.coverage - cell.wrong for pair, cell in found.items()}
    opaque = ("matt", "glossy", "solder", "grains", "step")
    for method in ("fringe-projection", "phase-stereo", "active-stereo"):
        # Edges and shadows of the step take some per cent.
        assert all(right[method, surface] > 0.85 for surface in opaque), method
        # Light enters a clear body, and a mirror sends it elsewhere.
        assert right[method, "translucent"] < 0.3
        assert right[method, "mirror"] < 0.1
    for surface in ("matt", "glossy", "black", "solder", "step"):
        assert right["passive-stereo", surface] < 0.3
        assert found["passive-stereo", surface].why == "no-texture"
    for surface in SURFACES:
        cell = found["deflectometry", surface]
        assert (right["deflectometry", surface] > 0.9) == (surface == "mirror")
        assert cell.why == ("" if surface == "mirror" else "no-image")
    # Phase needs no block: heights are several times better than those of dots.
    for surface in opaque:
        rms = [found[m, surface].rms_mm or 0.0 for m in ("phase-stereo", "active-stereo")]
        assert rms[0] < 0.6 * rms[1]
