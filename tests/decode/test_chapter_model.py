"""The textbook's ideal model ``u = x + c h``: its figures, and the traps it records."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import decode
from decode.reconstruction import Reconstruction
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from tests.decode.synthetic import Map, digitise, frames

C, SIZE = 4.0, 320
FINE, COARSE = 32.0, 128.0
Y, X = np.mgrid[:SIZE, :SIZE] + 0.5
RADIUS = np.hypot(X - 160.0, Y - 160.0)
STEP = (abs(X - 275) < 25) & (abs(Y - 80) < 40)
HEIGHT: Map = np.where(STEP, 3.0, np.where(RADIUS < 80, 6.0 * (1 - (RADIUS / 80) ** 2), 0.0))
BASE = (RADIUS > 84) & ~STEP
DARK = (X < 60) & (Y > 260)
SPOT = RADIUS < 12


def capture(offset: float | Map, modulation: float | Map, seed: int = 7) -> Stack:
    shown = PhaseShift(steps=4, periods_px=(FINE, COARSE)).frames()
    ideal = frames({"column": X + C * HEIGHT}, shown, offset, modulation)
    counts = digitise(ideal, 3.0, np.uint8, np.random.default_rng(seed))
    return Stack(counts[None], shown, (1.0,), SimpleSensor(sigma_dn=3.0))


def rms(rec: Reconstruction, where: np.ndarray) -> float:
    return float(np.sqrt(np.mean((rec.height_mm[where] - HEIGHT[where]) ** 2)))


def expected_rms(modulation: float) -> float:
    """P / (2 pi c) sigma sqrt(2/N) / B, with the variance 1/12 of rounding."""
    return FINE / (2 * np.pi * C) * float(np.sqrt((9 + 1 / 12) / 2)) / modulation


def interval(count: int) -> tuple[float, float]:
    """Ratio of an RMS over `count` pixels to its expectation, two-sided 1e-6."""
    low, high = np.sqrt(stats.chi2.ppf([5e-7, 1 - 5e-7], count) / count)
    return float(low), float(high)


@pytest.mark.parametrize(("modulation", "figure"), [(80.0, 0.0338), (15.0, 0.1823)])
def test_base_plane_noise_agrees_with_formula_and_chapter(modulation: float, figure: float) -> None:
    rec = decode.reconstruct(
        capture(120.0, modulation), c_px_per_mm=C, min_modulation_dn=0, max_order_residual=0.5
    )
    low, high = interval(int(BASE.sum()))
    # atan2 is not linear: its noise exceeds the linearised one by about sigma_phi^2 (2 % at B = 15).
    bend = 1 + expected_rms(modulation) ** 2 * (2 * np.pi * C / FINE) ** 2
    assert low < rms(rec, BASE) / expected_rms(modulation) < high * bend
    assert rms(rec, BASE) == pytest.approx(figure, rel=0.02)
    assert np.median(rec.sigma_mm[BASE]) == pytest.approx(expected_rms(modulation), rel=0.02)


def test_cap_and_step_heights_are_the_true_ones() -> None:
    rec = decode.reconstruct(capture(120.0, 80.0), c_px_per_mm=C)
    apex, step = RADIUS < 3, STEP
    for where in (apex, step):
        error = float(np.mean(rec.height_mm[where] - HEIGHT[where]))
        # Five standard errors of the mean.
        assert abs(error) < 5 * expected_rms(80.0) / np.sqrt(where.sum())


def test_modulation_mask_flags_the_dark_region_and_only_it() -> None:
    albedo = np.where(DARK, 0.18, 1.0)
    rec = decode.reconstruct(
        capture(120 * albedo, 80 * albedo), c_px_per_mm=C, min_modulation_dn=20
    )
    # B = 14.4 and sigma_B = sigma / sqrt(2): 99.57 % below 20; binomial five sigma over 3600 pixels.
    flagged = float(np.mean(~rec.valid[DARK]))
    share = stats.norm.cdf((20 - 14.4) / np.sqrt((9 + 1 / 12) / 2))
    assert abs(flagged - share) < 5 * np.sqrt(share * (1 - share) / DARK.sum())
    assert rec.valid[BASE & ~DARK].all()
    low, high = interval(int(DARK.sum()))
    bend = 1 + expected_rms(14.4) ** 2 * (2 * np.pi * C / FINE) ** 2
    assert low < rms(rec, DARK) / expected_rms(14.4) < high * bend


def highlight() -> Stack:
    gain = np.where(SPOT, 1.7, 1.0)
    return capture(120 * gain, 80 * gain)


def test_saturation_passes_the_modulation_mask_silently_when_it_is_ignored() -> None:
    rec = decode.reconstruct(
        highlight(), c_px_per_mm=C, min_modulation_dn=20, saturation="ignore", fusion="single"
    )
    assert rec.valid[SPOT].all()
    # B = 136 would give 0.0199 mm; clipping, not noise, makes several times that.
    assert rms(rec, SPOT) > 3 * expected_rms(136.0)


def test_saturation_is_flagged_by_default() -> None:
    stack = highlight()
    rec = decode.reconstruct(stack, c_px_per_mm=C)
    clipped = (stack.frames[0] >= 255).any(axis=0)
    assert clipped[SPOT].any()
    assert (rec.reason[clipped] == decode.Reason.SATURATED).all()
    assert rec.valid[~clipped].all()


def test_max_modulation_fusion_cures_the_highlight_and_the_dark_region() -> None:
    albedo = np.where(DARK, 0.18, np.where(SPOT, 1.7, 1.0))
    times = (0.5, 1.0, 4.0)
    taken = [capture(120 * albedo * t, 80 * albedo * t, seed=k) for k, t in enumerate(times)]
    stack = replace(
        taken[0], frames=np.concatenate([one.frames for one in taken]), exposure_ms=times
    )
    rec = decode.reconstruct(stack, c_px_per_mm=C)
    best = {0.18: 4.0, 1.7: 0.5, 1.0: 1.0}
    for region, level in ((DARK, 0.18), (SPOT, 1.7), (BASE & ~DARK, 1.0)):
        assert rec.valid[region].all()
        assert (rec.exposure[region] == times.index(best[level])).all()
        low, high = interval(int(region.sum()))
        assert low < rms(rec, region) / expected_rms(80 * level * best[level]) < high * 1.01
