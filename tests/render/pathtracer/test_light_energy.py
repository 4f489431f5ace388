"""Light transport where the answer is known in closed form."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.special import j1

import render
from scenes import Scene
from tests.render import rigs

E0 = 100.0
WHITE = 0.8  # reflectance of white-paint

# Sums of tens of float32 terms of one sign.
FLOAT32 = 1e-5


def white_response(scene: Scene, **how: Any) -> NDArray[np.float32]:
    """Radiance of a white pattern, (row, col)."""
    return np.asarray(render.trace(scene, **how).total[0, 0])


@pytest.mark.parametrize("incidence_deg", [0.0, 30.0, 60.0])
def test_telecentric_light_on_a_tilted_plate_gives_lambert_radiance(incidence_deg: float) -> None:
    tilt = np.deg2rad(incidence_deg)
    projector = rigs.telecentric((64, 48), field_mm=400.0)
    projector["pose"] = {"origin_mm": (-200 * np.sin(tilt), 0.0, 200 * np.cos(tilt))}
    scene = rigs.scene(rigs.pinhole(x_mm=40.0), projector, objects=rigs.plane())

    radiance = white_response(scene, samples=4, depth=1)
    np.testing.assert_allclose(radiance, WHITE * E0 * np.cos(tilt) / np.pi, rtol=FLOAT32)


@pytest.mark.parametrize("lens", [None, {"aperture_mm": 20.0, "focus_mm": 150.0}])
def test_pinhole_light_is_uniform_on_a_facing_plane_and_falls_with_depth_squared(
    lens: dict[str, float] | None,
) -> None:
    projector = rigs.pinhole((64, 48), field_mm=120.0, x_mm=0.0, reference_mm=160.0)
    if lens:
        projector["lens"] = lens
    scene = rigs.scene(rigs.pinhole(x_mm=40.0), projector, objects=rigs.plane())

    radiance = white_response(scene, samples=16, depth=1)
    expected = WHITE * E0 * (160.0 / 200.0) ** 2 / np.pi
    np.testing.assert_allclose(radiance, expected, rtol=FLOAT32)


def test_furnace_of_ambient_light_shows_a_plate_as_its_reflectance() -> None:
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.plane(), ambient=7.0)
    transport = render.trace(scene, samples=4)
    np.testing.assert_allclose(transport.ambient, WHITE * 7.0, rtol=FLOAT32)


def test_camera_rays_that_meet_nothing_see_the_ambient_radiance() -> None:
    hole = rigs.plane()
    hole[0]["shape"] = {"kind": "plate", "size_mm": (20.0, 20.0)}
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=hole, ambient=7.0)
    transport = render.trace(scene, samples=4, depth=1)
    empty = transport.label == 0
    assert 0.5 < empty.mean() < 1
    # A pixel apart from the plate's edge: its square sees only the sky.
    assert np.median(transport.ambient[empty]) == pytest.approx(7.0, rel=FLOAT32)
    assert transport.total[:, :, 0].max() == 0


@pytest.mark.parametrize("depth", [2, 5])
def test_integrating_sphere_holds_the_geometric_series_of_its_bounces(
    depth: int, tmp_path: Path
) -> None:
    """Inside a diffuse sphere every bounce spreads evenly: bounce k adds rho^(k-1) E / pi, E the mean irradiance."""
    radius = 100.0
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    ball.export(tmp_path / "ball.ply")
    objects = [
        {
            "label": "ball",
            "material": "grey-paint",
            "shape": {"kind": "file", "path": str(tmp_path / "ball.ply")},
        }
    ]
    camera = rigs.pinhole((32, 24), field_mm=90.0, x_mm=30.0, height_mm=60.0)
    light = rigs.pinhole((64, 48), field_mm=40.0, x_mm=-30.0, height_mm=50.0, reference_mm=60.0)
    scene = rigs.scene(camera, light, objects=objects)
    transport = render.trace(scene, samples=1024, depth=depth)
    indirect = (transport.total - transport.direct)[0, 0]

    focal = light["fx_px"]
    power = E0 * (60.0 * 64 / focal) * (60.0 * 48 / focal)
    albedo = 0.5
    series = sum(albedo**k for k in range(2, depth + 1))
    expected = series / np.pi * power / ball.area
    # The scatter of 768 pixels is measured. A triangle's edge of 3.6 mm on a radius of 100 mm bends
    # normals by up to 1 degree, which moves what a patch receives by 2e-4.
    error = indirect.std() / np.sqrt(indirect.size)
    assert error < 4e-3 * expected
    assert indirect.mean() == pytest.approx(expected, abs=3 * error + 1e-3 * expected)
    # Evenly: left and right halves agree, though the light falls in one place.
    left, right = indirect[:, :16], indirect[:, 16:]
    assert left.mean() == pytest.approx(right.mean(), abs=3 * 2 * error + 1e-3 * expected)


@pytest.mark.parametrize("model", ["pinhole", "telecentric"])
def test_defocus_lowers_modulation_as_the_airy_shaped_transfer_of_a_disk(model: str) -> None:
    """A disk of blur of radius r px leaves 2 J1(x)/x of a fringe of period P, x = 2 pi r / P."""
    if model == "pinhole":
        light = rigs.pinhole_projector(
            resolution=(1024, 768), lens={"aperture_mm": 6.0, "focus_mm": 190.0}
        )
    else:
        light = rigs.telecentric_projector(
            resolution=(1024, 768), lens={"numerical_aperture": 0.02, "focus_mm": 190.0}
        )
    camera = rigs.pinhole((320, 12))
    scene = rigs.scene(camera, light, objects=rigs.plane(), patterns={"periods_px": (24.0,)})
    one, cosine, sine = render.trace(scene, samples=256, depth=1).total[0, :, 6]

    eye, projector = scene.camera.projection(), scene.projectors[0].projection()
    origin, direction = eye.rays(eye.pixel_centres()[6])
    points = origin - direction * (origin[:, 2:] / direction[:, 2:])
    depth = projector.project(points)[1]
    if model == "pinhole":
        radius = projector.fx * 3.0 * np.abs(1 / 190.0 - 1 / depth)
    else:
        radius = projector.fx * 0.02 * np.abs(depth - 190.0)
    x = 2 * np.pi * radius / 24.0
    expected = 2 * j1(x) / x
    # One camera pixel spans some 3 projector pixels, a box of its own.
    step = np.abs(np.gradient(projector.project(points)[0][:, 0]))
    expected = expected * np.sinc(step / 24.0)

    # Along the expected phase, so that noise does not add up as a modulus would.
    phase = 2 * np.pi * projector.project(points)[0][:, 0] / 24.0
    measured = (cosine * np.cos(phase) + sine * np.sin(phase)) / one
    assert np.ptp(expected) > 0.2
    difference = measured - expected
    error = difference.std() / np.sqrt(difference.size)
    assert error < 2e-3
    # The plane is tilted in the cone of light, which skews the disk: second order in its half angle of 1 to 2 degrees.
    assert abs(difference.mean()) < 3 * error + np.deg2rad(2.0) ** 2
