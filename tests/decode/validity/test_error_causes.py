"""Mixed pixels and indirect light: what the total sigma covers, what is rejected, and what is left alone."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import decode
from decode.validity import error_causes
from decode.validity.error_causes import _below_best, across_projectors
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError, FringebenchWarning
from tests.decode.synthetic import Map, calibrated_stack, rig

SIZE = (96, 72)
SHOWN = PhaseShift(periods_px=(16.0, 80.0, 400.0))
PATCH = np.s_[20:52, 30:66]
INSIDE = np.s_[23:49, 33:63]


def stack(
    height_mm: Map | float = 0.0, modulation: Callable[[float], Map | float] = lambda _: 80.0
) -> Stack:
    """Frames of a telecentric rig with noise of 1 DN; `modulation` in DN by period."""
    heights = np.broadcast_to(np.asarray(height_mm, float), SIZE[::-1])
    made = [
        calibrated_stack(
            rig(size=SIZE),
            heights,
            PhaseShift(periods_px=(period,)),
            sigma_dn=1.0,
            modulation=modulation(period),
            rng=np.random.default_rng(int(period)),
        )
        for period in SHOWN.periods_px
    ]
    frames = np.concatenate([part.frames for part in made], axis=1)
    return replace(made[0], frames=frames, patterns=SHOWN.frames())


def patch_loss(by_period: Callable[[float], float]) -> Callable[[float], Map]:
    """Modulation in DN of a surface whose patch loses a share of it."""

    def modulation(period_px: float) -> Map:
        dn = np.full(SIZE[::-1], 80.0)
        dn[PATCH] *= 1.0 - by_period(period_px)
        return dn

    return modulation


def by_cause(made: Stack) -> decode.Reconstruction:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FringebenchWarning)
        return decode.reconstruct(made, uncertainty="by-cause")


def test_a_clean_surface_keeps_the_sensors_sigma() -> None:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    # A slope of 7 degrees and a dome of 10 more: neither is a step.
    slope = 0.02 * x + 0.5 * np.exp(-((x - 48) ** 2 + (y - 36) ** 2) / 400.0)
    for surface in (np.zeros_like(slope), slope):
        rec = by_cause(stack(surface))
        assert rec.valid.all()
        inflated = rec.total_sigma_mm > 1.03 * rec.sigma_mm
        # By chance 0.5 % deviate, and 0.02 % inflate their eight neighbours.
        assert inflated.mean() < 0.02


def test_heights_and_the_sensors_sigma_are_the_same_with_and_without_causes() -> None:
    made = stack()
    with_causes, without = by_cause(made), decode.reconstruct(made)
    assert np.array_equal(with_causes.height_mm, without.height_mm)
    assert np.array_equal(with_causes.sigma_mm, without.sigma_mm)
    assert np.array_equal(without.total_sigma_mm, without.sigma_mm)
    assert not without.cause_sigma_mm


@pytest.mark.parametrize("step_mm", [0.05, 0.2, 1.0])
def test_pixels_that_see_both_sides_of_a_step_are_rejected_or_covered(step_mm: float) -> None:
    low, high = stack(0.0), stack(step_mm)
    seen = np.broadcast_to(np.arange(SIZE[0]) > 48, SIZE[::-1]).astype(float)
    rows = np.arange(SIZE[1])
    seen[:, 48] = (rows + 0.5) / SIZE[1]  # A slanted edge: every share of both heights.
    made = replace(low, frames=(low.frames * (1 - seen) + high.frames * seen).astype(np.float32))
    truth = np.where(seen >= 0.5, step_mm, 0.0)
    rec = by_cause(made)
    error = np.abs(rec.height_mm - truth)
    beyond = rec.valid & (error > 5.0 * rec.total_sigma_mm)
    assert beyond.sum() == 0
    # The edge is one column, and its neighbours on both sides may go with it.
    rejected = rec.reason == decode.Reason.MIXED
    assert rejected[:, :46].sum() + rejected[:, 52:].sum() <= 1
    sensor = decode.reconstruct(made)
    assert (np.abs(sensor.height_mm - truth) > 5.0 * sensor.sigma_mm)[:, 48].mean() > 0.1


def test_a_pixel_next_to_shadow_may_have_the_height_of_its_lit_part() -> None:
    made = stack()
    frames = made.frames.copy()
    frames[..., 20:50, 40:44] = 40.0  # No fringes.
    rec = by_cause(replace(made, frames=frames))
    mixed = rec.cause_sigma_mm["mixed"]
    assert (rec.reason[20:50, 40:44] == decode.Reason.SHADOW).all()
    assert not mixed[20:50, 40:44].any()
    # One pixel of the plane changes the projector's column by so much, and 1 mm of height by so much.
    low, high = (decode.reconstruct(stack(mm)).phases["column"].coordinate_px for mm in (0.0, 1.0))
    one_pixel_mm = np.hypot(*np.gradient(low)).mean() / np.abs(high - low).mean()
    # Of the pixels around, the first ring has it; of the second, 0.5 % deviate by chance, and make a few neighbours.
    for side in (mixed[20:50, 39], mixed[20:50, 44], mixed[19, 40:44], mixed[50, 40:44]):
        assert np.median(side) == pytest.approx(0.2 * one_pixel_mm, rel=0.15)
    for side in (mixed[20:50, 38], mixed[20:50, 45], mixed[18, 40:44], mixed[51, 40:44]):
        assert (side > 0).mean() <= 0.1
    assert (mixed[:, 46:] > 0).mean() < 0.02


def of_heights(height_mm: Map, mm_per_rad: float = 1.0) -> decode.Reconstruction:
    """What the heights alone show, where noise is 1 um."""
    rec = decode.Reconstruction.of_heights(height_mm)
    one = np.ones(height_mm.shape, np.float32)
    rec = replace(rec, sigma_mm=1e-3 * one)
    return error_causes.by_cause(rec, error_causes.Signs((), (), 1e-3 * one, mm_per_rad * one))[0]


def test_a_pixel_that_stands_out_widens_its_neighbours() -> None:
    height = np.zeros((15, 15))
    height[7, 6] = 0.1
    # It deviates from its eight neighbours and they from it.
    near = np.zeros_like(height, dtype=bool)
    near[6:9, 5:8] = True
    assert np.array_equal(of_heights(height).cause_sigma_mm["mixed"] > 0, near)
    # A pixel without a height beside them has no noise that would explain it.
    height[7, 8] = np.nan
    assert (of_heights(height).cause_sigma_mm["mixed"][near] > 0).all()


@pytest.mark.parametrize(("times", "rejected"), [(3.0, False), (4.0, True)])
def test_a_pixel_is_mixed_that_deviates_by_much_more_than_its_region_does(
    times: float, rejected: bool
) -> None:
    # A chessboard of +-0.5 mm: every pixel deviates by 1 mm. With four such, one in its middle is no roughness.
    rough = 0.5 * (-1.0) ** np.indices((21, 21)).sum(axis=0)
    assert rough[10, 10] == 0.5
    rough[10, 10] = times - 0.5
    rec = of_heights(rough)
    assert (rec.reason[10, 10] == decode.Reason.MIXED) == rejected
    assert rec.valid[:8].all() and rec.valid[13:].all()


@pytest.mark.parametrize(("rad", "rejected"), [(0.15, False), (0.25, True)])
def test_a_lone_pixel_is_mixed_that_deviates_by_a_fifth_of_a_radian(
    rad: float, rejected: bool
) -> None:
    height = np.zeros((15, 15))
    height[7, 6] = 0.5 * rad
    rec = of_heights(height, mm_per_rad=0.5)
    assert (rec.reason[7, 6] == decode.Reason.MIXED) == rejected
    assert rec.valid.sum() == height.size - rejected


@pytest.mark.parametrize("size", [(9, 1), (1, 9), (2, 2)])
def test_images_of_few_pixels_are_decoded(size: tuple[int, int]) -> None:
    shown = PhaseShift(periods_px=(80.0, 400.0))
    made = calibrated_stack(rig(size=size), np.zeros(size[::-1]), shown, sigma_dn=0.5)
    rec = by_cause(made)
    assert np.isfinite(rec.total_sigma_mm).all()


def test_indirect_light_widens_sigma_by_the_modulation_it_takes() -> None:
    # Light that spreads loses modulation in proportion to frequency: 1, 1/5 and 1/25 of the finest's loss.
    rec = by_cause(stack(modulation=patch_loss(lambda period: 0.25 * 16.0 / period)))
    stray = rec.cause_sigma_mm["stray"]
    outside = np.ones(SIZE[::-1], bool)
    outside[PATCH] = False
    # 1 DN of noise on four steps of B = 60 DN turns the phase by sqrt(2/4)/60 = 0.012 rad. A loss of 0.25, less 0.03 and
    # three sigma of the mean of nine, 0.02, is 0.20: half of 0.20/0.80 is 0.125 rad, 10.6 times the noise.
    assert np.median((stray / rec.sigma_mm)[INSIDE]) == pytest.approx(10.6, rel=0.1)
    assert (stray[INSIDE] > 3.0 * rec.sigma_mm[INSIDE]).mean() > 0.95
    assert (stray[outside] > 0.25 * rec.sigma_mm[outside]).mean() < 0.03
    assert rec.valid[INSIDE].all()


def test_a_third_of_the_modulation_lost_is_stray_and_the_stack_is_in_doubt() -> None:
    made = stack(modulation=patch_loss(lambda period: 0.5 * 16.0 / period))
    made.frames[..., 5, 5] = 40.0  # A pixel without fringes, as every image has.
    with pytest.warns(FringebenchWarning, match="lose more than a quarter of their modulation"):
        rec = decode.reconstruct(made, uncertainty="by-cause")
    assert (rec.reason[INSIDE] == decode.Reason.STRAY).mean() > 0.98
    assert rec.reason_fractions()["stray"] < 1.2 * (32 * 36) / (96 * 72)


@pytest.mark.parametrize("left", [0.8, 0.6])
def test_blur_takes_modulation_and_moves_no_phase(left: float) -> None:
    # A Gaussian's loss grows with frequency squared: 1/25 of the finest's from 80 px.
    blurred = stack(modulation=patch_loss(lambda period: 1.0 - left ** ((16.0 / period) ** 2)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rec = decode.reconstruct(blurred, uncertainty="by-cause")
    assert rec.valid.all()
    assert not rec.cause_sigma_mm["stray"].any()
    # Brightness changes at the patch's border alone.
    blur = rec.cause_sigma_mm["blur"]
    assert (blur[INSIDE] > 0).mean() < 0.01
    assert blur[PATCH].any()


def test_sigma_is_finite_next_to_pixels_without_numbers() -> None:
    made = stack()
    made.frames[..., 10, 10], made.frames[..., 30, 40] = np.nan, np.inf
    rec = by_cause(made)
    assert not rec.valid[[10, 30], [10, 40]].any()
    assert np.isfinite(rec.total_sigma_mm[rec.valid]).all()
    assert rec.valid.mean() > 0.99


@pytest.mark.parametrize("height_mm", [0.2, 1.0])
def test_pixels_on_both_sides_of_a_clean_edge_are_valid(height_mm: float) -> None:
    step = np.zeros(SIZE[::-1])
    step[20:52, 30:66] = height_mm
    rec = by_cause(stack(step))
    # All three neighbours of one side are on the pixel's own surface, except at the corners of the block.
    corners = np.zeros_like(step, bool)
    corners[[20, 20, 51, 51], [30, 65, 30, 65]] = True
    assert (rec.valid | corners).all()


def highlight(narrow_px: float, blur_px: float, periods_px: tuple[float, ...]) -> Stack:
    """Four times the light on a Gaussian spot of a flat surface, with hardly any noise, through a lens with Gaussian blur."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    light = 1.0 + 3.0 * np.exp(-((x - 48.0) ** 2 + (y - 36.0) ** 2) / (2 * narrow_px**2))
    sharp = calibrated_stack(
        rig(size=SIZE),
        np.zeros(SIZE[::-1]),
        PhaseShift(periods_px=periods_px),
        offset=30 * light,
        modulation=20 * light,
    )
    frames = gaussian_filter(sharp.frames, (0, 0, blur_px, blur_px), mode="nearest")
    noisy = frames + np.random.default_rng(3).normal(0.0, 0.004, frames.shape)
    return replace(
        sharp, frames=noisy.astype(np.float32), sensor=SimpleSensor(sigma_dn=0.004, bits=0)
    )


