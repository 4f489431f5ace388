"""Twenty rendered stacks of good settings, and the captures of others, pass every check without a warning."""

from pathlib import Path
from typing import Any

import pytest

import decode
import render
import scenes
from fringebench.exchange.capture_export import export
from fringebench.exchange.capture_import import checked
from scenes.files.capture import Capture
from tests.fringebench.real_captures import display_manifest, shell_manifest

SIZE = [320, 240]
# 1024 columns of which each pixel sees three.
WIDTH = 1024.0


def shifts(steps: int, *periods_px: float, **keys: Any) -> dict[str, Any]:
    return {"kind": "phase-shift", "steps": steps, "periods_px": list(periods_px)} | keys


BOTH = {"axes": ["column", "row"]}
EIGHT_BITS = {"sensor.bits": 8, "exposures.auto.level_dn": 90.0}
# Scene, patterns, and what else differs from the shipped scene. Pixels of 3 px weaken the second harmonic of fringes finer than
# these 96 px, which then show another gamma than the coarse ones: a warning, and a true one.
GOOD: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "three steps": ("step", shifts(3, 24.0, 160.0, WIDTH), {}),
    "four steps": ("step", shifts(4, 24.0, 160.0, WIDTH), {}),
    "five steps": ("step", shifts(5, 32.0, 256.0, WIDTH), {}),
    "eight steps, two periods": ("step", shifts(8, 32.0, WIDTH), {}),
    "twelve steps": ("step", shifts(12, 20.0, 140.0, WIDTH), {}),
    "eight bits": ("step", shifts(4, 24.0, 160.0, WIDTH), EIGHT_BITS),
    "little light": ("step", shifts(4, 24.0, 160.0, WIDTH), {"exposures.auto.level_dn": 400.0}),
    "gamma of the projector": ("step", shifts(4, 96.0, WIDTH), {"projectors.0.gamma": 2.2}),
    "gamma, five steps": ("step", shifts(5, 96.0, WIDTH), {"projectors.0.gamma": 1.8}),
    "heterodyne of two": ("step", shifts(8, WIDTH / 32, WIDTH / 31), {}),
    "heterodyne of three": ("step", shifts(4, WIDTH / 43, WIDTH / 42, WIDTH / 36), {}),
    "code, cell of half a period": ("step", shifts(4, 32.0, gray={"bits": 6}), {}),
    "code, cell of a period": ("step", shifts(4, 32.0, gray={"bits": 5, "cell_px": 32.0}), {}),
    "code, three steps, both axes": ("step", shifts(3, 32.0, gray={"bits": 6}, **BOTH), {}),
    "code alone": ("step", {"kind": "gray-code", "bits": [8, 8], "cell_px": 4.0, **BOTH}, {}),
    "both axes": ("step", shifts(4, 24.0, 160.0, WIDTH, **BOTH), {}),
    "room light": ("step", shifts(4, 24.0, 160.0, WIDTH), {"ambient.radiance_w_m2_sr": 3.0}),
    "defocus": ("defocus", shifts(4, 24.0, 160.0, WIDTH), {}),
    "ladder of exposures": ("spi", shifts(4, 24.0, 160.0, WIDTH), {}),
    "grey chart": ("cap", shifts(6, 24.0, 160.0, WIDTH), {"exposures.relative": [1.0, 4.0]}),
}  # fmt: skip


def warnings(manifest: Path) -> list[str]:
    found = checked(Capture.load(manifest)).report.findings
    return [f"{f.name}: {f.message}" for f in found if f.verdict in ("warning", "wrong")]


@pytest.mark.slow
@pytest.mark.parametrize("name", GOOD)
def test_rendered_capture_of_good_settings_gives_no_warning(tmp_path: Path, name: str) -> None:
    scene, patterns, changes = GOOD[name]
    quick = {"camera.resolution": SIZE, "sampling.samples": 16, "patterns": patterns}
    stack = render.expose(render.trace(scenes.load(scene, quick | changes)), seed=1)
    assert decode.reconstruct(stack).valid.mean() > 0.5
    assert warnings(export(stack, tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("manifest", [display_manifest, shell_manifest])
def test_captures_of_others_give_no_warning(tmp_path: Path, manifest: Any) -> None:
    assert warnings(manifest(tmp_path)) == []
