"""Solder paste seen from above: packed spheres, the relief of grains, and the rough metal for pixels that resolve none."""

import numpy as np
import pytest

import render
import scenes
from scenes.scene_files import parse

RIG = """
height_range_mm = [-0.1, 0.4]
[camera]
model = "telecentric"
resolution = [50, 50]
field_width_mm = 0.5
pose = {{ origin_mm = [0.0, 0.0, 100.0] }}
[[projectors]]
model = "telecentric"
resolution = [64, 64]
field_width_mm = 8.0
pose = {{ origin_mm = [{x}, 0.0, {z}] }}
[patterns]
kind = "phase-shift"
steps = 4
periods_px = [64.0]
axes = ["column"]
[exposures]
times_ms = [1.0]
"""
WHITE = """
[materials.white]
kind = "diffuse"
reflectance = 1.0
[[objects]]
label = "paste"
material = "white"
shape = {{ kind = "plate", size_mm = [3.0, 3.0] }}
"""
PAD = """
[board]
kind = "parametric"
seed = {seed}
size_mm = [4.0, 4.0]
parts = [{{ package = "bga", position_mm = [0.0, 0.0], columns = 1, rows = 1, pad_mm = 0.8, pitch_mm = 2.0 }}]
[board.paste]
texture = "{texture}"
powder = {powder}
transfer = {{ spread = 0.0 }}
"""
SPHERES = """
[[objects]]
label = "paste"
material = "flux"
shape = {{ kind = "box", size_mm = [0.7, 0.7, 0.09] }}
[[objects]]
label = "paste"
material = "solder"
smooth = true
shape = {{ kind = "grains", powder = {powder}, size_mm = [0.7, 0.7], height_mm = 0.12, bed_mm = 0.09, seed = {seed}, subdivisions = 2 }}
"""


def radiance(body: str, angle_deg: float, depth: int = 4, **values: object) -> float:
    """Mean over the paste in even light at an angle to the vertical."""
    angle = np.deg2rad(angle_deg)
    text = (RIG + body).format(x=-100 * np.sin(angle), z=100 * np.cos(angle), **values)
    scene = parse(text)
    light = render.trace(scene, samples=16, depth=depth)
    return float(light.total[0, 0][render.truth(scene).region("paste")].mean())


@pytest.mark.slow
# What docs/boards.md claims: a tenth where inspection machines light, some more at steeper and flatter light.
@pytest.mark.parametrize(
    ("angle_deg", "within"), [(15.0, 0.15), (27.0, 0.1), (45.0, 0.1), (60.0, 0.15)]
)
def test_rough_metal_is_as_bright_as_grains_that_are_not_resolved(
    angle_deg: float, within: float
) -> None:
    white = radiance(WHITE, angle_deg, depth=1)
    smooth = radiance(PAD, angle_deg, texture="smooth", powder=4, seed=0) / white
    # GGX microfacets, seen along the normal, single scattering: F D G / (4 cos), with tin's F = 0.82 at normal incidence.
    cos, alpha2 = np.cos(np.deg2rad(angle_deg)), 0.75**2
    half2 = np.cos(np.deg2rad(angle_deg / 2)) ** 2
    shadow = 2 * cos / (cos + np.sqrt(alpha2 + (1 - alpha2) * cos**2))
    assert smooth == pytest.approx(
        0.824 * alpha2 / (1 - (1 - alpha2) * half2) ** 2 * shadow / (4 * cos), rel=0.02
    )
    for powder in (3, 4, 5):
        for body in (SPHERES, PAD):
            seen = [
                radiance(body, angle_deg, texture="granular", powder=powder, seed=seed) / white
                for seed in (1, 2)
            ]
            # Some 200 grains of type 3 are seen in each: their glints scatter by a few percent.
            assert np.mean(seen) == pytest.approx(smooth, rel=within), (body, powder, seen)


def test_grains_and_the_flux_between_them_are_paste_of_the_same_volume() -> None:
    close = {
        "camera.field_width_mm": 0.4,
        "camera.resolution": [64, 48],
        "board.region": {"centre_mm": [4.2, -2.4], "size_mm": [1.0, 1.0]},
    }
    grains = scenes.load("spi", close)
    smooth = scenes.load("spi", close | {"board.paste.texture": "smooth"})
    names = {part.material_name for part in scenes.parts(grains) if part.label == "paste"}
    assert {"solder", "flux"} <= names
    assert {p.material_name for p in scenes.parts(smooth) if p.label == "paste"} == {"solder-paste"}
    for one, two in zip(
        scenes.board_truth(grains).pads, scenes.board_truth(smooth).pads, strict=True
    ):
        assert one.volume_mm3 == pytest.approx(two.volume_mm3, rel=1e-9)
    assert (
        render.truth(grains).region("paste") == render.truth(smooth).region("paste")
    ).mean() > 0.99
    # As shipped its pixels of 15.6 um resolve no grains of type 4.
    board = scenes.load("spi").seen_board
    assert board is not None and board.paste.texture == "smooth"
