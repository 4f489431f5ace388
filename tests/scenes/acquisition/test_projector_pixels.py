"""A projector's open squares and blur against closed forms: light of one pixel, fringe contrast, mean."""

from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.special import erf

from scenes.acquisition.pattern_basis import basis
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.projector_pixels import CELLS, across, along, cells_per_pixel
from tests.scenes.acquisition import emitted

COLUMNS, ROWS = 240, 120


projector = partial(emitted.projector, COLUMNS, ROWS)


@pytest.mark.parametrize(
    ("kind", "pixelated"),
    [
        ({}, False),
        ({"gamma": 2.2}, True),
        ({"bits": 8}, True),
        ({"fill_factor": 1.0}, True),
        ({"psf_sigma_px": 0.3}, True),
        ({"bits": 8, "pixels": False}, False),
        ({"pixels": True}, True),
    ],
)
def test_projector_has_pixels_where_a_stage_needs_them(
    kind: dict[str, Any], pixelated: bool
) -> None:
    assert projector(**kind).pixelated == pixelated


@pytest.mark.parametrize(("fill", "sigma"), [(0.8, 0.0), (0.5, 0.4), (1.0, 0.7), (0.3, 2.0)])
def test_one_lit_pixel_is_a_blurred_open_square(fill: float, sigma: float) -> None:
    light = projector(fill_factor=fill, psf_sigma_px=sigma)
    values = np.zeros((1, 41))
    values[0, 20] = 1.0
    found = along(light, values, np.array([True]))[0]
    assert found.mean() == pytest.approx(values.mean(), rel=1e-12)
    # Averages over cells, by ten thousand points of the definition.
    x = (np.arange(41 * CELLS * 256) + 0.5) / (CELLS * 256) - 20.5
    width = np.sqrt(fill)
    if sigma:
        edges = [erf((x + side * width / 2) / (np.sqrt(2) * sigma)) / 2 for side in (1, -1)]
        profile = (edges[0] - edges[1]) / width
    else:
        profile = (np.abs(x) < width / 2) / width
    expected = profile.reshape(-1, 256).mean(axis=1)
    # The edge of an open square is within 1/256 of a cell.
    np.testing.assert_allclose(found, expected, atol=1e-8 if sigma else 1.01 / 256 / width)


@pytest.mark.parametrize("period", [4.0, 6.0, 16.0])
@pytest.mark.parametrize(("fill", "sigma"), [(1.0, 0.0), (0.6, 0.0), (0.9, 0.5), (0.36, 1.0)])
def test_fringe_contrast_is_sinc_of_the_open_width_times_the_blurs_transfer(
    fill: float, sigma: float, period: float
) -> None:
    """Of the fundamental: a square's sinc, a Gaussian's ``exp(-2 pi^2 s^2 / P^2)``."""
    light = projector(fill_factor=fill, psf_sigma_px=sigma)
    made = basis(PhaseShift(periods_px=(period,)), light, light.resolution)
    u = np.arange(48.0, 192.0, 1.0 / 256) + 1.0 / 512
    cells = cells_per_pixel(light)
    place = u * cells - 0.5 if cells > 1 else np.floor(u)
    tables = [np.interp(place, np.arange(COLUMNS * cells), c.values) for c in made.channels]
    shown = (made.weights @ np.stack(tables))[0]
    first = 2.0 * np.abs(np.mean(shown * np.exp(-2j * np.pi * u / period)))
    expected = np.sinc(np.sqrt(fill) / period) * np.exp(-2.0 * (np.pi * sigma / period) ** 2)
    assert first / shown.mean() == pytest.approx(expected, rel=2e-3)


def test_gaps_between_pixels_are_a_comb_of_mean_one() -> None:
    assert across(projector(bits=8)) is None
    assert across(projector(psf_sigma_px=0.5)) is None
    comb = across(projector(fill_factor=0.25))
    assert comb is not None
    np.testing.assert_allclose(comb, np.repeat([0.0, 2.0, 0.0], [4, 8, 4]), atol=1e-12)
    blurred = across(projector(fill_factor=0.25, psf_sigma_px=3.0))
    assert blurred is not None
    np.testing.assert_allclose(blurred, 1.0, atol=1e-8)


@pytest.mark.parametrize("emission", [{"bits": 6}, {"gamma": 1.8, "bits": 8}, {"gamma": 0.6}])
def test_without_pixels_values_are_kept_at_pixel_centres(emission: dict[str, Any]) -> None:
    light = projector(**emission, pixels=False)
    patterns = PhaseShift(periods_px=(12.0,), axes=("column", "row"))
    made = basis(patterns, light, light.resolution)
    # Light between cell centres is linear: a pixel's centre is between two of them.
    u = np.arange(20.5, 100.0)
    tables = []
    for channel in made.channels:
        place = u * channel.cells - 0.5
        tables.append(np.interp(place, np.arange(len(channel.values)), channel.values))
    both = np.stack(tables)
    for i, frame in enumerate(patterns.frames()):
        weights = np.where([c.axis == frame.axis for c in made.channels], made.weights[i], 0.0)
        wanted = light.emit(patterns.commanded(frame, u))
        # (1/16)^2 / 8 of the cubic's curvature, which is below (2 pi / 3)^2 of one quantisation step, or of the fringe.
        np.testing.assert_allclose(weights @ both, wanted, atol=0.003)


def test_fill_factor_one_changes_nothing_and_ideal_projectors_keep_their_basis() -> None:
    patterns = PhaseShift(periods_px=(8.0, 48.0))
    u, v = np.arange(0.3, COLUMNS)[:ROWS], np.arange(0.9, ROWS)
    squares = [projector(**k) for k in ({"bits": 8}, {"bits": 8, "fill_factor": 1.0})]
    made = [emitted.emitted(basis(patterns, one, one.resolution), u, v) for one in squares]
    np.testing.assert_array_equal(made[0], made[1])
    assert basis(patterns, projector(), (COLUMNS, ROWS)).channels[0].kind == "one"
