"""Shared surfaces give the same results as new ones, and are refused for other scenes."""

import numpy as np
import pytest

import render
import scenes
from scenes.support.errors import RenderError

SMALL = {"camera.resolution": [48, 36], "sampling.samples": 4}


# Smooth metal and paint; a board, whose truth knows pads.
@pytest.mark.parametrize("name", ["bench", "spi"])
def test_shared_surfaces_give_the_same_light_and_truth(name: str) -> None:
    scene = scenes.load(name, SMALL)
    shared = render.surfaces(scene)
    light, own = render.trace(scene, surfaces=shared), render.trace(scene)
    again = render.trace(scene, surfaces=shared)
    for transport in (light, again):
        np.testing.assert_array_equal(transport.total, own.total)
        np.testing.assert_array_equal(transport.label, own.label)
    truth, alone = render.truth(scene, light, shared), render.truth(scene, own)
    for image in ("xyz_mm", "normal", "label", "pad", "lit", "column_px", "direct_fractions"):
        np.testing.assert_array_equal(getattr(truth, image), getattr(alone, image))


def test_truth_without_transport_uses_the_given_surfaces() -> None:
    scene = scenes.load("step", SMALL)
    shared = render.surfaces(scene)
    np.testing.assert_array_equal(
        render.truth(scene, surfaces=shared).direct_fractions, render.truth(scene).direct_fractions
    )


def test_surfaces_give_the_same_light_with_a_moved_camera() -> None:
    scene = scenes.load("step", SMALL)
    moved = scenes.load("step", SMALL | {"camera.cx_px": 300.0})
    np.testing.assert_array_equal(
        render.trace(moved, surfaces=render.surfaces(scene)).total, render.trace(moved).total
    )


@pytest.mark.parametrize(
    "change",
    [
        {"objects.1.position_mm": [1.0, 0.0, 0.0]},
        {"materials.grey-paint": {"kind": "diffuse", "reflectance": 0.25}},
    ],
)
def test_surfaces_of_another_scene_are_refused(change: dict[str, object]) -> None:
    scene, other = scenes.load("step", SMALL), scenes.load("step", SMALL | change)
    wrong = render.surfaces(other)
    with pytest.raises(RenderError, match="surfaces of another scene"):
        render.trace(scene, surfaces=wrong)
    with pytest.raises(RenderError, match="surfaces of another scene"):
        render.truth(scene, render.trace(scene), wrong)
    with pytest.raises(RenderError, match="surfaces of another scene"):
        render.trace(scene, samples=1, phase_error_rad=0.1, surfaces=wrong)
