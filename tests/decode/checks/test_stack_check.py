"""What `decode.check` says of right and of wrong captures."""

import re
from dataclasses import replace

import numpy as np
import pytest

import decode
from decode.checks.stack_check import check
from scenes.acquisition.patterns import GrayBits, GrayCode, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from tests.decode.order.test_gray_order import take
from tests.decode.synthetic import coordinates, hills, rig

LARGE = (200, 150)
CALIBRATION = rig("pinhole", "pinhole", lenses=True, size=LARGE)
BOTH = {"axes": ("column", "row")}
FOUR = PhaseShift(steps=4, periods_px=(16.0, 128.0), **BOTH)
THREE = PhaseShift(steps=3, periods_px=(16.0, 24.0), gray=GrayBits(bits=5, cell_px=24.0), **BOTH)
CODE = GrayCode(bits=(9, 9), **BOTH)


def large(
    patterns: PhaseShift | GrayCode, exposures: tuple[float, ...] = (1.0,), seed: int = 5
) -> Stack:
    """Noisy 8-bit frames of a smooth surface, 200 x 150."""
    rng = np.random.default_rng(seed)
    height = hills(LARGE)
    columns, rows = coordinates(CALIBRATION, height)
    shown = patterns.frames()
    light = np.stack(
        [patterns.commanded(f, columns if f.axis == "column" else rows) for f in shown]
    )
    counts = [
        np.clip(np.round(20 + 160 * t * light + rng.normal(0, 1, light.shape)), 0, 255)
        for t in exposures
    ]
    return Stack(
        np.stack(counts).astype(np.uint8),
        shown,
        exposures,
        SimpleSensor(sigma_dn=1.0, black_level_dn=20.0),
        CALIBRATION,
    )


def exchanged(stack: Stack, i: int, j: int) -> Stack:
    frames = stack.frames.copy()
    frames[:, [i, j]] = frames[:, [j, i]]
    return replace(stack, frames=frames)


@pytest.mark.parametrize("patterns", [FOUR, THREE, CODE])
def test_correct_capture_passes(patterns: PhaseShift | GrayCode) -> None:
    report = check(large(patterns))
    assert not report.wrong
    assert not [f for f in report.findings if f.verdict == "warning"]
    report.raise_if_wrong()


@pytest.mark.slow
def test_every_exchange_of_two_steps_of_four_is_detected() -> None:
    stack = large(FOUR)
    for i in range(4):
        for j in range(i):
            assert check(exchanged(stack, i, j)).wrong, (i, j)


def test_exchange_that_restores_the_order_is_named() -> None:
    wrong = check(exchanged(large(FOUR), 1, 2)).wrong
    # 0 3 makes the reverse order of it, which is a sinusoid too.
    assert any("exchanging steps 0 and 3 or 1 and 2 removes it" in f.message for f in wrong)


@pytest.mark.slow
def test_every_exchange_of_three_step_frames_and_gray_frames_is_detected() -> None:
    stack = large(THREE)
    # Three steps in any order fit a sinusoid, but the other period and the code disagree
    # frame 6 + 2 b is bit b of the columns; bit 0 is dark in the whole field of view.
    for i, j in [(0, 1), (1, 2), (0, 2), (3, 5), (0, 3), (8, 10), (9, 13), (6, 7), (10, 11)]:
        assert check(exchanged(stack, i, j)).wrong, (i, j)


# The two finest bits are no coarser than the camera's pixels: exchanging them moves a point by three cells at most.
@pytest.mark.parametrize("bits", [(1, 2), (2, 5), (5, 6)])
def test_exchanged_frames_of_a_gray_code_are_detected(bits: tuple[int, int]) -> None:
    stack = large(CODE)
    one, two = (2 * bit for bit in bits)
    assert check(exchanged(stack, one, two)).wrong
    # Both frames of both bits: each pair fits, their order does not.
    assert check(exchanged(exchanged(stack, one, two), one + 1, two + 1)).wrong


