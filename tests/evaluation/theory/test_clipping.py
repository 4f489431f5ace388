from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
from evaluation.theory.clipping import clipped_harmonic, saturation_bias, theory_rms_rad
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError

# FIELD's table: unit contrast, RMS over all phases in rad, by ratio and number of steps; measured independently.
STEPS = (3, 4, 5, 6, 8, 12)
TABLE = {
    1.10: (0.0165, 0.0140, 0.0123, 0.0105, 0.0042, 0.0023),
    1.25: (0.0715, 0.0557, 0.0308, 0.0086, 0.0114, 0.0046),
    1.50: (0.188, 0.0847, 0.0060, 0.0345, 0.0108, 0.0064),
    2.00: (0.351, 0.0, 0.0859, 0.0, 0.0, 0.0),
}


def test_table_of_clipped_fringes_is_reproduced() -> None:
    found = saturation_bias()
    assert (found.ratios, found.steps) == (tuple(TABLE), STEPS)
    np.testing.assert_allclose(found.rms_rad, list(TABLE.values()), atol=1e-3)
    # All around the circle, as far apart across half a turn as elsewhere.
    around = np.append(found.phase_rad, found.phase_rad[0] + 2 * np.pi)
    np.testing.assert_allclose(np.diff(around), 2 * np.pi / found.phase_rad.size, rtol=1e-9)
    np.testing.assert_allclose(found.phase_rad, -found.phase_rad[::-1], atol=1e-12)


def test_bias_vanishes_exactly_where_even_steps_clip_at_the_mean() -> None:
    for contrast in (1.0, 2 / 3, 0.25):
        found = saturation_bias(ratios=[1 + contrast], steps=[4, 6, 8, 12], contrast=contrast)
        # float64 rounding of a sum of at most 12 terms, over the fringe's amplitude
        assert found.max_rad.max() < 1e-14 / contrast
        assert all(theory_rms_rad(1 + contrast, n, contrast) < 1e-14 / contrast for n in (4, 6))


def test_folded_harmonics_are_the_phase_error() -> None:
    """The Fourier series of the clipped wave, summed to where its 1/m^2 tail is negligible, against sampling."""
    for ratio, steps, contrast in [(1.25, 3, 1.0), (1.5, 4, 0.7), (1.1, 5, 0.4), (1.8, 7, 1.0)]:
        found = saturation_bias(ratios=[ratio], steps=[steps], contrast=contrast, phases=360)
        terms = range(-2000, 2001)
        folded = sum(
            clipped_harmonic(1 + q * steps, ratio, contrast)
            * np.exp(1j * (1 + q * steps) * found.phase_rad)
            for q in terms
        )
        error = np.angle(folded * np.exp(-1j * found.phase_rad))
        # |c_m| < 1/m^2, so what the sum leaves out is below 2 / (steps^2 2000); c_1 exceeds 0.1 here.
        np.testing.assert_allclose(found.error_rad[0, 0], error, atol=2 / (steps**2 * 2000) / 0.1)


def test_closed_form_is_the_rms_to_first_order() -> None:
    found = saturation_bias(ratios=[1.05, 1.1, 1.25], steps=[4, 5, 6, 8], contrast=0.8)
    for i, ratio in enumerate(found.ratios):
        for j, steps in enumerate(found.steps):
            folded = sum(
                abs(clipped_harmonic(q * steps + s, ratio, 0.8))
                for q in range(1, 50)
                for s in (1, -1)
            )
            expected = theory_rms_rad(ratio, steps, 0.8)
            # what the first order leaves out
            assert found.rms_rad[i, j] == pytest.approx(
                expected, rel=folded / clipped_harmonic(1, ratio, 0.8)
            )


def test_rules_that_know_saturation_reject_exactly_the_clipped_phases() -> None:
    found = saturation_bias("max-modulation", ratios=[0.9, 1.25, 2.0], steps=[4])
    clipped = np.array(
        [
            (1 + np.cos(found.phase_rad + np.arange(4)[:, None] * np.pi / 2)).max(axis=0) * r / 2
            >= 1
            for r in found.ratios
        ]
    ).mean(axis=1)
    np.testing.assert_allclose(found.rejected_fraction[:, 0], clipped, atol=1e-3)
    # float32 samples and arctangent
    assert np.nanmax(found.max_rad) < 2e-6
    assert np.isnan(found.rms_rad[2, 0])


