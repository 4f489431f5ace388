"""What `decode.check` says of right and of wrong captures."""

from dataclasses import replace

import numpy as np
import pytest

from decode.check import check
from scenes.patterns import GrayBits, GrayCode, PhaseShift
from scenes.sensor import SimpleSensor
from scenes.stack import Stack
from tests.decode.synthetic import coordinates, hills, rig
from tests.decode.test_gray import take

LARGE = (200, 150)
CALIBRATION = rig("pinhole", "pinhole", lenses=True, size=LARGE)
BOTH = {"axes": ("column", "row")}
FOUR = PhaseShift(steps=4, periods_px=(16.0, 128.0), **BOTH)
THREE = PhaseShift(steps=3, periods_px=(16.0, 24.0), gray=GrayBits(bits=5, cell_px=24.0), **BOTH)
CODE = GrayCode(bits=(9, 9), **BOTH)


def large(patterns: PhaseShift | GrayCode, exposures: tuple[float, ...] = (1.0,)) -> Stack:
    """Noisy 8-bit frames of a smooth surface, 200 x 150."""
    rng = np.random.default_rng(5)
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
def test_a_right_capture_passes(patterns: PhaseShift | GrayCode) -> None:
    report = check(large(patterns))
    assert not report.wrong
    assert not [f for f in report.findings if f.verdict == "warning"]
    report.raise_if_wrong()


def test_every_exchange_of_two_steps_of_four_is_seen() -> None:
    stack = large(FOUR)
    for i in range(4):
        for j in range(i):
            assert check(exchanged(stack, i, j)).wrong, (i, j)


def test_the_exchange_that_mends_the_order_is_named() -> None:
    wrong = check(exchanged(large(FOUR), 1, 2)).wrong
    # 0 3 makes the reverse order of it, which is a sinusoid too
    assert any("exchanging steps 0 and 3 or 1 and 2 mends it" in f.message for f in wrong)


def test_every_exchange_of_three_step_frames_and_gray_frames_is_seen() -> None:
    stack = large(THREE)
    # three steps in any order fit a sinusoid, but the other period and the code disagree
    # frame 6 + 2 b is bit b of the columns; bit 0 is dark in the whole field of view
    for i, j in [(0, 1), (1, 2), (0, 2), (3, 5), (0, 3), (8, 10), (9, 13), (6, 7), (10, 11)]:
        assert check(exchanged(stack, i, j)).wrong, (i, j)


# The two finest bits are no coarser than the camera's pixels: exchanging them moves a point by three cells at most.
@pytest.mark.parametrize("bits", [(1, 2), (2, 5), (5, 6)])
def test_exchanged_frames_of_a_gray_code_are_seen(bits: tuple[int, int]) -> None:
    stack = large(CODE)
    one, two = (2 * bit for bit in bits)
    assert check(exchanged(stack, one, two)).wrong
    # both frames of both bits: each pair fits, their order does not
    assert check(exchanged(exchanged(stack, one, two), one + 1, two + 1)).wrong


@pytest.mark.parametrize("bit", [0, 3, 5])
def test_an_inverse_in_place_of_its_frame_is_seen(bit: int) -> None:
    assert check(exchanged(large(CODE), 2 * bit, 2 * bit + 1)).wrong


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.5])
@pytest.mark.parametrize("patterns", [FOUR, THREE])
def test_a_wrong_period_is_seen(patterns: PhaseShift, factor: float) -> None:
    stack = large(patterns)
    told = tuple(
        replace(f, period_px=f.period_px * factor) if f.period_px == 16.0 else f
        for f in stack.patterns
    )
    assert check(replace(stack, patterns=told)).wrong


def test_the_wrong_direction_of_shift_is_seen() -> None:
    stack = large(THREE)
    told = tuple(replace(f, phase_shift_rad=-f.phase_shift_rad) for f in stack.patterns)
    assert any("agreement" in f.name for f in check(replace(stack, patterns=told)).wrong)


def test_another_rigs_calibration_is_seen() -> None:
    stack = large(FOUR)
    light = CALIBRATION.projectors[0]
    assert light.model == "pinhole"
    other = light.model_copy(update={"cy_px": light.cy_px + 40.0})
    report = check(
        replace(stack, calibration=CALIBRATION.model_copy(update={"projectors": (other,)}))
    )
    assert any(f.name == "calibration" for f in report.wrong)


def test_exposure_times_in_the_wrong_order_are_seen() -> None:
    stack = large(FOUR, exposures=(0.5, 1.0))
    assert not check(stack).wrong
    back = replace(stack, exposure_ms=(1.0, 0.5))
    assert any("exposures" in f.name for f in check(back).wrong)


def test_saturation_and_gamma_are_warned_of_not_refused() -> None:
    patterns = PhaseShift(steps=4, periods_px=(16.0, 128.0))
    report = check(take(patterns, gain=300.0))
    assert next(f for f in report.findings if f.name == "saturation").verdict == "warning"
    stack = large(FOUR)
    top = (stack.frames.astype(float) - 20.0).clip(0) / 160.0
    bent = np.round(20.0 + 160.0 * top**2.0).clip(0, 255).astype(np.uint8)
    report = check(replace(stack, frames=bent))
    seen = [f for f in report.findings if f.name.endswith("px, gamma")]
    assert seen[0].verdict == "warning"
    # squared light is gamma 2, seen through the noise of 1 DN, which squaring bends too
    fine = [f.value for f in seen if " 16 px" in f.name]
    assert fine[0] == pytest.approx(2.0, abs=0.02)


def test_what_cannot_be_told_is_said_to_be_unknown() -> None:
    report = check(take(PhaseShift(steps=3, periods_px=(16.0,)), calibrated=True))
    assert {f.name for f in report.findings if f.verdict == "unknown"} >= {
        "column fringes of 16 px, order",
        "columns, agreement",
    }
