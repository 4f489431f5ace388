"""The weighted fits against the same fits by NumPy in double precision."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from decode.device import Device
from decode.fusion.interface import FusionRule, Samples
from decode.fusion.least_squares import InverseVariance, MaskedLeastSquares, quotients
from decode.fusion.weighted_fit import SINGULAR
from decode.phase.n_step import FringeSet, Phasor

Map = NDArray[np.float64]
BLACK_DN, SATURATION_DN, PIXELS = 64.0, 4000.0, 48
# Half a unit in the last place of float32, and how often a step's light is rounded on its way to the phase at most: 8 times
# for its weight, up to 6 for the sum over exposures, 15 in the fit.
ROUNDING, TIMES = 2.0**-24, 29


@dataclass(frozen=True)
class Fit:
    """What NumPy finds; (pixel,)."""

    phase_rad: Map
    variance_rad2: Map
    offset: Map
    """DN/ms."""
    three: NDArray[np.bool_]
    """Where three steps have weight."""
    rounded_rad: Map
    """What one rounding of every step's light can do to the phase."""
    condition: Map
    """By how much the determinant is less than its diagonal's product."""


def fit(dn: Map, counts: NDArray[np.bool_], times_ms: Map, noise: Map, shifts: Map) -> Fit:
    """By the normal equations; `dn` above black and `counts` (exposure, step, pixel), `noise` (constant, slope)."""
    t = times_ms[:, None, None]
    brightness = (counts * dn).sum(0) / np.maximum((counts * t).sum(0), 1e-30)
    variance = noise[0] + noise[1] * t * np.maximum(brightness, 0.0)
    weight = (counts * t**2 / variance).sum(0).T
    pull, size = ((counts * t * x / variance).sum(0).T for x in (dn, np.abs(dn)))
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    three = (weight > 0.0).sum(1) >= 3
    weight[~three], pull[~three], size[~three] = 1.0, 1.0 + np.cos(shifts), 1.0
    normal = np.einsum("ni,pn,nj->pij", design, weight, design)
    covariance = np.linalg.inv(normal)
    found = np.einsum("pij,nj,pn->pi", covariance, design, pull)
    _, c, s = found.T
    across = np.stack([np.zeros_like(c), -s, c]) / (c**2 + s**2)
    share = np.einsum("ip,pij,nj->pn", across, covariance, design)
    block = np.linalg.inv(covariance[:, 1:, 1:])
    diagonal = block[:, 0, 0] * block[:, 1, 1]
    return Fit(
        np.arctan2(s, c),
        np.einsum("ip,pij,jp->p", across, covariance, across),
        found[:, 0],
        three,
        ROUNDING * (np.abs(share) * (size + weight * np.abs(found @ design.T))).sum(1),
        diagonal / np.linalg.det(block),
    )


