"""Features of analytic shapes, compared with the covariance of their fits."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation.scoring.feature_fits import APEX_RADIUS, _largest, features, robust_fit
from scenes.files.truth_maps import Truth
from tests.evaluation.synthetic_truth import Floats, Grid, TruthMaker

Shaped = tuple[Truth, Floats]
Masked = tuple[Truth, NDArray[np.bool_]]

SHAPE = (120, 160)
RADIUS_MM, HEIGHT_MM = 5.0, 2.5
# Five standard deviations: a false alarm in two million.
SIGMAS = 5.0
# Variance of Tukey's bisquare over that of least squares, on Gaussian noise.
BISQUARE_LOSS = 1.0 / 0.95
# Truth is float32, a few mm high.
ROUNDING_MM = 4.0 * 2.0**-23


@pytest.fixture(scope="module")
def cap(truth_of: TruthMaker, grid: Grid) -> Shaped:
    """Truth of a parabolic cap whose apex is off the pixel grid, and the radius map about it."""
    x, y = grid(SHAPE)
    r = np.hypot(x - 0.317, y + 0.142)
    height = np.where(r < RADIUS_MM, HEIGHT_MM * (1.0 - (r / RADIUS_MM) ** 2), 0.0)
    return truth_of(height, {"base": True, "cap": r < RADIUS_MM}), r


@pytest.fixture(scope="module")
def step(truth_of: TruthMaker, grid: Grid) -> Masked:
    """Truth of a block 1.5 mm high on a tilted board, and the block's mask."""
    x, y = grid(SHAPE)
    block = (np.abs(x - 1.0) < 3.0) & (np.abs(y) < 2.0)
    return truth_of(0.02 * x - 0.01 * y + 1.5 * block, {"base": True, "step": block}), block


def apex_sd_mm(r: Floats, noise_mm: float) -> float:
    """Standard deviation of the apex of a least-squares paraboloid, from the covariance of its coefficients."""
    near = r <= APEX_RADIUS * RADIUS_MM
    rows, cols = np.nonzero(near)
    u, v = (cols - cols.mean()) / 10.0, (rows - rows.mean()) / 10.0
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    # The apex is within half a pixel of the window's middle, where its height is the constant term.
    return float(noise_mm * np.sqrt(np.linalg.inv(design.T @ design)[0, 0] * BISQUARE_LOSS))


def test_apex_of_an_exact_paraboloid_is_its_height(cap: Shaped) -> None:
    truth, _ = cap
    apex = features(truth.height_mm, truth)["cap_apex"]
    assert apex.truth_mm == pytest.approx(HEIGHT_MM, abs=ROUNDING_MM)
    assert apex.measured_mm == apex.truth_mm


@pytest.mark.parametrize("seed", range(5))
def test_noisy_apex_stays_within_its_fit_covariance(cap: Shaped, seed: int) -> None:
    truth, r = cap
    noise = np.random.default_rng(seed).normal(0.0, 0.03, SHAPE)
    apex = features(truth.height_mm + noise, truth)["cap_apex"]
    assert apex.measured_mm is not None
    assert abs(apex.measured_mm - HEIGHT_MM) < SIGMAS * apex_sd_mm(r, 0.03)


def test_wrong_fringe_orders_do_not_move_the_apex(cap: Shaped) -> None:
    truth, r = cap
    rng = np.random.default_rng(0)
    height = truth.height_mm + rng.normal(0.0, 0.03, SHAPE)
    height[rng.random(SHAPE) < 0.1] += 8.0
    apex = features(height, truth)["cap_apex"]
    # A tenth of the points is lost, and the bisquare's rejection is not sharp: allow for a fifth.
    bound = SIGMAS * apex_sd_mm(r, 0.03) / np.sqrt(0.8)
    assert apex.measured_mm is not None
    assert abs(apex.measured_mm - HEIGHT_MM) < bound


def test_saturated_highlight_lowers_the_apex(cap: Shaped) -> None:
    truth, r = cap
    apex = features(truth.height_mm - 0.05 * (r < 2.0), truth)["cap_apex"]
    assert apex.measured_mm == pytest.approx(HEIGHT_MM - 0.05, abs=ROUNDING_MM)


def test_highlight_on_a_cap_belongs_to_it(cap: Shaped, truth_of: TruthMaker) -> None:
    truth, r = cap
    masks = {"base": True, "cap": r < RADIUS_MM, "highlight": r < 1.0}
    apex = features(truth.height_mm, truth_of(truth.height_mm, masks))["cap_apex"]
    assert apex.truth_mm == pytest.approx(HEIGHT_MM, abs=ROUNDING_MM)
    # Were the highlight left out, the apex could not fall with it.
    low = features(truth.height_mm - 0.05 * (r < 2.0), truth_of(truth.height_mm, masks))
    assert low["cap_apex"].measured_mm == pytest.approx(HEIGHT_MM - 0.05, abs=ROUNDING_MM)


def test_no_apex_where_nothing_is_measured(cap: Shaped) -> None:
    truth, r = cap
    height = np.where(r < 2.0, np.nan, truth.height_mm)
    apex = features(height, truth)["cap_apex"]
    assert apex.measured_mm is None
    assert apex.truth_mm is not None


def test_bowl_has_no_apex(cap: Shaped) -> None:
    truth, _ = cap
    assert features(-truth.height_mm, truth)["cap_apex"].measured_mm is None


def test_step_of_an_exact_block_is_its_height(step: Masked) -> None:
    truth, _ = step
    height = features(truth.height_mm, truth)["step_height"]
    assert height.truth_mm == pytest.approx(1.5, abs=ROUNDING_MM)
    assert height.measured_mm == height.truth_mm


