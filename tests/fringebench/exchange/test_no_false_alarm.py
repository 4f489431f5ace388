"""Checks of rendered stacks: good settings pass without a warning, and a warning is a true one."""

from typing import Any

import pytest

import decode
import render
import scenes

# Light that arrives by way of other surfaces contradicts the order of every other pixel of the groove: a true warning. The
# projector of the measured rig has a gamma of 2, and its finest fringes are two to five camera pixels wide and out of focus
# on the cap and the step, where one pixel in ten misses its order.
WARNED = {"interreflection": {"agreement"}, "measured-rig": {"agreement", "gamma"}}
GOOD: list[tuple[str, dict[str, Any]]] = [
    *((name, {}) for name in scenes.shipped() if name != "stereo"),  # no fringes
    ("bench", {"patterns.steps": 3}),
    ("bench", {"patterns.steps": 8}),
    ("cap", {"sensor.psf": "diffraction"}),
    ("step", {"patterns.axes": ["column", "row"]}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes"), GOOD)
def test_good_settings_give_no_warning(name: str, changes: dict[str, Any]) -> None:
    scene = scenes.load(name)
    columns, rows = scene.camera.resolution
    half = {"camera.resolution": [columns // 2, rows // 2], "sampling.render_noise": None}
    scene = scenes.load(name, half | changes)
    stack = render.expose(render.trace(scene, samples=16, seed=0), seed=0)
    for projector in sorted({frame.projector for frame in stack.patterns}):
        found = decode.check(stack, projector=projector).findings
        loud = [f for f in found if f.verdict in ("warning", "wrong")]
        assert {f.name.split(", ")[-1] for f in loud} <= WARNED.get(name, set()), loud
        assert all(f.verdict == "warning" for f in loud)