# With one period the blur is taken for 1 px, which it is here.
@pytest.mark.parametrize("periods_px", [SHOWN.periods_px, (80.0,)])
@pytest.mark.parametrize("narrow_px", [2.0, 4.0])
def test_blurred_brightness_turns_the_phase_by_twice_the_sigma_claimed(
    narrow_px: float, periods_px: tuple[float, ...]
) -> None:
    rec = by_cause(highlight(narrow_px, 1.0, periods_px))
    inner = np.s_[5:-5, 5:-5]
    error, blur = np.abs(rec.height_mm)[inner], rec.cause_sigma_mm["blur"][inner]
    wrong = error > 20.0 * rec.sigma_mm[inner]
    assert wrong.sum() > 20
    # For a Gaussian blur, s^2 grad(B) / B is exact, with B as it is seen, of variance W = w^2 + 1; half of it is claimed. A 3 x 3
    # derivative smooths by 1/2 px^2, which changes the derivative of a Gaussian by up to 0.8 / W within 2.5 of its sigmas. The
    # finest fringes fade by up to exp(-0.65^2 / 2) less in the spot than beside it, in 1/W of the way: 0.2 / W.
    ratio, flatter = np.median(error[wrong] / blur[wrong]), 1.0 / (narrow_px**2 + 1.0)
    assert 2.0 * (1.0 - flatter) < ratio < 2.0 * (1.0 + flatter)
    assert (error > 5.0 * rec.total_sigma_mm[inner]).sum() == 0


