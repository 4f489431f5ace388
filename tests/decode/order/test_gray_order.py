"""Gray code, alone and under fringes, on stacks whose projector coordinates are known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import decode
from decode import Reason
from decode.device import Device
from decode.order.gray_cells import cells_of, gray_sets
from scenes.acquisition.patterns import GrayBits, GrayCode, PhaseShift
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from tests.decode.synthetic import Map, coordinates, digitise, hills, rig

SIZE = (64, 48)
CALIBRATION = rig("pinhole", "pinhole", lenses=True)
HEIGHT = hills()
COLUMN, ROW = coordinates(CALIBRATION, HEIGHT)


def take(
    patterns: PhaseShift | GrayCode,
    *,
    gain: float | Map = 160.0,
    dark: float = 30.0,
    sigma_dn: float = 0.0,
    blur_px: float = 0.0,
    box_px: float = 0.0,
    exposures: tuple[float, ...] = (1.0,),
    calibrated: bool = True,
    seed: int = 0,
) -> Stack:
    """8-bit frames of the rig under any patterns, seen through a projector that blurs."""
    rng = np.random.default_rng(seed)
    shown = patterns.frames()
    taps: Any = np.linspace(-2.0, 2.0, 41) * blur_px if blur_px else np.zeros(1)
    weights: Any = np.exp(-0.5 * (taps / max(blur_px, 1e-9)) ** 2)
    if box_px:
        taps = (np.arange(60) + 0.5) / 60.0 * box_px - box_px / 2.0
        weights = np.ones(60, np.float64)
    light = np.stack(
        [
            sum(
                w * patterns.commanded(f, (COLUMN if f.axis == "column" else ROW) + tap)
                for w, tap in zip(weights / weights.sum(), taps, strict=True)
            )
            for f in shown
        ]
    )
    frames = [digitise(dark + gain * t * light, sigma_dn, np.uint8, rng) for t in exposures]
    return Stack(
        np.stack(frames),
        shown,
        exposures,
        SimpleSensor(sigma_dn=sigma_dn),
        CALIBRATION if calibrated else None,
    )


@pytest.mark.parametrize("inverted", [True, False])
@pytest.mark.parametrize("flat", [True, False])
def test_gray_code_gives_the_cell_at_any_reflectance(inverted: bool, flat: bool) -> None:
    albedo = np.random.default_rng(1).uniform(0.2, 1.0, HEIGHT.shape)
    patterns = GrayCode(
        axes=("column", "row"), bits=(8, 8), cell_px=2.0, inverted=inverted, flat=flat
    )
    rec = decode.reconstruct(take(patterns, gain=160.0 * albedo), height="phase")
    assert rec.valid.all()
    np.testing.assert_array_equal(
        np.floor(rec.phases["column"].coordinate_px / 2.0), np.floor(COLUMN / 2.0)
    )
    np.testing.assert_array_equal(
        np.floor(rec.phases["row"].coordinate_px / 2.0), np.floor(ROW / 2.0)
    )
    # The middle of the cell, so never off by more than half of it.
    assert np.abs(rec.phases["column"].coordinate_px - COLUMN).max() <= 1.0


def test_fringes_give_the_threshold_where_the_code_has_none() -> None:
    patterns = PhaseShift(
        steps=4, periods_px=(16.0,), gray=GrayBits(bits=6, inverted=False, flat=False)
    )
    albedo = np.random.default_rng(1).uniform(0.2, 1.0, HEIGHT.shape)
    rec = decode.reconstruct(take(patterns, gain=160.0 * albedo), height="phase")
    assert rec.valid.all()
    # A code all of whose bits are dark in a pixel has no threshold of its own: order errors would be 16 px.
    assert np.abs(rec.phases["column"].coordinate_px - COLUMN).max() < 1.0


def test_height_and_its_sigma_from_gray_code_alone_are_those_of_a_cell() -> None:
    patterns = GrayCode(bits=(9,))
    rec = decode.reconstruct(take(patterns, sigma_dn=2.0), height_range_mm=(-2.0, 5.0))
    error = (rec.height_mm - HEIGHT)[rec.valid]
    assert rec.valid.mean() > 0.99
    # Uniform in the cell: no error beyond sqrt(3) sigma, but where noise moved an edge by one cell (a pixel in 160 at
    # this noise: sigma / slope at the edge), and the RMS is sigma within the 3072 pixels' scatter.
    ratio = error / rec.sigma_mm[rec.valid]
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.05)


def test_one_clipped_exposure_of_two_does_not_disturb_the_code() -> None:
    patterns = GrayCode(bits=(8,), cell_px=2.0)
    stack = take(patterns, gain=200.0, sigma_dn=1.0, exposures=(1.0, 6.0))
    assert (stack.frames[1] == 255).mean() > 0.3
    rec = decode.reconstruct(stack, height="phase")
    assert rec.valid.mean() > 0.99
    np.testing.assert_array_equal(
        np.floor(rec.phases["column"].coordinate_px / 2.0)[rec.valid],
        np.floor(COLUMN / 2.0)[rec.valid],
    )


def test_pixel_across_an_edge_is_at_that_edge() -> None:
    """It sees both cells, which differ in one bit: that is unsure, and the others say which edge it is."""
    patterns = GrayCode(bits=(6,), cell_px=4.0)
    edges = 4.0 * np.arange(1.0, 64.0)[None]
    light = [
        sum(patterns.commanded(f, edges + side) for side in (-1.0, 1.0)) for f in patterns.frames()
    ]
    frames = np.round(30.0 + 80.0 * np.array(light)).astype(np.uint8)[None]
    sensor = SimpleSensor(sigma_dn=1.0)
    stack = Stack(frames, patterns.frames(), (1.0,), sensor, projector_resolution=(256, 192))
    rec = decode.reconstruct(stack, height="phase")
    assert rec.valid.all()
    np.testing.assert_allclose(rec.phases["column"].coordinate_px, edges)


def test_bits_lost_to_blur_widen_the_cell_and_the_claimed_sigma() -> None:
    sharp = take(GrayCode(bits=(9,)), sigma_dn=2.0)
    blurred = take(GrayCode(bits=(9,)), sigma_dn=2.0, blur_px=2.0)
    wide: Any = {"height_range_mm": (-5.0, 10.0)}
    one, two = decode.reconstruct(sharp, **wide), decode.reconstruct(blurred, **wide)
    both = one.valid & two.valid
    assert both.mean() > 0.5
    assert np.median(two.sigma_mm[both]) > 1.9 * np.median(one.sigma_mm[both])
    ratio = ((two.height_mm - HEIGHT) / two.sigma_mm)[two.valid]
    # Uniform in the wider cell; half of a cell more at edges that blur hides.
    assert np.sqrt(np.mean(ratio**2)) < 1.2


@pytest.mark.parametrize("box_px", [2.75, 5.5, 6.0, 7.0])
def test_pixel_wider_than_the_stripes_has_a_wider_cell(box_px: float) -> None:
    """A box of one and a half periods turns the sign of the finest bits, with a third of the contrast and no noise."""
    rec = decode.reconstruct(take(GrayCode(bits=(9,)), sigma_dn=0.5, box_px=box_px), height="phase")
    # Three fine bits may be lost: cells of 8 px, whose middle is within 4 px; and a cell's width for one unsure bit more.
    assert np.abs(rec.phases["column"].coordinate_px - COLUMN)[rec.valid].max() < 8.0
    high = decode.reconstruct(
        take(GrayCode(bits=(9,)), sigma_dn=0.5, box_px=box_px), height_range_mm=(-5.0, 10.0)
    )
    ratio = ((high.height_mm - HEIGHT) / high.sigma_mm)[high.valid]
    assert high.valid.mean() > 0.5
    assert np.sqrt(np.mean(ratio**2)) < 1.2
    # A uniform error in the cell claimed never exceeds sqrt(3) sigma.
    assert (np.abs(ratio) > 3.0).mean() < 0.01


def test_unlit_pixels_are_rejected_as_shadow_or_dark() -> None:
    lit = np.ones(HEIGHT.shape)
    lit[:10] = 0.0
    rec = decode.reconstruct(take(GrayCode(bits=(9,)), gain=160.0 * lit, sigma_dn=2.0))
    assert np.isin(rec.reason[:10], (Reason.SHADOW, Reason.DARK)).all()


def shifted_code(stack: Stack, patterns: PhaseShift, by_px: float) -> Stack:
    """The same capture with Gray frames seen `by_px` aside, as a slanted or unevenly lit edge is."""
    frames = stack.frames.copy()
    for i, f in enumerate(stack.patterns):
        if f.kind == "gray":
            level = 30.0 + 160.0 * patterns.commanded(f, COLUMN + by_px)
            frames[:, i] = np.round(level)
    return replace(stack, frames=frames)


@pytest.mark.parametrize("by_px", [-3.5, 3.5])
def test_complementary_bit_forgives_a_code_a_fifth_of_a_period_off(by_px: float) -> None:
    patterns = PhaseShift(steps=4, periods_px=(16.0,), gray=GrayBits(bits=6))
    stack = shifted_code(take(patterns), patterns, by_px)
    # 8-bit rounding: sigma 0.29 DN on 80 DN of modulation, 0.01 px; ten of them, and no period.
    rec = decode.reconstruct(stack, height="phase", max_order_residual=0.5)
    assert np.abs(rec.phases["column"].coordinate_px - COLUMN).max() < 0.1
    # Without it, as many pixels lose a whole period as are that near a border.
    plain = PhaseShift(steps=4, periods_px=(16.0,), gray=GrayBits(bits=5, cell_px=16.0))
    rec = decode.reconstruct(shifted_code(take(plain), plain, by_px), height="phase")
    slipped = np.abs(rec.phases["column"].coordinate_px - COLUMN) > 8.0
    assert slipped.mean() == pytest.approx(3.5 / 16.0, abs=0.05)


def test_gray_code_orders_two_close_fringes() -> None:
    """Three-step fringes of 2/3 and 1 cell and a Gray code of that cell: the beat of the fringes is two cells."""
    patterns = PhaseShift(
        steps=3,
        periods_px=(16.0, 24.0),
        axes=("column", "row"),
        gray=GrayBits(bits=5, cell_px=24.0),
    )
    rec = decode.reconstruct(take(patterns, sigma_dn=2.0), height="phase")
    assert rec.valid.mean() > 0.999
    sigma_px = 16.0 / (2 * np.pi) * 2.0 * np.sqrt(2.0 / 3.0) / 80.0
    for found, true in (
        (rec.phases["column"].coordinate_px, COLUMN),
        (rec.phases["row"].coordinate_px, ROW),
    ):
        error = (found - true)[rec.valid]
        assert np.abs(error).max() < 6.0 * sigma_px
        assert error.std() == pytest.approx(sigma_px, rel=0.05)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: f if f.step != 3 else replace(f, step=2), "each bit once"),
        (lambda f: replace(f, steps=10), "lacks bits"),
        (lambda f: replace(f, period_px=3.0) if f.step == 1 else f, "each bit once"),
    ],
)
def test_incomplete_code_is_refused(change: object, said: str) -> None:
    stack = take(GrayCode(bits=(9,)))
    patterns = tuple(change(f) if f.kind == "gray" else f for f in stack.patterns)  # type: ignore[operator]
    with pytest.raises(DecodeError, match=said):
        decode.reconstruct(replace(stack, patterns=patterns))


def test_one_bit_of_one_frame_is_a_code() -> None:
    code = gray_sets(GrayCode(bits=(1,), inverted=False).frames(), 0)["column"]
    assert (code.direct, code.inverse, code.white, code.black) == ((0,), (None,), 1, 2)


def test_unwrapping_a_code_is_refused() -> None:
    with pytest.raises(DecodeError, match="Gray code alone"):
        decode.reconstruct(take(GrayCode(bits=(9,))), unwrap="row-scan")


@pytest.mark.parametrize("exposures", [(1.0,), (1.0, 0.5)])
def test_claimed_variance_of_a_bit_is_that_of_many_pixels(exposures: tuple[float, ...]) -> None:
    """Half of bright minus dark, summed over exposures, scatters by the noise of two samples of each."""
    code = GrayCode(bits=(3,), flat=False)
    frames = code.frames()
    sensor = Emva(bits=0, full_well_e=10_000.0, gain_dn_per_e=0.1, black_level_dn=64.0)
    rng = np.random.default_rng(3)
    light = np.array([code.commanded(f, np.array(0.5)) for f in frames]).reshape(-1)
    # The first bit is the strongest by far in every pixel, so that the largest of noisy contrasts is always its own.
    light = np.where([f.step == 0 for f in frames], 500.0 * light, 100.0 * light) + 20.0
    exact = sensor.black_level_dn + np.multiply.outer(exposures, light)
    constant, slope = sensor.noise_model(1.0)
    noise_dn = np.sqrt(constant + slope * (exact - sensor.black_level_dn))
    scatter = rng.standard_normal((*exact.shape, 100, 400))
    seen = exact[..., None, None] + noise_dn[..., None, None] * scatter
    stack = Stack(seen.astype(np.float32), frames, exposures, sensor)
    device = Device.open("llvm")
    cell = cells_of(
        device,
        gray_sets(frames, 0)["column"],
        stack,
        lambda image: device.types.Float(np.ascontiguousarray(image).ravel()),
    )
    contrast = np.array(cell.contrast)
    claimed = float(np.mean(np.array(cell.contrast_variance) * contrast**2))
    # The contrast is of the first exposure, the strongest; the variance is of the sum that decides a bit.
    one, other = (seen[:, i].sum(axis=0) for i, frame in enumerate(frames) if frame.step == 0)
    actual = float(np.var(0.5 * (one - other)))
    # 40 000 pixels know a variance to 0.7 %.
    assert claimed == pytest.approx(actual, rel=0.03)