def test_shorter_exposure_removes_the_error_of_rules_that_know_saturation() -> None:
    found = saturation_bias("max-modulation", ratios=[1.5, 3.0], steps=[4], relative=[1.0, 0.25])
    assert (found.rejected_fraction == 0).all()
    assert found.max_rad.max() < 2e-6


def test_own_decoder_gets_the_same_error_as_the_plain_one() -> None:
    def four_step(stack: Stack) -> NDArray[np.float64]:
        i0, i1, i2, i3 = stack.frames[0]
        return np.asarray(np.arctan2(i3 - i1, i0 - i2))

    ours, plain = (saturation_bias(d, steps=[4]) for d in (four_step, None))
    np.testing.assert_allclose(ours.error_rad, plain.error_rad, atol=2e-6)

    def ignoring(stack: Stack) -> decode.Reconstruction:
        return decode.reconstruct(stack, saturation="ignore", height="phase", unwrap="row-scan")

    np.testing.assert_allclose(
        saturation_bias(ignoring, steps=[3, 5]).rms_rad,
        saturation_bias(steps=[3, 5]).rms_rad,
        atol=2e-6,
    )


def test_noise_adds_its_own_variance_and_leaves_the_ripple() -> None:
    noise, steps = 0.005, 8
    found = saturation_bias(ratios=[0.8], steps=[steps], noise=noise, phases=720, repeats=64)
    expected = noise * np.sqrt(2 / steps) / 0.4
    # 46080 samples: the standard deviation's own error is 1/sqrt(2 n); four of them
    assert found.rms_rad[0, 0] == pytest.approx(expected, rel=4 / np.sqrt(2 * 720 * 64))
    clean = saturation_bias(ratios=[1.5], steps=[4], phases=720)
    noisy = saturation_bias(ratios=[1.5], steps=[4], noise=noise, phases=720, repeats=64)
    scatter = noise * np.sqrt(2 / 4) / 0.5
    # clipping at the kink moves the mean of samples within a few sigma of saturation by up to 0.4 sigma
    off = np.sqrt(np.mean((noisy.error_rad - clean.error_rad) ** 2))
    assert off < scatter / np.sqrt(64) + 0.4 * scatter


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"ratios": []}, "ratios"),
        ({"ratios": [1.0, 0.0]}, "ratios"),
        ({"steps": [4, 2]}, "steps"),
        ({"steps": []}, "steps"),
        ({"contrast": 1.5}, "contrast"),
        ({"contrast": 0.0}, "contrast"),
        ({"noise": -1.0}, "noise"),
        ({"relative": [1.0, 0.0]}, "relative"),
        ({"relative": []}, "relative"),
        ({"phases": 7}, "phases"),
        ({"repeats": 0}, "repeats"),
        ({"seed": -1}, "seed"),
        ({"decoder": lambda stack: "phase"}, "answer"),
        ({"decoder": lambda stack: np.zeros(3)}, "shape"),
    ],
)
def test_impossible_parameters_are_named(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ScoreError, match=named):
        saturation_bias(**{"steps": [4], **wrong})


def test_parameters_at_their_limits_are_possible() -> None:
    least = saturation_bias(ratios=[0.5], steps=[3], noise=1e-3, phases=8, repeats=1, seed=0)
    assert np.isfinite(least.rms_rad).all()


def test_noisy_samples_are_clipped_too() -> None:
    """A camera's noise cannot lift a sample above saturation."""
    seen = []

    def watching(stack: Stack) -> NDArray[np.float64]:
        seen.append(float(stack.frames.max()))
        return np.zeros(stack.frames.shape[2:])

    saturation_bias(watching, ratios=[0.95, 1.5], steps=[4], noise=0.05, phases=90, repeats=8)
    # Of 2880 samples, some 700 at the fringe's top are within two sigma of saturation: many would exceed it.
    assert seen == [255.0, 255.0]
