"""A projector's own oracle: light by ray and pixel in closed form, Mitsuba's stock projector, fringe contrast."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import erf

import render
from render.plugins.variant import mi, use
from scenes.rig.projectors import Screen
from tests.render import rigs
from tests.render.oracle import Comparison
from tests.render.plugins.test_projections import FLOAT32_PX, emitter, points_mm, sample

Floats = NDArray[np.float64]
FILL, SIGMA_PX = 0.64, 0.35


def open_square(offset_px: Floats) -> Floats:
    """Blurred profile of a pixel's open side at a distance from its centre; integral 1."""
    width = np.sqrt(FILL)
    a, b = ((offset_px + side * width / 2) / (np.sqrt(2.0) * SIGMA_PX) for side in (1, -1))
    return np.asarray((erf(a) - erf(b)) / (2.0 * width))


@pytest.mark.parametrize("model", [rigs.pinhole_projector, rigs.telecentric_projector])
@pytest.mark.parametrize("axis", ["column", "row"])
def test_light_at_a_point_is_that_of_its_pixels(model: Any, axis: str) -> None:
    """Irradiance times the sum of all pixels' values, each spread as a blurred open square along both axes."""
    kind = {"fill_factor": FILL, "psf_sigma_px": SIGMA_PX, "gamma": 1.7, "bits": 7}
    scene = rigs.scene(
        rigs.pinhole(),
        model(resolution=(256, 192), contrast=0.8, **kind),
        patterns={"axes": (axis,)},
    )
    projector = scene.projectors[0]
    assert not isinstance(projector, Screen)
    geometry = projector.projection()
    points = points_mm()
    pixels, depth = geometry.project(points)
    size = np.array(projector.resolution)
    # Closer than the blur's reach, what goes on beyond the border counts.
    inside = ((pixels > 3.0) & (pixels < size - 3.0)).all(axis=1)
    assert inside.sum() > 200
    ds, value = sample(emitter(scene), points)

    frame = scene.patterns.frames()[0]
    along, across = pixels.T if axis == "column" else pixels.T[::-1]
    count = size[0 if axis == "column" else 1]
    centres = np.arange(count) + 0.5
    commanded = np.rint(127 * (0.5 + 0.5 * np.cos(2 * np.pi * centres / frame.period_px))) / 127
    black = 0.2 / 1.8
    emitted = black + (1.0 - black) * commanded**1.7
    spread = (emitted * open_square(along[:, None] - centres)).sum(axis=1)
    comb = sum(open_square(across - np.floor(across) - 0.5 - k) for k in range(-3, 4))
    towards = np.array(ds.d).T
    fall = 1.0 if geometry.telecentric else (200.0 / depth) ** 2
    irradiance = projector.irradiance_w_m2 * fall / (-towards @ geometry.axis)
    # Linear between 16 cells a pixel: a cell is 0.18 of the blur's sigma, and light's curvature at most 1 / sigma^2 of
    # its height; twice, for two axes. A cell's average adds a third of it.
    cell = (1.0 / 16 / SIGMA_PX) ** 2 / 8 * 4 / 3 * 2
    atol = 150 * (cell + 4 * FLOAT32_PX)
    np.testing.assert_allclose(
        np.array(value)[0][inside], (irradiance * spread * comb)[inside], atol=atol, rtol=1e-5
    )


def test_pixels_of_a_projector_are_those_of_mitsubas_stock_projector(tmp_path: Path) -> None:
    """The stock plugin reads a bitmap of the emitted pixels; its irradiance is that at a distance of 1."""
    use()
    # Upright and off the axes, so that a mirrored or shifted image shows.
    pose = {"origin_mm": (-80.0, 30.0, 200.0), "target_mm": (2.0, -3.0, 0.0)}
    device = rigs.pinhole_projector(resolution=(64, 48), gamma=2.2, bits=8, pose=pose)
    patterns = {"periods_px": (7.0,), "axes": ("column", "row")}
    scene = rigs.scene(rigs.pinhole(), device, objects=rigs.plane(), depth=1, patterns=patterns)
    projector = scene.projectors[0]
    assert not isinstance(projector, Screen)
    width, height = projector.resolution
    look = mi.ScalarTransform4f().look_at(pose["origin_mm"], pose["target_mm"], (0.0, 1.0, 0.0))
    plain = render.mitsuba_scene(scene)
    for number in (1, 4):
        frame = scene.patterns.frames()[number]
        x = np.arange(width) + 0.5 if frame.axis == "column" else np.arange(height)[:, None] + 0.5
        emitted = np.rint(255 * (0.5 + 0.5 * np.cos(2 * np.pi * x / 7.0 + frame.phase_shift_rad)))
        image = np.broadcast_to((emitted / 255) ** 2.2, (height, width)).astype(np.float32)
        stock = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "direct", "bsdf_samples": 0},
                "sensor": plain.sensors()[0],
                "plate": plain.shapes()[0],
                "light": {
                    "type": "projector",
                    "irradiance": {
                        "type": "bitmap",
                        "bitmap": mi.Bitmap(np.ascontiguousarray(image[..., None])),
                        "filter_type": "nearest",
                        "wrap_mode": "clamp",
                        "raw": True,
                    },
                    # The plugin multiplies by pi what it calls irradiance.
                    "scale": projector.irradiance_w_m2 * 200.0**2 / np.pi,
                    "fov": float(np.rad2deg(2 * np.arctan(width / 2 / device["fx_px"]))),
                    "fov_axis": "x",
                    "to_world": look,
                },
            }
        )
        seeds = np.random.default_rng(number).integers(0, 2**31, (2, 24))
        ours = [render.trace(scene, seed=int(s), samples=256).frames()[number] for s in seeds[0]]
        theirs = [np.array(mi.render(stock, spp=256, seed=int(s)))[..., 0] for s in seeds[1]]
        folder = tmp_path / str(number)
        folder.mkdir()
        found = Comparison(np.array(ours, np.float64), np.array(theirs, np.float64))
        found.require_equal(folder)
        # Half a percent of bias would be detected.
        assert found.mean_bias()[1] < 0.005 / 3