def capture(
    seed: int, times_ms: Map, noise: Map, shifts: Map
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Digital numbers (exposure, step, pixel) of fringes from dim to many times saturation, and which are not clipped."""
    rng = np.random.default_rng(seed)
    light = np.exp(rng.uniform(np.log(50.0), np.log(12_000.0), PIXELS)) / times_ms.min()
    contrast, phase = rng.uniform(0.2, 1.0, PIXELS), rng.uniform(-np.pi, np.pi, PIXELS)
    wave = 1.0 + contrast * np.cos(phase + shifts[:, None])
    mean = times_ms[:, None, None] * light * wave
    dn = mean + rng.normal(size=mean.shape) * np.sqrt(noise[0] + noise[1] * mean)
    dn = np.minimum(dn + BLACK_DN, SATURATION_DN).astype(np.float32)
    return dn, dn < SATURATION_DN


def fuse(
    rule: FusionRule,
    dn: NDArray[np.float32],
    shifts: Sequence[float],
    times_ms: Sequence[float],
    noise: Map,
) -> Phasor:
    """A rule's phasor of digital numbers (exposure, step, pixel)."""
    device = Device.open()
    return rule.fuse(
        Samples(
            device=device,
            fringes=FringeSet("column", 16.0, tuple(range(len(shifts))), tuple(shifts)),
            dn=tuple(tuple(device.plane(plane[None]) for plane in exposure) for exposure in dn),
            exposure_ms=tuple(times_ms),
            black_level_dn=BLACK_DN,
            saturation_dn=SATURATION_DN,
            whole=False,
            noise=((float(noise[0]), float(noise[1])),) * len(times_ms),
        )
    )


steps = st.one_of(
    st.permutations([0, 1, 2, 3]).map(lambda k: [0.5 * np.pi * i for i in k]),
    st.tuples(st.sampled_from([3, 4, 5, 8]), st.floats(0.0, 6.0)).map(
        lambda given: [given[1] + 2.0 * np.pi * k / given[0] for k in range(given[0])]
    ),
    st.just([0.0, 1.0, 2.5, 3.0, 4.4]),
)
# From nanoseconds to a minute.
times = st.tuples(
    st.lists(st.floats(0.02, 50.0), min_size=1, max_size=6), st.sampled_from([1e-4, 1.0, 1e3])
).map(lambda given: [given[1] * time_ms for time_ms in given[0]])


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    shifts=steps,
    times_ms=times,
    constant=st.floats(0.1, 100.0),
    slope=st.one_of(st.just(0.0), st.floats(0.01, 3.0)),
    whole=st.booleans(),
)
@example(0, [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi], [0.25, 1.0, 4.0, 16.0], 1.0, 0.38, True)
@example(1, [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi], [0.25, 1.0, 4.0, 16.0], 1.0, 0.38, False)
# Four quarters and one step more.
@example(2, [0.0, 0.5 * np.pi, np.pi, 1.5 * np.pi, 0.7], [0.25, 1.0, 4.0, 16.0], 1.0, 0.38, False)
def test_fits_are_numpys_to_rounding(
    seed: int,
    shifts: Sequence[float],
    times_ms: list[float],
    constant: float,
    slope: float,
    whole: bool,
) -> None:
    delta, t, noise = np.asarray(shifts), np.asarray(times_ms), np.array([constant, slope])
    dn, counts = capture(seed, t, noise, delta)
    if whole:
        counts &= counts.all(axis=1, keepdims=True)
    want = fit(dn.astype(np.float64) - BLACK_DN, counts, t, noise, delta)
    phasor = fuse(InverseVariance() if whole else MaskedLeastSquares(), dn, shifts, times_ms, noise)
    usable = phasor.usable.numpy()
    assert not usable[~want.three].any()
    # float32 distinguishes a determinant from zero unless it is nearly lost.
    clear = want.three & (want.condition < 0.1 / SINGULAR)
    assert usable[clear].all()
    # What the determinant loses, the centred fit loses.
    rounded = TIMES * want.rounded_rad * want.condition
    at = clear & (rounded < 0.01)
    cosine, sine = (x.numpy().astype(np.float64)[at] for x in (phasor.cosine, phasor.sine))
    off = np.abs(np.angle(np.exp(1j * (np.arctan2(sine, cosine) - want.phase_rad[at]))))
    assert (off <= rounded[at]).all()
    longest_ms = np.where(counts.any(axis=1), t[:, None], 0.0).max(axis=0)
    above = phasor.offset.numpy()[at].astype(np.float64) - BLACK_DN
    tolerance = TIMES * ROUNDING * want.condition[at]
    assert (
        np.abs(above - (want.offset * longest_ms)[at])
        <= 4.0 * tolerance * np.abs(want.offset * longest_ms)[at] + ROUNDING * BLACK_DN
    ).all()
    # Relative, and once more by what the phase's own error turns.
    ratio = phasor.variance_rad2.numpy()[at].astype(np.float64) / want.variance_rad2[at]
    assert (np.abs(ratio - 1.0) <= 4.0 * tolerance + 8.0 * rounded[at]).all()


@pytest.mark.parametrize("slope", [0.0, 0.4])
@pytest.mark.parametrize("steps", [4, 5, 8])
def test_two_usable_steps_give_no_phase(steps: int, slope: float) -> None:
    """The two on which the cosine is the same: all that is left of its moments is rounding."""
    rng = np.random.default_rng(steps)
    dn = np.full((1, steps, 4096), SATURATION_DN, np.float32)
    dn[0, [1, -1]] = rng.uniform(100.0, 3900.0, (2, 4096))
    shifts = 2.0 * np.pi * np.arange(steps) / steps
    found = fuse(MaskedLeastSquares(), dn, shifts.tolist(), [1.0], np.array([1.0, slope]))
    assert not found.usable.numpy().any()


@pytest.mark.parametrize("count", range(1, 10))
def test_quotients_by_one_division_are_the_quotients(count: int) -> None:
    device = Device.open()
    rng = np.random.default_rng(count)
    under = np.exp(rng.uniform(-4.0, 4.0, (count, 64))).astype(np.float32)
    over = rng.uniform(0.5, 2.0, 64).astype(np.float32)
    real = device.types.Float
    found = quotients(real(over), [real(row) for row in under])
    for row, quotient in zip(under, found, strict=True):
        # Products in pairs of pairs: two roundings a level, of which nine have four, and the division's.
        assert np.abs(quotient.numpy() * row.astype(np.float64) / over - 1.0).max() < 10 * ROUNDING