def test_a_sharp_camera_has_the_blur_of_its_pixels_area() -> None:
    sharp, blurred = (
        by_cause(highlight(6.0, px, SHOWN.periods_px)).cause_sigma_mm["blur"] for px in (0.0, 1.0)
    )
    both = (sharp > 0) & (blurred > 0)
    assert both.sum() > 50
    # 1/12 px^2 against 1 px^2, of a spot that is flatter by blur: variance 36 against 37.
    assert np.median(blurred[both] / sharp[both]) == pytest.approx(12.0, rel=0.1)


def test_a_rough_surface_is_measured_with_the_sigma_of_its_roughness() -> None:
    rough = np.zeros(SIZE[::-1])
    noise = np.random.default_rng(0).normal(0.0, 0.05, rough[PATCH].shape)
    rough[PATCH] = noise
    rec = by_cause(stack(rough))
    # Heights that scatter by ten sensor sigmas around the plane are what a region's errors look like.
    assert rec.valid[INSIDE].mean() > 0.9
    assert (np.abs(rec.height_mm) > 5.0 * rec.sigma_mm)[INSIDE].mean() > 0.3
    assert (np.abs(rec.height_mm) > 5.0 * rec.total_sigma_mm)[INSIDE].mean() < 0.01
    # And not a sigma that covers anything: between one and two times the errors.
    used = rec.valid[INSIDE]
    rms, claimed = (
        np.sqrt(np.mean(image[INSIDE][used] ** 2)) for image in (rec.height_mm, rec.total_sigma_mm)
    )
    assert rms < claimed < 2.0 * rms


