"""The map of methods: cells that theory foresees, words, files."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

import fringebench as fb
import scenes
from fringebench.experiments.surface_methods import METHODS, SURFACES, Cell, MethodMap, map_scene
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
    devices = [rig.camera, *rig.projectors, *([rig.second_camera] if rig.second_camera else [])]
    for device in (one.projection() for one in devices):
        middle = device.project(np.zeros((1, 3)))[0][0]
        np.testing.assert_allclose(middle, np.array([device.width, device.height]) / 2, atol=1e-6)
        seen = device.project(np.asarray(thing.vertices))[0]
        assert ((seen > 0) & (seen < (device.width, device.height))).all()
    if rig.second_camera:
        eyes = [one.projection() for one in (rig.camera, rig.second_camera)]
        assert len({(eye.width, eye.height, eye.fx, eye.fy) for eye in eyes}) == 1


def test_random_dots_are_two_and_a_half_camera_pixels_wide() -> None:
    scene = map_scene("active-stereo", "matt", (320, 240), 4)
    rig = scene.calibration()
    camera, light = rig.camera.projection(), rig.projectors[0].projection()
    assert isinstance(scene.patterns, scenes.RandomDots)
    # Both stand 300 mm away, within some per mille.
    dot_mm = scene.patterns.dot_px / light.fx * np.linalg.norm(light.origin_mm)
    assert dot_mm * camera.fx / np.linalg.norm(camera.origin_mm) == pytest.approx(2.5, rel=0.01)


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
