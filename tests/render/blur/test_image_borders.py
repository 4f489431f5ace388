"""What a lens's blur brings into an image from beyond its borders, against larger images."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import render
import scenes
from render.blur.image_borders import fringe_terms
from render.blur.point_spread import REACH, blurred, spread_kernel
from render.chip_image import Image
from render.fringe_phasor import direction, finest_fringes
from render.light_noise import on_chip, phase_variance, sensor_noise
from render.pathtracer.block_light import phasor_variance
from tests.render.blur.test_point_spread import sensor, whole
from tests.trust import chance

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]
PAIR = np.array([[0.0, 1.0, 1.0j]])


def kernel(**lens: Any) -> Floats:
    found = spread_kernel(sensor(8.0, **lens))
    assert found is not None
    return found


def phasor(light: render.Transport) -> Complex:
    fringe = finest_fringes(light.scene.patterns, light.bases)[0]
    image = Image.of(light, light.scene.sensor).light[0]
    cosine, sine = fringe.phasor(image[: len(light.bases[0].channels)], 0)
    return np.asarray(cosine + 1j * sine)


def without(light: render.Transport, margin: int) -> render.Transport:
    """The light of a camera whose sensor lacks that many pixels on each side, and no other."""
    rows, columns = (n - 2 * margin for n in light.label.shape)
    inner = (..., slice(margin, margin + rows), slice(margin, margin + columns))
    camera = light.scene.camera.model_copy(update={"resolution": (columns, rows)})
    return replace(
        light,
        **{k: getattr(light, k)[inner] for k in ("total", "direct", "ambient", "label")},
        scene=light.scene.model_copy(update={"camera": camera}),
        noise_rad=None,
        amplitude_noise=None,
        noise_correlation=None,
    )


REAL = {"projectors.0.gamma": 2.0, "projectors.0.bits": 10, "projectors.0.psf_sigma_px": 0.5}


@pytest.mark.parametrize("projector", [{}, REAL], ids=["sinusoids", "tables"])
def test_phase_of_outermost_pixels_is_that_in_a_larger_image(projector: dict[str, float]) -> None:
    """A corner of `bench` at its own scale: off by less than the sensor's noise."""
    margin, (columns, rows) = 48, (96, 80)
    scene = scenes.load("bench", projector)
    eye = scene.camera.projection()
    camera = scene.camera.model_copy(
        update={
            "resolution": (columns + 2 * margin, rows + 2 * margin),
            "calibrated_at": None,
            "fx_px": eye.fx,
            "fy_px": eye.fy,
            "cx_px": eye.cx - 150.0,
            "cy_px": eye.cy - 150.0,
        }
    )
    light = render.trace(scene.model_copy(update={"camera": camera}), samples=64, depth=1)
    expected = phasor(light)[margin:-margin, margin:-margin]
    cut = without(light, margin)
    noise = sensor_noise(cut)
    assert noise is not None
    phase_rad = noise.height_mm / np.where(np.isnan(noise.height_mm), np.nan, noise.mm_per_rad[0])
    off = np.abs(np.angle(phasor(cut) / expected)) / phase_rad
    for line in (off[0], off[-1], off[:, 0], off[:, -1], off[:, 1], off[:, -2]):
        assert np.sqrt(np.nanmean(line**2)) < 1.0


def test_even_fringes_keep_phase_and_contrast_up_to_the_border() -> None:
    """Contrast after a symmetric kernel is its transform; beyond 32 px fringes are not continued; there it has 0.3 % of its light."""
    k = kernel(psf_sigma_um=2.0)
    across, down = 2 * np.pi / 9.3, 2 * np.pi / 31.0
    y, x = np.mgrid[:60.0, :90.0]
    z = np.exp(1j * (across * x + down * y + 0.7))
    light = np.stack([np.ones_like(x), z.real, z.imag]).astype(np.float32)
    even, real, imaginary = blurred(light[None], k, [PAIR])[0]
    offset = np.arange(-REACH, REACH + 1)
    contrast = np.cos(down * offset) @ whole(k) @ np.cos(across * offset)
    np.testing.assert_allclose((real + 1j * imaginary) / z, contrast, atol=0.01)
    np.testing.assert_allclose(even, 1.0, rtol=1e-6)


def test_noise_behind_a_lens_adds_up_in_squares() -> None:
    """Along a phasor's neighbours, whose phases differ, it turns the phasor; with the noise across them it adds up as variances do."""
    light = render.trace(scenes.load("step", {"camera.resolution": [24, 18]}), samples=4)
    light = replace(light, noise_correlation=None)
    across = np.full((1, 1, 18, 24), 1e-3, np.float32)
    total = [
        on_chip(replace(light, noise_rad=across, amplitude_noise=np.full_like(across, along)))
        for along in (0.0, 0.1, 0.2)
    ]
    zero, one, two = (found.astype(np.float64)[0, 0] ** 2 for found in total)
    grown = one - zero
    seen = grown > 1e-3 * one
    assert seen.mean() > 0.5
    # Float32 of the sum.
    np.testing.assert_allclose((two - zero)[seen] / grown[seen], 4.0, rtol=1e-3)