def test_projectors_that_disagree_widen_sigma() -> None:
    rec = by_cause(stack())
    second = np.indices(rec.reason.shape).sum(axis=0) % 5 == 0
    offset = np.where(second, 12.0 * rec.sigma_mm, 0.0).astype(np.float32)
    joined = across_projectors(replace(rec, height_mm=rec.height_mm + offset))
    error = np.abs(joined.height_mm)
    assert (error > 5.0 * joined.sigma_mm)[second].all()
    # Five sigma of noise on top of the offset: 1 pixel in 3 million.
    assert (error > 5.0 * joined.total_sigma_mm)[second].sum() == 0


def test_losses_are_counted_from_the_best_quarter_at_each_frequency() -> None:
    rng = np.random.default_rng(2)
    frequency = rng.uniform(0.05, 0.2, (120, 160)).astype(np.float32)
    lost = rng.uniform(0.0, 0.2, frequency.shape)
    visibility = (np.exp(-0.1 - 2.0 * frequency) * (1.0 - lost)).astype(np.float32)
    below = _below_best(visibility, frequency, np.ones(frequency.shape, bool))
    # A quarter loses less than 0.05. Of 16000 pixels, that quantile has a standard error of 0.2 sqrt(3/16 / 16000) = 0.0007,
    # and 0.0012 more at the ends of the frequencies, whose outermost 0.5 % are taken as the end.
    np.testing.assert_allclose(below, 1.0 - (1.0 - lost) / 0.95, atol=0.01)


