"""The stated noise of light paths is the scatter of the phase between seeds, in every region, with and without a lens."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
import render
import scenes
from render.light_noise import on_chip
from tests.trust import chance

pytestmark = [pytest.mark.trust, pytest.mark.filterwarnings("ignore:noise of light paths")]

SEEDS = 16
# What a claim may be off by, apart from chance.
OFF = 0.15
SMALL = {"bench": [160, 120], "spi": [192, 144], "solder-grains": [160, 120]}


def with_psf(light: render.Transport, psf: str) -> render.Transport:
    sensor = light.scene.sensor.model_copy(update={"psf": psf})
    return replace(light, scene=light.scene.model_copy(update={"sensor": sensor}))


def finest(light: render.Transport) -> NDArray[np.complex128]:
    """(row, col) phasor of the first four frames, a quarter period apart, on the chip."""
    one, two, three, four = render.through_lens(light).frames()[:4].astype(np.float64)
    return np.asarray((one - three + 1j * (four - two)) / 2.0)


@pytest.fixture(scope="module", params=list(SMALL))
def traced(request: pytest.FixtureRequest) -> list[render.Transport]:
    scene = scenes.load(request.param, {"camera.resolution": SMALL[request.param]})
    made = render.surfaces(scene)
    seeds = chance.seeds(SEEDS, "noise", request.param)
    return [render.trace(scene, seed=seed, surfaces=made) for seed in seeds]


@pytest.mark.parametrize("psf", ["none", "diffraction"])
def test_stated_noise_is_the_scatter_between_seeds_in_every_region(
    traced: list[render.Transport], psf: str, record_property: Callable[[str, object], None]
) -> None:
    lights = [with_psf(light, psf) for light in traced]
    z = np.stack([finest(light) for light in lights])
    mean = z.mean(axis=0)
    # A mean of 16 that holds the seed itself takes 1/16 of its square away.
    seen = np.angle(z * mean.conj()) ** 2 * SEEDS / (SEEDS - 1)
    stated = np.stack([on_chip(light)[0, 0] for light in lights]).astype(np.float64) ** 2
    truth = render.truth(lights[0].scene, lights[0])
    valid = decode.reconstruct(render.expose(lights[0], seed=0)).valid
    wrong = {}
    for label in truth.labels:
        at = truth.region(label) & truth.lit & valid & np.isfinite(stated).all(axis=0)
        if at.sum() < 100:
            continue
        claims, squares = stated[:, at].mean(axis=1), seen[:, at].mean(axis=1)
        ratio = claims.mean() / squares.mean()
        # Standard error of a ratio of two means over seeds; few seeds and long tails: three of it. Halved for the root.
        error = np.std(claims - ratio * squares, ddof=1) / np.sqrt(SEEDS) / squares.mean() / 2.0
        record_property(label, f"{np.sqrt(ratio):.3f} +- {error:.3f}")
        if abs(np.log(ratio)) / 2.0 > np.log1p(OFF) + 3.0 * error:
            wrong[label] = (float(np.sqrt(ratio)), float(error))
    assert not wrong