@pytest.mark.parametrize("swapped", [False, True])
def test_codes_order_is_valued_by_its_roughness_over_the_smoothest_others(swapped: bool) -> None:
    stack = exchanged(exchanged(large(CODE), 4, 10), 5, 11) if swapped else large(CODE)
    found = {f.name: f for f in check(stack).findings}["column Gray code, order"]
    # Wrong where another order is smoother by a fifth.
    assert found.verdict == ("wrong" if swapped else "ok")
    assert found.value is not None and (found.value > 1 / 0.8) == swapped


@pytest.mark.parametrize("bit", [4, 6])
@pytest.mark.parametrize("flat", [-1, -2])
def test_white_or_black_in_place_of_a_bit_is_detected(flat: int, bit: int) -> None:
    stack = large(GrayCode(bits=(9,), inverted=False, flat=True))
    found = {f.name: f.verdict for f in check(stack).findings}
    assert found["white and black"] == "ok"
    frames = len(stack.patterns)
    found = {f.name: f.verdict for f in check(exchanged(stack, bit, frames + flat)).findings}
    assert found["white and black"] == "wrong"


@pytest.mark.parametrize(("period_px", "verdict"), [(16.0, "ok"), (16.4, "wrong")])
def test_fringes_shown_again_must_have_the_phase_of_the_first(
    period_px: float, verdict: str
) -> None:
    once = large(PhaseShift(steps=3, periods_px=(16.0,)), seed=0)
    again = large(PhaseShift(steps=3, periods_px=(period_px,)), seed=1)
    frames = np.concatenate([once.frames, again.frames], axis=1)
    stack = replace(once, frames=frames, patterns=once.patterns * 2)
    found = {f.name: f for f in check(stack).findings}["column fringes of 16 px, repeat"]
    assert found.verdict == verdict
    # Two phases of equal noise differ by a normal number of sqrt(2) sigma; the median of its size is 0.67 of that.
    if verdict == "ok":
        assert found.value == pytest.approx(0.674 * 2**0.5, rel=0.1)


@pytest.mark.parametrize("bit", [0, 3, 5])
def test_inverse_in_place_of_its_frame_is_detected(bit: int) -> None:
    assert check(exchanged(large(CODE), 2 * bit, 2 * bit + 1)).wrong


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.5])
@pytest.mark.parametrize("patterns", [FOUR, THREE])
def test_wrong_period_is_detected(patterns: PhaseShift, factor: float) -> None:
    stack = large(patterns)
    stated = tuple(
        replace(f, period_px=f.period_px * factor) if f.period_px == 16.0 else f
        for f in stack.patterns
    )
    assert check(replace(stack, patterns=stated)).wrong


@pytest.mark.parametrize("which", [0, 1])
def test_period_wrong_by_half_a_per_cent_is_detected_and_named(which: int) -> None:
    stack = large(PhaseShift(steps=4, periods_px=(16.0, 64.0)))
    period = (16.0, 64.0)[which]
    patterns = tuple(
        replace(f, period_px=1.005 * period) if f.period_px == period else f for f in stack.patterns
    )
    scale = [f for f in check(replace(stack, patterns=patterns)).wrong if f.name.endswith("scale")]
    fitting = re.findall(r"[\d.]+(?= instead of)", scale[0].message)
    # 30 000 pixels of 0.06 px noise over 150 px fix a slope to 1e-5.
    assert float(fitting[which]) == pytest.approx(period, rel=1e-4)


def test_wrong_direction_of_shift_is_detected() -> None:
    stack = large(THREE)
    stated = tuple(replace(f, phase_shift_rad=-f.phase_shift_rad) for f in stack.patterns)
    assert any("agreement" in f.name for f in check(replace(stack, patterns=stated)).wrong)


