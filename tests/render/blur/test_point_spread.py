"""The camera's blur against closed forms of a circular pupil (Airy), and what it must conserve."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.special import j0, j1

import render
import scenes
from render.blur.point_spread import REACH, blurred, spread_kernel
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.support.errors import RenderError
from tests.render.rigs import telecentric, telecentric_projector

Floats = NDArray[np.float64]
PITCH_UM, WAVELENGTH_UM = 3.45, 0.589
F_NUMBERS = (2.8, 8.0, 16.0)


def sensor(f_number: float, **more: Any) -> Emva:
    """Without noise or rounding; DN are electrons."""
    ideal: dict[str, Any] = {
        "bits": 0,
        "full_well_e": 1e12,
        "black_level_dn": 0.0,
        "gain_dn_per_e": 1.0,
    }
    return Emva(**({"psf": "diffraction", "f_number": f_number} | ideal | more))


def whole(quadrant: Floats) -> Floats:
    half = np.concatenate([quadrant[:0:-1], quadrant])
    return np.concatenate([half[:, :0:-1], half], axis=1)


def airy_edge(x_um: Floats, f_number: float, pitch_um: float) -> Floats:
    """Light of a pixel centred at x from a sharp edge, bright on the positive side: 1/2 + Airy (*) pixel, integrated.

    The edge's spectrum 1 / (2 pi i f), the pixel's sinc and the pupil's transfer (chords of two overlapping disks), by the
    midpoint rule up to the cutoff.
    """
    cutoff = 1.0 / (WAVELENGTH_UM * f_number)
    # 20 px from the edge the integrand turns by 0.06 rad a step at most: the rule errs by (0.06)^2 / 24.
    f = (np.arange(4000) + 0.5) * (cutoff / 4000)
    angle = np.arccos(f / cutoff)
    transfer = (2.0 * angle - np.sin(2.0 * angle)) / np.pi * np.sinc(f * pitch_um)
    waves = np.sin(2.0 * np.pi * np.multiply.outer(x_um, f))
    return np.asarray(0.5 + (waves * transfer / (np.pi * f)).sum(axis=-1) * (cutoff / 4000))


def edge_image(columns: int, edge_px: float) -> NDArray[np.float32]:
    """Pixel averages (8 rows, column) of light to the right of an edge."""
    row = np.clip(np.arange(1.0, columns + 1.0) - edge_px, 0.0, 1.0)
    return np.tile(row, (8, 1)).astype(np.float32)


@pytest.mark.parametrize(
    ("f_number", "subpixels", "error"),
    [
        *((f_number, 1, 0.035) for f_number in F_NUMBERS),
        *((f_number, 4, 0.01) for f_number in F_NUMBERS),
        *((f_number, 2, 0.01) for f_number in F_NUMBERS[1:]),
    ],
)
def test_edge_response_is_airy_and_pixel(f_number: float, subpixels: int, error: float) -> None:
    """Whole pixels leave the edge's place in its pixel unknown: pixels next to it are off by up to 3.5 % (module's text)."""
    kernel = spread_kernel(sensor(f_number), subpixels)
    assert kernel is not None
    for place in np.linspace(0.0, 1.0, 9):
        image = blurred(edge_image(128 * subpixels, (64 + place) * subpixels), kernel)
        seen = image.reshape(8, 128, subpixels).mean(axis=-1)[0]
        centres = np.arange(128) + 0.5
        # The mirror images of the borders add other edges far away: only pixels near this one are compared.
        near = np.abs(centres - 64 - place) < 20
        x_um = (centres - 64 - place)[near] * PITCH_UM
        off = np.abs(seen[near] - airy_edge(x_um, f_number, PITCH_UM))
        assert off.max() < error
        assert off[np.abs(centres - 64 - place)[near] > 2.0].max() < 0.01


@pytest.mark.parametrize(("f_number", "bound"), [(2.8, 0.021), (8.0, 0.024), (16.0, 0.0085)])
def test_no_kernel_on_whole_pixels_brings_an_edge_within_a_hundredth(
    f_number: float, bound: float
) -> None:
    """The least largest error of any symmetric kernel of unit sum that reaches 24 px, over 17 places of the edge."""
    reach = 24
    rows, wanted = [], []
    for place in np.linspace(0.0, 1.0, 17):
        pixels = np.clip(np.arange(-reach - 8, reach + 9) + 1.0 - place, 0.0, 1.0)
        for centre in range(-8, 9):
            seen = pixels[centre + 8 : centre + 9 + 2 * reach]
            pairs = seen[reach:] + seen[reach::-1]
            # What a kernel sends farther meets one side of the edge as often as the other.
            rows.append(np.where(np.arange(reach + 1) > 0, pairs - 1.0, pairs / 2.0 - 0.5))
            wanted.append(float(airy_edge(np.array([(centre + 0.5 - place) * PITCH_UM]), f_number, PITCH_UM)[0]))  # fmt: skip
    a, b = np.array(rows), np.array(wanted) - 0.5
    slack = -np.ones((len(a), 1))
    sides = np.block([[a, slack], [-a, slack]])
    cost = np.append(np.zeros(reach + 1), 1.0)
    free = [(None, None)] * (reach + 1)
    best = linprog(cost, sides, np.concatenate([b, -b]), bounds=[*free, (0.0, None)])
    assert best.fun is not None
    assert best.fun > bound


@pytest.mark.parametrize("f_number", F_NUMBERS)
def test_encircled_energy_is_that_of_an_airy_disc(f_number: float) -> None:
    kernel = spread_kernel(sensor(f_number))
    assert kernel is not None
    y, x = np.mgrid[-REACH : REACH + 1, -REACH : REACH + 1]
    distance = np.hypot(x, y)
    dx, dy = np.mgrid[-0.45:0.45:10j, -0.45:0.45:10j].reshape(2, -1)
    for radius_px in (3.0, 5.0, 8.0, 12.0, 20.0, 40.0):
        # A pixel on the circle counts with its area inside.
        inside = (distance < radius_px).astype(np.float64)
        rim = np.abs(distance - radius_px) < 1.0
        parts = np.hypot(x[rim, None] + dx, y[rim, None] + dy) < radius_px
        inside[rim] = parts.mean(axis=-1)
        v = np.pi * radius_px * PITCH_UM / (WAVELENGTH_UM * f_number)
        expected = 1.0 - j0(v) ** 2 - j1(v) ** 2
        # Within three pixels a pixel's own width is what counts: see the edges.
        assert (whole(kernel) * inside).sum() == pytest.approx(expected, abs=0.01)


def test_gaussian_blur_adds_its_variance() -> None:
    kernel = spread_kernel(Emva(psf="none", psf_sigma_um=1.2 * PITCH_UM))
    assert kernel is not None
    line = whole(kernel).sum(axis=0)
    offset = np.arange(-REACH, REACH + 1)
    # Counting the pixel's aperture twice would add 1/12 px^2, 6 %.
    assert (line * offset**2).sum() == pytest.approx(1.2**2, rel=0.01)


@pytest.mark.parametrize("shape", [(1, 1), (7, 300), (90, 120), (600, 3)])
def test_blur_conserves_photons_and_leaves_even_light_as_it_is(shape: tuple[int, int]) -> None:
    kernel = spread_kernel(sensor(8.0, psf_sigma_um=2.0))
    assert kernel is not None
    light = (np.random.default_rng(0).uniform(0.0, 1.0, (3, *shape)) ** 8).astype(np.float32)
    spread = blurred(light, kernel)
    sums = [image.sum(axis=(1, 2), dtype=np.float64) for image in (light, spread)]
    np.testing.assert_allclose(sums[1], sums[0], rtol=1e-6)
    # Nothing is darker than black, however bright its surroundings, but for the cosine transform's rounding.
    assert spread.min() > -1e-12
    even = np.full(shape, 7.0, np.float32)
    np.testing.assert_allclose(blurred(even, kernel), even, rtol=1e-6)


def test_sensors_without_psf_have_none() -> None:
    assert spread_kernel(SimpleSensor()) is None
    assert spread_kernel(Emva(psf="none")) is None


@pytest.mark.parametrize(
    "extreme",
    [
        {"pixel_um": 1e-300},
        {"pixel_um": 1e300},
        {"f_number": 1e300, "wavelength_nm": 1e300},
        {"f_number": 1e-300, "wavelength_nm": 1e-300},
        {"psf_sigma_um": 1e300},
    ],
)
def test_extreme_lenses_still_conserve_photons(extreme: dict[str, float]) -> None:
    kernel = spread_kernel(Emva(psf="diffraction", **extreme))
    assert kernel is not None
    assert whole(kernel).sum() == pytest.approx(1.0)


def edge_scene(columns: int = 64) -> scenes.Scene:
    """White paint to the right of x = 0.11 px, nothing to the left, seen by a telecentric camera."""
    camera = telecentric((columns, columns // 2))
    plate = {"kind": "plate", "size_mm": (120.0, 160.0)}
    place = (60.0 + 0.11 * 60.0 / 64, 0.0, 0.0)
    body = {"label": "base", "material": "white-paint", "shape": plate, "position_mm": place}
    return scenes.Scene.model_validate(
        {
            "camera": camera,
            "projectors": [telecentric_projector()],
            "objects": [body],
            "patterns": {"kind": "gray-code", "bits": (1,), "cell_px": 64.0},
            "exposures": {"times_ms": (1.0,)},
            "sampling": {"depth": 1},
            "height_range_mm": (-1.0, 9.0),
        }
    )


def test_wider_lens_is_sharper_and_light_without_psf_is_unblurred() -> None:
    light = render.trace(edge_scene(), samples=4)
    sharp = render.expose(light, sensor=sensor(8.0, psf="none"), noise=False)
    open_, closed = (render.expose(light, sensor=sensor(n), noise=False) for n in (2.8, 16.0))
    np.testing.assert_allclose(
        sharp.frames[0],
        sensor(8.0).mean_dn(light.frames(), 1.0).astype(np.float32),
        rtol=1e-6,
        atol=1e-3,
    )
    # Contrast of neighbouring columns at the edge, by the level: the wider the lens, the sharper.
    slopes = [
        np.diff(s.frames[0, -2].astype(float), axis=1).max() / s.frames.max()
        for s in (sharp, open_, closed)
    ]
    assert slopes[0] > slopes[1] > slopes[2]


def test_subpixels_must_divide_the_traced_resolution() -> None:
    light = render.trace(edge_scene(), samples=1)
    for wrong in (0, 3):
        with pytest.raises(RenderError, match=f"subpixels = {wrong}.*64 x 32"):
            render.expose(light, subpixels=wrong)


def test_light_behind_the_lens_gives_the_same_pictures() -> None:
    scene = edge_scene()
    camera = scene.camera.model_copy(update={"vignetting": (-0.2,)})
    scene = scene.model_copy(update={"camera": camera, "sensor": Emva(psf_sigma_um=3.0)})
    light = render.trace(scene, samples=4)
    behind = render.through_lens(light)
    for direct in (False, True):
        one, two = (render.expose(t, seed=1, direct_only=direct) for t in (light, behind))
        np.testing.assert_array_equal(one.frames, two.frames)
    assert not np.allclose(light.total, behind.total)