@pytest.mark.parametrize("lean", [-0.8, 0.8])
def test_noise_that_turns_and_lengthens_at_once_is_known_behind_a_lens(lean: float) -> None:
    """A bright, noisy half beside a dark, quiet one of another phase: blocks of single draws against the scatter of their sums."""
    draws, number, rows, columns = 4000, 4, 3, 6
    dark = np.arange(columns) >= columns // 2
    z = np.tile(np.where(dark, 4.0 * np.exp(1.3j), 10.0), (rows, 1))
    rng = np.random.default_rng(chance.seeds(1, "lens", lean)[0])
    along, free = rng.standard_normal((2, draws, rows, columns, number))
    noise = (along + 1j * (lean * along + np.sqrt(1.0 - lean**2) * free)) * direction(z)[..., None]
    blocks = z[..., None] + np.where(dark, 0.01, 0.2)[:, None] * noise
    entry = np.repeat(np.arange(draws * z.size), number)
    each = np.full(draws * z.size, number, np.uint32)
    single = blocks.astype(np.complex64).reshape(1, 1, -1)
    phase, length, both = (v.reshape(draws, *z.shape).astype(np.float64) for v in phasor_variance([(entry, single)], each, 1))  # fmt: skip
    power = np.abs(blocks.mean(axis=-1)) ** 2
    covariance = both * np.sqrt(phase * length * power)
    across, along_2, both = (x.mean(axis=0) for x in (phase * power, length, covariance))
    side, corner = 0.1, 0.05
    quadrant = np.array([[1.0 - 4.0 * (side + corner), side], [side, corner]])
    # Where the border does not matter.
    stated = phase_variance(z, across, along_2, both, quadrant)[1, 1:-1]
    mean = blocks.mean(axis=-1)
    beside = [mean[:, i : i + 1, j : j + columns - 2] for i in range(3) for j in range(3)]
    chip = np.tensordot(whole(quadrant).ravel(), np.stack(beside), 1)[:, 0]
    seen = (np.angle(chip / chip.mean(axis=0)) ** 2).mean(axis=0)
    # Five standard errors of a variance of so many draws.
    np.testing.assert_allclose(stated, seen, rtol=5.0 * np.sqrt(2.0 / draws))
    # Teeth: at the rim, what varies together is a good part of it.
    apart = phase_variance(z, across, along_2, 0.0 * both, quadrant)[1, 1:-1]
    assert np.abs(apart / seen - 1.0)[columns // 2 - 1] > 0.3


def test_photons_within_the_kernels_reach_of_no_border_are_conserved() -> None:
    light = np.zeros((1, 3, 2 * REACH + 3, 2 * REACH + 9), np.float32)
    light[0, :, REACH + 1, REACH + 3] = 5.0, 3.0, -4.0
    spread = blurred(light, kernel(), [PAIR])
    np.testing.assert_allclose(spread.sum(axis=(2, 3), dtype=np.float64)[0], [5.0, 3.0, -4.0], rtol=1e-6)  # fmt: skip


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 3), (50, 70)])
def test_no_light_becomes_negative(shape: tuple[int, int]) -> None:
    """Of pixels as uneven as can be; the smallest images have no second pixel to show how a phase continues."""
    rng = np.random.default_rng(3)
    mean = rng.uniform(0.0, 1.0, shape) ** 8
    z = mean * np.exp(2j * np.pi * rng.uniform(size=shape))
    light = np.stack([mean, z.real, z.imag]).astype(np.float32)
    one, real, imaginary = blurred(light[None], kernel(), [PAIR])[0].astype(np.float64)
    for phase in np.linspace(0.0, 2.0 * np.pi, 12):
        assert (one + np.cos(phase) * real + np.sin(phase) * imaginary).min() > -1e-6


def test_fringes_of_pixels_are_found_in_their_tables() -> None:
    """A projector of open squares shows each fringe's values at pixel centres, so its tables span them exactly."""
    patterns = scenes.PhaseShift(periods_px=(16.0, 128.0), axes=("column", "row"))
    squares = scenes.load("bench", {"projectors.0.fill_factor": 1.0}).projectors[0]
    basis = scenes.basis(patterns, squares, (256, 128))
    terms = fringe_terms(basis, patterns)
    fringes = [(axis, period) for axis in ("column", "row") for period in (16.0, 128.0)]
    for row, (axis, period) in zip(terms, fringes, strict=True):
        tables = np.array([c.values if c.axis == axis else np.zeros(256 if axis == "column" else 128) for c in basis.channels])  # fmt: skip
        at = np.arange(0.5, tables.shape[1])
        np.testing.assert_allclose(row @ tables, np.exp(2j * np.pi * at / period), atol=1e-6)
