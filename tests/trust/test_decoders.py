"""Decoders against closed forms: biases that they must have, and none that they must not.

Fringes are made from formulas, light and sensor have no part in them.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special, stats

import decode
from decode.phase.gamma import TABLE
from evaluation.theory import phase_noise
from evaluation.theory.clipping import clipped_harmonic, saturation_bias
from scenes.acquisition.patterns import GrayBits, GrayCode, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from tests.decode.synthetic import calibrated_stack, coordinates, hills, rig
from tests.trust import chance

pytestmark = pytest.mark.trust

Floats = NDArray[np.float64]
Figure = Callable[[str, str], None]
PHASES, REPEATS = 48, 8192
MODULATION_DN = 100.0
PLAIN: dict[str, Any] = {
    "height": "phase",
    "unwrap": "row-scan",
    "saturation": "ignore",
    "min_modulation_dn": 0.0,
}


def even_phases() -> Floats:
    return np.linspace(-np.pi, np.pi, PHASES, endpoint=False) + np.pi / PHASES


def stack_of(
    frames: Floats, patterns: PhaseShift | GrayCode, sigma_dn: float, bits: int = 0
) -> Stack:
    """One exposure of frames (frame, row, col) in DN; without rounding nothing clips."""
    sensor = SimpleSensor(sigma_dn=sigma_dn, bits=bits)
    if bits:
        frames = np.clip(np.rint(frames), 0.0, sensor.full_scale_dn)
    return Stack(frames.astype(sensor.dtype)[None], patterns.frames(), (1.0,), sensor)


def noisy(means: Floats, sigma_dn: float, *names: object) -> Floats:
    """Repeats of (step, phase): (step, repeat, phase)."""
    rng = chance.generator("decoders", *names)
    noise = rng.standard_normal((len(means), REPEATS, means.shape[1]))
    return np.asarray(means[:, None] + sigma_dn * noise)


def phase_errors(stack: Stack, true: Floats, **choices: Any) -> Floats:
    """(repeat, phase) in [-pi, pi)."""
    rec = decode.reconstruct(stack, **(PLAIN | choices))
    return np.asarray((rec.wrapped_rad - true + np.pi) % (2.0 * np.pi) - np.pi, np.float64)


def p_of_mean(errors: Floats, expected: Floats | float = 0.0, slack: Any = 0.0) -> float:
    """Of the means over repeats, phase by phase."""
    off = np.maximum(np.abs(errors.mean(axis=0) - expected) - slack, 0.0)
    return chance.family(chance.two_sided(off / stats.sem(errors, axis=0)))


def shift_of(steps: int) -> Floats:
    return 2.0 * np.pi * np.arange(steps)[:, None] / steps


# float32 samples, sums and arctangent
FLOAT32_RAD = 3e-6


@pytest.mark.parametrize("snr", [3.0, 10.0, 40.0])
@pytest.mark.parametrize("steps", [3, 4, 5, 8, 12])
def test_n_steps_are_unbiased_with_the_noise_of_a_phasor(
    steps: int, snr: float, record_property: Figure
) -> None:
    """A failure points to the least-squares solution. No bias at any phase, by symmetry; noise as the arctangent of a noisy phasor."""
    true = even_phases()
    means = 200.0 + MODULATION_DN * np.cos(true + shift_of(steps))
    sigma = MODULATION_DN / snr
    errors = phase_errors(
        stack_of(
            noisy(means, sigma, steps, snr), PhaseShift(steps=steps, periods_px=(16.0,)), sigma
        ),
        true,
    )
    z = errors.mean(axis=0) / stats.sem(errors, axis=0)
    a = np.sqrt(steps / 2.0) * snr
    expected = float(np.sum(phase_density(a, GRID) * GRID**2) * (GRID[1] - GRID[0]))
    variance = float(np.mean(errors**2))
    spread = float((errors**2).std() / np.sqrt(errors.size))
    record_property(
        "figure",
        f"largest bias of {PHASES} phases {np.abs(z).max():.2f} s.e. ({np.abs(errors.mean(axis=0)).max():.1e} rad), "
        f"variance {variance / expected - 1:+.1e}, s.e. {spread / expected:.1e}",
    )
    limit = chance.ALPHA / 15
    assert p_of_mean(errors, slack=FLOAT32_RAD) > limit
    assert stats.chi2.sf((z**2).sum(), PHASES) > limit
    assert chance.two_sided((variance - expected) / spread) > limit


GRID = np.linspace(-np.pi, np.pi, 40_001)


def phase_density(a: float, x: Floats) -> Floats:
    """Density of the phase of a phasor of length a in unit noise on each axis (Goodman, Statistical Optics, eq. 2.9-25)."""
    c = a * np.cos(x)
    with np.errstate(under="ignore"):
        along = np.sqrt(2.0 * np.pi) * c * np.exp((c**2 - a**2) / 2.0) * stats.norm.cdf(c)
        return np.asarray((np.exp(-(a**2) / 2.0) + along) / (2.0 * np.pi))


@pytest.mark.parametrize("steps", [3, 4, 5, 6, 8])
def test_clipped_fringes_err_by_their_folded_harmonics(steps: int) -> None:
    """A failure points to N-step decoding, or the closed form it is judged by. Random ratios and contrasts, no noise."""
    rng = chance.generator("clipped", steps)

    def ignoring(stack: Stack) -> decode.Reconstruction:
        return decode.reconstruct(stack, **PLAIN)

    for _ in range(6):
        contrast = float(rng.uniform(0.4, 1.0))
        ratio = float(rng.uniform(1.02, 1.0 + contrast))
        found = saturation_bias(
            ignoring, ratios=[ratio], steps=[steps], contrast=contrast, phases=720
        )
        # |c_m| < 1 / m^2: what is left out is below 2 / (steps^2 terms) of an amplitude of 0.1 and more.
        terms = 2000
        folded = sum(
            clipped_harmonic(1 + q * steps, ratio, contrast)
            * np.exp(1j * q * steps * found.phase_rad)
            for q in range(-terms, terms + 1)
        )
        off = np.angle(np.exp(1j * (found.error_rad[0, 0] - np.angle(folded))))
        tail = 2.0 / (steps**2 * terms) / abs(clipped_harmonic(1, ratio, contrast))
        assert np.abs(off).max() < FLOAT32_RAD / contrast + tail


@pytest.mark.parametrize("ratio", [1.1, 1.5, 2.0])
def test_noisy_clipped_8_bit_fringes_err_as_censored_normals_predict(
    ratio: float, record_property: Figure
) -> None:
    """A failure points to clipping in the decoder, or the moments of a censored normal that theory is made of."""
    true, sigma, steps = even_phases(), 3.0, 4
    amplitude = 255.0 * ratio / 2.0
    means = amplitude * (1.0 + np.cos(true + shift_of(steps)))
    patterns = PhaseShift(steps=steps, periods_px=(16.0,))
    errors = phase_errors(stack_of(noisy(means, sigma, "clipped", ratio), patterns, sigma, 8), true)
    moments = phase_noise.clipped(means, np.full(means.shape, sigma**2 + 1 / 12), 0.0, 255.0)
    bias, rms = phase_noise.fringe(*moments).error_rad(true)
    # Theory keeps two moments of a clipped sample, and rounds after clipping: a hundredth of the noise.
    slack = 0.01 * errors.std(axis=0)
    record_property(
        "figure",
        f"bias up to {np.abs(bias).max():.3f} rad, measured within {np.abs(errors.mean(axis=0) - bias).max():.1e} rad",
    )
    assert p_of_mean(errors, bias, slack) > chance.ALPHA / 3
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(np.sqrt(np.mean(rms**2)), rel=0.02)


def gamma_harmonic(m: int, gamma: float) -> float:
    """Fourier coefficient m of ``(0.5 + 0.5 cos) ** gamma``, but for a factor: ``1 / (G(g + 1 + m) G(g + 1 - m))``."""
    return float(special.rgamma(gamma + 1.0 + m) * special.rgamma(gamma + 1.0 - m))


@pytest.mark.parametrize("steps", [3, 4, 5])
@pytest.mark.parametrize("gamma", [0.7, 1.6, 2.2])
def test_gamma_bends_the_phase_by_its_folded_harmonics(steps: int, gamma: float) -> None:
    """A failure points to plain N-step decoding, or, with gamma given, to the table that linearises."""
    patterns = PhaseShift(steps=steps, periods_px=(16.0,))
    true = np.linspace(-np.pi, np.pi, 4096, endpoint=False)
    u = (true % (2.0 * np.pi)) * 16.0 / (2.0 * np.pi)
    frames = np.stack([20.0 + 200.0 * patterns.commanded(f, u) ** gamma for f in patterns.frames()])
    stack = stack_of(frames[:, None], patterns, 0.1)
    # Coefficients fall as m^(-1 - 2 gamma).
    terms = 3000
    folded = sum(
        gamma_harmonic(1 + q * steps, gamma) * np.exp(1j * q * steps * true)
        for q in range(-terms // steps, terms // steps + 1)
        if abs(1 + q * steps) < 160
    )
    bent = np.angle(folded)
    # Of harmonics beyond the 160th, 2 of each N: bounded by their integral, relative to the first.
    tail = 2.0 / steps * 160.0 ** (-2.0 * gamma) / (2.0 * gamma)
    assert np.abs(phase_errors(stack, true)[0] - bent).max() < FLOAT32_RAD + 4.0 * tail
    straight = phase_errors(stack, true, gamma=gamma)[0]
    # Linear interpolation in a table of steps h errs by h^2 / 8 of the second derivative, which is below N^2 of the bend;
    # where gamma < 1 kinks at black bend it sharply, within a step.
    h = 2.0 * np.pi / TABLE
    kink = h if gamma < 1.0 else steps**2 * h**2
    assert np.abs(straight).max() < FLOAT32_RAD + kink * np.abs(bent).max()


@pytest.mark.parametrize("snr", [10.0, 30.0])
def test_linearised_phases_are_unbiased(snr: float, record_property: Figure) -> None:
    """A failure points to a linearising table that makes noise one-sided by more than its curvature does."""
    gamma, steps, true = 2.2, 4, even_phases()
    patterns = PhaseShift(steps=steps, periods_px=(16.0,))
    u = (true % (2.0 * np.pi)) * 16.0 / (2.0 * np.pi)
    means = np.stack([20.0 + 200.0 * patterns.commanded(f, u) ** gamma for f in patterns.frames()])
    sigma = 80.0 / snr
    errors = phase_errors(
        stack_of(noisy(means, sigma, "gamma", snr), patterns, sigma), true, gamma=gamma
    )
    # Second order in the noise: the table's curvature, at most N^2 times its bend of 0.06 rad, and the phasor's own.
    slack = 0.5 * np.mean(errors**2) * (steps**2 * 0.06 + 0.2)
    record_property(
        "figure",
        f"largest mean error {np.abs(errors.mean(axis=0)).max():.1e} rad, allowed {slack:.1e}",
    )
    assert p_of_mean(errors, slack=slack) > chance.ALPHA / 2


SIZE = (256, 192)
CALIBRATION = rig(size=SIZE)
HEIGHT = hills(SIZE)


@pytest.mark.parametrize("snr", [4.0, 5.0])
def test_orders_are_wrong_as_often_as_noise_predicts(snr: float, record_property: Figure) -> None:
    """A failure points to temporal unwrapping. A fine order is wrong where ``|8 e_coarse - e_fine|`` exceeds half a turn."""
    patterns = PhaseShift(steps=4, periods_px=(16.0, 128.0, 512.0))
    column, _ = coordinates(CALIBRATION, HEIGHT)
    modulation, repeats = 40.0, 12
    rng = chance.generator("orders", snr)
    wrong, errors = 0, []
    for _ in range(repeats):
        stack = calibrated_stack(
            CALIBRATION, HEIGHT, patterns, sigma_dn=modulation / snr, modulation=modulation, rng=rng
        )
        rec = decode.reconstruct(stack, anchor="field", height="phase", min_modulation_dn=0.0)
        assert rec.column_px is not None
        off = rec.column_px - column
        slipped = np.abs(off) > 8.0
        wrong += int(slipped.sum())
        errors.append(off[~slipped])
    a = np.sqrt(2.0) * snr
    p_slip = slip_probability(a, 8.0)
    trials = repeats * column.size
    record_property(
        "figure",
        f"{wrong / trials:.5f} slipped, theory {p_slip:.5f} to {p_slip + slip_probability(a, 4.0):.5f}",
    )
    # The coarser climb (ratio 4) and the anchor slip too, a thousandth as often: above, not below.
    assert (
        chance.binomial_p(wrong, trials, p_slip * 0.998, p_slip * 1.002 + slip_probability(a, 4.0))
        > chance.ALPHA / 2
    )
    good = np.concatenate(errors)
    # Slipped ones are missed on both sides alike.
    assert chance.two_sided(good.mean() / stats.sem(good)) > chance.ALPHA / 2


def slip_probability(a: float, ratio: float) -> float:
    """Chance that ``|ratio x - y| > pi`` for two phase errors."""
    x = np.linspace(-np.pi, np.pi, 20_001)
    h = x[1] - x[0]
    density = phase_density(a, x)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2.0) * h])

    def chance_below(y: Floats) -> Floats:
        return np.asarray(np.interp(y, x, below, left=0.0, right=below[-1]), np.float64)

    inside = chance_below(ratio * x + np.pi) - chance_below(ratio * x - np.pi)
    return float(1.0 - (density * inside).sum() * h)


@pytest.mark.parametrize(
    "patterns",
    [
        PhaseShift(steps=4, periods_px=(18.0, 21.0, 24.0)),
        PhaseShift(steps=4, periods_px=(16.0,), gray=GrayBits(bits=6)),
        PhaseShift(steps=3, periods_px=(16.0, 128.0), gray=GrayBits(bits=4)),
    ],
    ids=["heterodyne", "gray", "gray-and-two"],
)
@pytest.mark.parametrize("sigma_dn", [0.5, 2.0])
def test_absolute_coordinates_are_unbiased_with_n_step_noise(
    patterns: PhaseShift, sigma_dn: float, record_property: Figure
) -> None:
    """A failure points to an order, a beat's sign or a code's half cell, all off by more than noise, or to N-step noise."""
    column, _ = coordinates(CALIBRATION, HEIGHT)
    rng = chance.generator("coordinates", str(patterns), sigma_dn)
    modulation = 80.0
    frames = np.stack(
        [
            40.0
            + 2.0 * modulation * patterns.commanded(f, column)
            + sigma_dn * rng.standard_normal(column.shape)
            for f in patterns.frames()
        ]
    )
    sensor = SimpleSensor(sigma_dn=sigma_dn, bits=0)
    stack = Stack(frames.astype(np.float32)[None], patterns.frames(), (1.0,), sensor, CALIBRATION)
    rec = decode.reconstruct(stack, height="phase")
    assert rec.column_px is not None
    off = (rec.column_px - column)[rec.valid]
    period = min(patterns.periods_px)
    sigma = period / (2.0 * np.pi) * np.sqrt(2.0 / patterns.steps) * sigma_dn / modulation
    z = off.mean() / stats.sem(off)
    spread = (off.var() / sigma**2 - 1.0) * np.sqrt(off.size / 2.0)
    record_property(
        "figure", f"{rec.valid.mean():.4f} valid, mean {z:+.2f} s.e., variance {spread:+.2f} s.e."
    )
    assert rec.valid.mean() > 0.99
    assert np.abs(off).max() < 7.0 * sigma
    limit = chance.ALPHA / 6
    assert chance.two_sided(z) > limit
    # The arctangent's curvature adds the square of the phase's sigma, 3e-4 at most.
    assert chance.two_sided(max(abs(spread) - 3e-4 * np.sqrt(off.size / 2.0), 0.0)) > limit


def test_gray_code_alone_errs_uniformly_within_its_cell(record_property: Figure) -> None:
    """A failure points to the cell's middle, or its sigma. Coordinates are random, so errors are uniform over the cell with mean 0."""
    patterns = GrayCode(bits=(8,), cell_px=2.0)
    at = chance.generator("gray").uniform(0.0, 512.0, (400, 500))
    frames = np.stack([30.0 + 160.0 * patterns.commanded(f, at) for f in patterns.frames()])
    rec = decode.reconstruct(stack_of(frames, patterns, 1.0, 8), height="phase")
    assert rec.column_px is not None
    off = rec.column_px - at
    sigma = 2.0 / np.sqrt(12.0)
    z = off.mean() / (sigma / np.sqrt(off.size))
    record_property("figure", f"mean {z:+.2f} s.e., largest {np.abs(off).max():.4f} of 1 px")
    assert np.abs(off).max() <= 1.0 + 1e-4
    assert chance.two_sided(z) > chance.ALPHA / 2
    assert stats.kstest(off.ravel(), stats.uniform(-1.0, 2.0).cdf).pvalue > chance.ALPHA / 2
