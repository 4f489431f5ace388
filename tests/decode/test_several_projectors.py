"""One height of several projectors: the least sum of Huber's losses, its sigma, and what a wrong height can do."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

import decode
from decode.several_projectors import Heights, better, estimate, of_all
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.devices import LookAt
from tests.decode.synthetic import calibrated_stack, rig

Floats = NDArray[np.float64]
SIZE = (96, 72)


def drawn(projectors: int, pixels: int) -> tuple[Floats, Floats]:
    """Heights and sigmas (projector, pixel), of which every fourth height is biased by some or many sigmas."""
    rng = np.random.default_rng(projectors)
    sigma = rng.uniform(0.5, 2.0, (projectors, pixels))
    bias = rng.choice([0.0, 0.0, 0.0, 8.0, -50.0], sigma.shape)
    return rng.normal(0.0, sigma) + bias, sigma


def least(height: Floats, sigma: Floats) -> float:
    """Where the sum of one pixel's losses is least, by search."""
    # A residual to the mean has the height's variance less that of the mean.
    spread = np.sqrt(sigma**2 - 1.0 / (1.0 / sigma**2).sum())
    corner = 3.0 * spread

    def loss(x: float) -> float:
        r = np.abs(x - height)
        linear = corner * r - corner**2 / 2.0
        return float((np.where(r < corner, r**2 / 2.0, linear) / sigma**2).sum())

    grid = np.linspace(height.min(), height.max(), 2001)
    best = grid[np.argmin([loss(x) for x in grid])]
    step = grid[1] - grid[0]
    found = minimize_scalar(
        loss, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-9}
    )
    return float(found.x)


@pytest.mark.parametrize("projectors", [3, 4])
def test_height_has_the_least_sum_of_losses(projectors: int) -> None:
    height, sigma = drawn(projectors, 60)
    found, _ = estimate(height, 1.0 / sigma**2)
    expected = [least(h, s) for h, s in zip(height.T, sigma.T, strict=True)]
    # A search sees no difference of losses of 1e-15 of some 100: a distance of 1e-6, more where few sigmas hold it.
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_shares_are_how_much_each_height_moves_the_result() -> None:
    height, sigma = drawn(4, 500)
    found, share = estimate(height, 1.0 / sigma**2)
    assert (share >= 0.0).all()
    # Adding the same to all adds it to the result.
    np.testing.assert_allclose(share.sum(axis=0), 1.0, rtol=1e-12)
    for i in range(4):
        moved = height.copy()
        moved[i] += 1e-6
        change = (estimate(moved, 1.0 / sigma**2)[0] - found) / 1e-6
        # Differences of numbers of 50 in 1e-16 of them over 1e-6. A corner within 1e-6 of 500 x 4 distances: none.
        np.testing.assert_allclose(change, share[i], atol=1e-7)


@pytest.mark.parametrize("others", [2, 3])
def test_one_wrong_height_moves_the_result_by_three_sigma_of_the_others_at_most(
    others: int,
) -> None:
    rng = np.random.default_rng(others)
    sigma = rng.uniform(0.1, 3.0, (others + 1, 1000))
    weight = 1.0 / sigma**2
    height = np.zeros_like(sigma)
    height[0] = 1e3
    found, share = estimate(height, weight)
    assert (found > 0.0).all() and (found * np.sqrt(weight[1:].sum(axis=0)) <= 3.0 + 1e-9).all()
    assert not share[0].any()


def of(height_mm: float, sigma_mm: float) -> decode.Reconstruction:
    """One pixel's reconstruction."""
    rec = decode.Reconstruction.of_heights([[height_mm]])
    return replace(rec, sigma_mm=np.full((1, 1), sigma_mm, np.float32), projector=rec.exposure)


def joined(*each: decode.Reconstruction) -> decode.Reconstruction:
    best = each[0]
    for one in each[1:]:
        best = better(best, one)
    return of_all(best, [Heights.of(one) for one in each])


def test_two_that_disagree_leave_the_one_with_the_smaller_sigma() -> None:
    one, near, far = of(1.0, 0.003), of(1.014, 0.004), of(1.016, 0.004)
    # Their difference has a sigma of 5 um.
    assert joined(one, near).height_mm == pytest.approx(1.0 + 0.014 * 9 / 25, abs=1e-6)
    assert joined(one, near).sigma_mm == pytest.approx(0.003 * 0.8, rel=1e-6)
    for apart in (joined(one, far), joined(far, one)):
        assert apart.height_mm == one.height_mm and apart.sigma_mm == one.sigma_mm


@pytest.mark.parametrize("sigma_mm", [0.0, np.nan, np.inf])
def test_a_height_of_no_known_sigma_is_not_averaged(sigma_mm: float) -> None:
    one, odd = of(1.0, 0.003), of(2.0, sigma_mm)
    assert joined(one, odd).height_mm in (1.0, 2.0)


def test_predicted_sigma_of_three_projectors_is_that_of_their_heights() -> None:
    one = rig(size=SIZE)
    places = [(30, 18, 50), (-30, 18, 50), (-30, -18, 50)]
    devices = [
        one.projectors[0].model_copy(update={"pose": LookAt(origin_mm=place)}) for place in places
    ]
    shown, frames, patterns = PhaseShift(periods_px=(16.0, 80.0)), [], []
    for i, device in enumerate(devices):
        alone = one.model_copy(update={"projectors": (device,)})
        made = calibrated_stack(
            alone,
            np.zeros(SIZE[::-1]),
            shown,
            sigma_dn=1.0,
            modulation=30.0 + 30.0 * i,
            rng=np.random.default_rng(i),
        )
        frames.append(made.frames)
        patterns += [replace(frame, projector=i) for frame in made.patterns]
    three = one.model_copy(update={"projectors": tuple(devices)})
    stack = Stack(
        np.concatenate(frames, axis=1),
        tuple(patterns),
        (1.0,),
        SimpleSensor(sigma_dn=1.0, bits=0),
        three,
    )
    rec = decode.reconstruct(stack)
    assert rec.valid.all()
    z = rec.height_mm / rec.sigma_mm
    # Independent pixels: shares within 4 standard errors, as are mean and mean square.
    for limit, share in ((1.0, 0.6827), (2.0, 0.9545), (3.0, 0.9973)):
        error = np.sqrt(share * (1.0 - share) / z.size)
        assert abs((np.abs(z) < limit).mean() - share) < 4.0 * error
    assert abs(z.mean()) < 4.0 / np.sqrt(z.size)
    assert abs((z**2).mean() - 1.0) < 4.0 * np.sqrt(2.0 / z.size)
    # All three agree nearly everywhere: variances add as their inverses do.
    inverse = sum(1.0 / decode.reconstruct(stack, projector=i).sigma_mm ** 2 for i in range(3))
    same = np.isclose(rec.sigma_mm * np.sqrt(inverse), 1.0, rtol=1e-5)
    # Each of three is beyond its corner in 0.27 %.
    assert same.mean() > 0.985