def test_another_rigs_calibration_is_detected() -> None:
    stack = large(FOUR)
    light = CALIBRATION.projectors[0]
    assert light.model == "pinhole"
    other = light.model_copy(update={"cy_px": light.cy_px + 40.0})
    report = check(
        replace(stack, calibration=CALIBRATION.model_copy(update={"projectors": (other,)}))
    )
    wrong = [f for f in report.wrong if f.name == "calibration"]
    assert "is not this rig's" in wrong[0].message
    (right,) = (f for f in check(stack).findings if f.name == "calibration")
    assert (right.verdict, "is not this rig's" in right.message) == ("ok", False)


@pytest.mark.parametrize(("top_mm", "verdict"), [(0.9, "wrong"), (1.1, "ok")])
def test_points_outside_the_volume_are_counted(top_mm: float, verdict: str) -> None:
    """More than half of them: the calibration is another rig's."""
    unique = large(PhaseShift(steps=4, periods_px=(16.0, 80.0, 400.0)))
    volume = CALIBRATION.model_copy(update={"height_range_mm": (-0.5, top_mm)})
    stack = replace(unique, calibration=volume)
    (found,) = (f for f in check(stack).findings if f.name == "calibration")
    assert found.verdict == verdict
    shares = decode.reconstruct(stack).reason_fractions()
    outside = shares["out-of-volume"]
    assert found.value == pytest.approx(outside / (outside + shares["ok"]))
    # The volume has a margin, below the hills' top.
    assert 0.5 * (hills(LARGE) > top_mm).mean() < outside < (hills(LARGE) > top_mm).mean()


def test_exposure_times_in_the_wrong_order_are_detected() -> None:
    stack = large(FOUR, exposures=(0.5, 1.0))
    assert not check(stack).wrong
    back = replace(stack, exposure_ms=(1.0, 0.5))
    assert any("exposures" in f.name for f in check(back).wrong)


def test_saturated_and_dark_pixels_do_not_count_in_the_check_of_exposure_times() -> None:
    once = large(FOUR)
    light = (once.frames[0] - 20.0) * np.linspace(0.02, 1.0, LARGE[0])
    frames = np.stack([np.clip(np.round(20.0 + t * light), 0, 255) for t in (1.0, 2.0)])
    found = check(replace(once, frames=frames.astype(np.uint8), exposure_ms=(1.0, 2.0)))
    (exposures,) = (f for f in found.findings if f.name.startswith("exposures"))
    # Rounding moves a ratio of some 40 and 80 DN by a hundredth, their median by less.
    assert exposures.value == pytest.approx(0.0, abs=0.005)


def test_saturation_and_gamma_are_warned_of_not_refused() -> None:
    patterns = PhaseShift(steps=4, periods_px=(16.0, 128.0))
    report = check(take(patterns, gain=300.0))
    assert next(f for f in report.findings if f.name == "saturation").verdict == "warning"
    stack = large(FOUR)
    top = (stack.frames.astype(float) - 20.0).clip(0) / 160.0
    bent = np.round(20.0 + 160.0 * top**2.0).clip(0, 255).astype(np.uint8)
    # What a stack states is compared with what is seen.
    for stated, verdict in ((None, "warning"), (2.0, "ok"), (1.85, "warning"), (2.15, "warning")):
        report = check(replace(stack, frames=bent, gamma=stated))
        seen = [f for f in report.findings if f.name.endswith("px, gamma")]
        fine = next(f for f in seen if " 16 px" in f.name)
        assert (seen[0].verdict, fine.verdict) == (verdict, verdict)
        # Squared light is gamma 2, seen through the noise of 1 DN, which squaring bends too.
        assert fine.value == pytest.approx(2.0, abs=0.02)


def test_checks_of_a_single_period_are_unknown() -> None:
    report = check(take(PhaseShift(steps=3, periods_px=(16.0,)), calibrated=True))
    assert {f.name for f in report.findings if f.verdict == "unknown"} >= {
        "column fringes of 16 px, order",
        "columns, agreement",
    }


