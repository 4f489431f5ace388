"""Surfaces that disturb a measurement: grains, clear bodies, mirrors, grooves; and blur."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import j1

import render
import scenes
from scenes import Truth
from scenes.rig.devices import PinholeLens
from tests.render.oracle import compare
from tests.render.rigs import pinhole, pinhole_projector, plane, scene

SMALL = {"camera.resolution": [120, 90]}


def resin(thickness_mm: float) -> list[dict[str, Any]]:
    box = {"kind": "box", "size_mm": (40.0, 30.0, thickness_mm)}
    return [*plane(), {"label": "resin", "material": "resin", "shape": box}]


def test_clear_body_equals_path(tmp_path: Path) -> None:
    """Light refracts in, scatters on the plate, is reflected inside and comes out, in both integrators alike."""
    checked = scene(pinhole(), pinhole_projector(), objects=resin(3.0), depth=6, ambient=1.0)
    comparison = compare(checked, frame=1)
    comparison.require_equal(tmp_path)
    # Paths that find the projector through the skin are rare: two percent of bias would be detected.
    assert comparison.mean_bias()[1] < 0.02 / 3


def test_light_comes_out_of_a_clear_body_only_after_three_surfaces() -> None:
    body = scene(pinhole(), pinhole_projector(), objects=resin(2.0))
    inner = render.truth(body).region("resin")
    two, three = (render.trace(body, samples=64, depth=d) for d in (2, 3))
    assert two.total[0, 0][inner].mean() < 1.1 * two.direct[0, 0][inner].mean()
    assert three.total[0, 0][inner].mean() > 3 * three.direct[0, 0][inner].mean()


def fringe_contrast(transport: render.Transport, region: NDArray[np.bool_]) -> float:
    """Of the finest fringe, in the median of a region."""
    one, cos, sin = (transport.total[0, c] for c in range(3))
    return float(np.median(np.hypot(cos, sin)[region] / one[region]))


def footprint(truth: Truth, period_px: float) -> NDArray[np.float64]:
    """Contrast that averaging over a pixel leaves, (row, col): the sinc of its width in projector columns."""
    step_px = np.gradient(truth.columns_px[0].astype(np.float64), axis=1)
    return np.asarray(np.sinc(step_px / period_px))


def test_thicker_clear_bodies_have_lower_fringe_contrast() -> None:
    bled = scenes.load("translucent", SMALL)
    transport, truth = render.trace(bled, samples=64), render.truth(bled)
    thin, medium, thick = (
        fringe_contrast(transport, truth.region(label)) for label in ("thin", "medium", "thick")
    )
    base = fringe_contrast(transport, truth.region("base"))
    # 1 % for the share of light that reaches the board through the bodies
    board = truth.region("base")
    assert base == pytest.approx(np.median(footprint(truth, 16.0)[board]), rel=0.01)
    assert base > 1.1 * thin > 1.1 * 1.1 * medium > 1.1 * 1.1 * 1.3 * thick


def test_mirror_sends_the_light_away() -> None:
    shiny = scenes.load("mirror", SMALL)
    transport, truth = render.trace(shiny, samples=16), render.truth(shiny)
    board_light = transport.total[0, 0][truth.region("base")].mean()
    assert transport.total[0, 0][truth.region("mirror")].max() < 1e-3 * board_light


def test_groove_returns_light_from_its_other_side() -> None:
    groove = scenes.load("interreflection", SMALL)
    truth = render.truth(groove)
    share = [np.nanmean(truth.direct_fractions[0][truth.region(s)]) for s in ("left", "right")]
    assert max(share) < 0.95
    # The side that faces the projector less gets relatively more from the other.
    assert share[0] < share[1]


def test_defocus_costs_contrast_as_the_blur_disk_says() -> None:
    """A uniform disk of diameter d blurs a sinusoid of period P by 2 J1(x) / x with x = pi d / P."""
    blurred = scenes.load("defocus", {"camera.resolution": [160, 120], "sampling.depth": 1})
    transport, truth = render.trace(blurred, samples=256), render.truth(blurred)
    projection = blurred.projectors[0].projection()
    _, depth = projection.project(truth.xyz_mm.astype(np.float64))
    lens = blurred.projectors[0].lens
    assert isinstance(lens, PinholeLens)
    blur_mm = lens.aperture_mm * np.abs(depth - lens.focus_mm) / depth
    # A disk of the pupil seen through the point, carried to the focus plane, where pixels are.
    x = np.pi * blur_mm * projection.fx / lens.focus_mm / 16.0
    with np.errstate(invalid="ignore"):
        expected = np.where(x > 0, 2 * np.abs(j1(x)) / x, 1.0)
    expected = expected * footprint(truth, 16.0)
    for label in ("step-3mm", "step-6mm", "step-9mm"):
        top = truth.region(label) & truth.lit_by[0] & (truth.normal[..., 2] > 0.99)
        one, cos, sin = (transport.total[0, c] for c in range(3))
        ratio = np.hypot(cos, sin)[top] / one[top] / expected[top]
        # 256 stratified points of the pupil, and edges' gradients, which the median passes over
        assert np.median(ratio) == pytest.approx(1.0, rel=0.02), label


@pytest.mark.slow
def test_grains_have_their_heights_and_vary_in_brightness() -> None:
    """Visible heights are between flux and the printed top; the metal is far brighter and far darker than the board."""
    paste = scenes.load("solder-grains", {**SMALL, "objects.1.label": "flux"})
    truth = render.truth(paste)
    for kind in (3, 4, 5):
        z = truth.height_mm[truth.region(f"type-{kind}")]
        # A grain at the block's edge is seen past the flux's: one pixel in a hundred.
        assert 0.0899 < np.percentile(z, 1) < 0.1
        # icospheres of 80 triangles and a sphere's volume reach 4.6 % of a radius out of it
        assert 0.115 < z.max() < 0.12 + 0.046 * 0.025
    light = render.trace(paste, samples=16).direct[0, 0]
    board = np.median(light[truth.region("base")])
    # These pixels, four times as wide as the scene's, average over grains.
    assert light[truth.region("type-3")].max() > 3 * board
    assert light[truth.region("type-3")].min() < 0.6 * board