@pytest.mark.parametrize("seed", range(5))
def test_noisy_step_stays_within_its_fit_covariance(step: Masked, seed: int) -> None:
    truth, block = step
    noise = np.random.default_rng(seed).normal(0.0, 0.03, SHAPE)
    measured = features(truth.height_mm + noise, truth)["step_height"].measured_mm
    # The top's mean has the variance of its pixels' number; the base's plane is read in the middle of a frame around it
    # that has more of them.
    top = (60 - 4) * (40 - 4)
    assert block.sum() == 60 * 40
    assert measured is not None
    assert abs(measured - 1.5) < SIGMAS * 0.03 * np.sqrt(2.0 / top * BISQUARE_LOSS)


def test_edges_and_shadow_of_a_step_do_not_move_its_height(step: Masked) -> None:
    truth, block = step
    rows, cols = np.nonzero(block)
    height = truth.height_mm.copy()
    # Two pixels on either side of every edge mix the two heights; the shadow next to it is noise.
    for at in (rows.min(), rows.max() + 1):
        height[at - 2 : at + 2, cols.min() - 2 : cols.max() + 3] = 0.75
    for at in (cols.min(), cols.max() + 1):
        height[rows.min() - 2 : rows.max() + 3, at - 2 : at + 2] = 0.75
    lit = np.ones(SHAPE, bool)
    lit[rows.min() : rows.max() + 1, cols.max() + 1 : cols.max() + 9] = False
    height[~lit] = np.random.default_rng(0).uniform(-4.0, 4.0, int((~lit).sum()))
    shaded = replace(truth, lit_by=lit[None])
    measured = features(height, shaded)["step_height"].measured_mm
    assert measured == pytest.approx(1.5, abs=ROUNDING_MM)


def test_sides_of_a_step_are_not_its_top(step: Masked) -> None:
    truth, block = step
    rows, _ = np.nonzero(block)
    normal, height = truth.normal.copy(), truth.height_mm.copy()
    # The nearer half of the block is a side seen from above, falling away.
    side = block & (np.arange(SHAPE[0])[:, None] > np.median(rows) + 4)
    normal[side] = (0.0, -1.0, 0.0)
    height[side] -= 0.7
    xyz = truth.xyz_mm.copy()
    xyz[..., 2] = height
    found = features(height, replace(truth, normal=normal, xyz_mm=xyz))["step_height"]
    assert found.truth_mm == pytest.approx(1.5, abs=ROUNDING_MM)


def test_no_features_without_their_labels(truth_of: TruthMaker) -> None:
    truth = truth_of(np.zeros(SHAPE))
    assert features(truth.height_mm, truth) == {}


def test_feature_out_of_view_has_no_figures(truth_of: TruthMaker) -> None:
    truth = truth_of(np.zeros(SHAPE), {"base": True, "cap": False, "step": False})
    found = features(truth.height_mm, truth)
    assert set(found) == {"cap_apex", "step_height"}
    assert all(f.measured_mm is None and f.truth_mm is None for f in found.values())


@pytest.mark.parametrize("wrong", [0.0, 0.1, 0.3, 0.4])
def test_robust_fit_resists_gross_errors(wrong: float) -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(-1.0, 1.0, 2000)
    design = np.stack([np.ones_like(t), t], axis=1)
    values = 0.5 + 2.0 * t + rng.normal(0.0, 0.01, t.size)
    values[rng.random(t.size) < wrong] += 5.0
    fit = robust_fit(design, values)
    # Twice the least-squares error covers the points lost and the bisquare's efficiency up to this contamination.
    bound = SIGMAS * 2.0 * 0.01 * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    assert fit is not None
    assert (np.abs(fit - [0.5, 2.0]) < bound).all()


def test_robust_fit_is_95_percent_efficient() -> None:
    # Against least squares on Gaussian noise: 1 / 0.95 for the bisquare, 1.57 for least absolute deviations.
    rng = np.random.default_rng(4)
    t = np.linspace(-1.0, 1.0, 200)
    design = np.stack([np.ones_like(t), t], axis=1)
    noise = rng.normal(0.0, 1.0, (1000, t.size))
    fits = np.array([robust_fit(design, one) for one in noise])
    ratio = fits.var(axis=0) / np.diag(np.linalg.inv(design.T @ design))
    assert (ratio < BISQUARE_LOSS * (1.0 + SIGMAS * np.sqrt(2.0 / 1000))).all()
    # Of the same samples, whose fits correlate by sqrt(0.95): a ratio of variances scatters by sqrt(4 (1 - 0.95) / 1000).
    least = np.linalg.lstsq(design, noise.T, rcond=None)[0].T
    assert fits.var(axis=0) / least.var(axis=0) == pytest.approx(1 / 0.95, abs=3 * 0.0142)


@pytest.mark.parametrize("turned", [False, True])
def test_largest_piece_of_a_mask_is_found_wherever_it_is(turned: bool) -> None:
    mask, large = np.zeros((2, 20, 20), np.bool_)
    large[10:15, 8:13] = True
    mask[2:4, 3:5] = True
    mask |= large
    if turned:
        mask, large = mask[::-1, ::-1], large[::-1, ::-1]
    np.testing.assert_array_equal(_largest(mask), large)


def test_points_in_a_line_determine_no_plane() -> None:
    t = np.linspace(0.0, 1.0, 50)
    assert robust_fit(np.stack([np.ones_like(t), t, 2.0 * t], axis=1), t) is None