def test_visibility_that_grows_with_frequency_is_compared_at_all_frequencies_alike() -> None:
    """No lens does that: the best quarter of all pixels is the measure."""
    rng = np.random.default_rng(2)
    frequency = rng.uniform(0.05, 0.2, (120, 160)).astype(np.float32)
    visibility = np.exp(-1.0 + 2.0 * frequency)
    below = _below_best(visibility, frequency, np.ones(frequency.shape, bool))
    expected = 1.0 - visibility / np.quantile(visibility, 0.75)
    # A quantile of 16000 pixels thinned out or not: as in the test above.
    np.testing.assert_allclose(below, expected, atol=0.01)


def test_one_period_is_judged_by_its_own_visibility() -> None:
    shown = PhaseShift(periods_px=(400.0,))
    dn = np.full(SIZE[::-1], 80.0)
    dn[PATCH] = 40.0
    flat = np.zeros(SIZE[::-1])
    made = calibrated_stack(rig(size=SIZE), flat, shown, sigma_dn=1.0, modulation=dn)
    rec = by_cause(made)
    assert (rec.reason[INSIDE] == decode.Reason.STRAY).mean() > 0.98


def test_causes_are_in_the_file_and_end_with_the_region(tmp_path: Path) -> None:
    made = stack(modulation=patch_loss(lambda period: 0.25 * 16.0 / period))
    rec = by_cause(made)
    rec.write(tmp_path / "rec.exr")
    back = decode.Reconstruction.read(tmp_path / "rec.exr")
    assert back.cause_sigma_mm.keys() == {"mixed", "stray", "blur"}
    assert np.array_equal(back.total_sigma_mm, rec.total_sigma_mm)
    part = decode.reconstruct(made, uncertainty="by-cause", roi=(10, 60, 20, 70))
    assert np.array_equal(part.total_sigma_mm[10:60, 20:70], rec.total_sigma_mm[10:60, 20:70])
    assert np.isnan(part.total_sigma_mm[:10]).all()


def test_phases_without_heights_refuse_uncertainty_by_cause() -> None:
    with pytest.raises(DecodeError, match=r"by-cause.*height is .phase."):
        decode.reconstruct(stack(), uncertainty="by-cause", height="phase")