def test_gray_code_shorter_than_the_projector_is_wrong_and_not_decoded() -> None:
    short = large(GrayCode(bits=(8, 8), **BOTH))
    found = [f for f in check(short).wrong if "uniqueness" in f.name]
    # 8 bits of 1 px number 256 of the projector's 400 px.
    assert len(found) == 2
    assert all("set cell_px = 2" in f.message for f in found)
    with pytest.raises(DecodeError, match="numbers 256 px, the projector has 400"):
        decode.reconstruct(short)
    assert decode.reconstruct(short, anchor="gray").valid.any()


@pytest.mark.parametrize(
    ("bits", "cell_px", "said"),
    [
        ((9,), 0.9, "neither a whole number"),
        ((9,), 1.5, "neither a whole number"),
        ((9,), 2.0, "set cell_px = 1 if"),
        ((10,), 1.0, "bits = 9"),
        # Half of the code's range is enough for neither side; 512 parts of 400 px; one number of bits for both sides.
        ((9,), 1.0, ""),
        ((9,), 400 / 512, ""),
        ((8,), 3.0, ""),
    ],
)
def test_width_of_a_code_alone_must_be_one_that_a_projector_shows(
    bits: tuple[int, ...], cell_px: float, said: str
) -> None:
    at_px = np.broadcast_to(np.linspace(60.0, 180.0, 240), (20, 240))
    shown = GrayCode(bits=bits, cell_px=cell_px)
    light = np.stack([shown.commanded(f, at_px) for f in shown.frames()])
    counts = (20.0 + 160.0 * light).astype(np.uint8)[None]
    sensor = SimpleSensor(sigma_dn=1.0)
    stack = Stack(counts, shown.frames(), (1.0,), sensor, projector_resolution=(400, 300))
    found = [f.message for f in check(stack).wrong]
    assert len(found) == bool(said)
    assert said in " ".join(found)


def test_gray_code_without_a_known_projector_is_decoded() -> None:
    assert decode.reconstruct(
        replace(large(GrayCode(bits=(8, 8), **BOTH)), calibration=None), height="phase"
    ).valid.any()


@pytest.mark.parametrize(("code", "verdict"), [(399, "ok"), (400, "wrong")])
def test_codes_are_the_projectors_up_to_its_last_pixel(code: int, verdict: str) -> None:
    shown = GrayCode(bits=(9,)).frames()
    light = [GrayCode(bits=(9,)).commanded(f, np.full((20, 30), code + 0.5)) for f in shown]
    counts = np.stack(light)[None] * 100 + 20
    sensor = SimpleSensor(sigma_dn=1.0)
    stack = Stack(counts.astype(np.uint8), shown, (1.0,), sensor, projector_resolution=(400, 300))
    found = {finding.name: finding.verdict for finding in check(stack).findings}
    assert next(found[name] for name in found if name.endswith(", range")) == verdict


@pytest.mark.parametrize(("width", "verdict"), [(400, "ok"), (300, "wrong")])
def test_coordinates_of_fringes_are_the_projectors(width: int, verdict: str) -> None:
    """400 px of fringes in view, of which a projector of 300 would not have a quarter."""
    shown = PhaseShift(steps=4, periods_px=(20.0, 100.0, 500.0)).frames()
    at_px = np.broadcast_to(np.linspace(0.5, 399.5, 500), (60, 500))
    noise = np.random.default_rng(0).normal(0.0, 1.0, (len(shown), *at_px.shape))
    light = np.stack([f.commanded(at_px) for f in shown])
    counts = np.round(30.0 + 180.0 * light + noise).astype(np.uint8)
    sensor = SimpleSensor(sigma_dn=1.0)
    stack = Stack(counts[None], shown, (1.0,), sensor, projector_resolution=(width, 200))
    found = {f.name: f.verdict for f in check(stack).findings}
    assert found["columns, range"] == verdict
