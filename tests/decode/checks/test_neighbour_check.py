"""Order errors that code and phase agree on: seen by their neighbours, and along epipolar lines."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import decode
from decode.checks.neighbour_check import jumps
from decode.reconstruction import AxisPhase
from scenes.acquisition.patterns import Frame, GrayBits, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt
from scenes.support.finding import Finding
from tests.decode.synthetic import Map, coordinates, hills, rig

SIZE = (400, 300)
# A cell as wide as the period: code and phase agree whatever the code's place.
CELL_IS_PERIOD = PhaseShift(periods_px=(16.0,), gray=GrayBits(bits=5, cell_px=16.0))
HALF_CELLS = PhaseShift(periods_px=(16.0,), gray=GrayBits(bits=6, cell_px=8.0))


def level_rig(axis: str = "column") -> Calibration:
    """The projector is straight to the camera's right, so that epipolar lines are rows; or above it, and they are columns."""
    made = rig("pinhole", "pinhole", size=SIZE)
    origin_mm = (35.0, 0.0, 50.0) if axis == "column" else (0.0, 35.0, 50.0)
    projector = made.projectors[0].model_copy(update={"pose": LookAt(origin_mm=origin_mm)})
    return made.model_copy(update={"projectors": (projector,)})


def coded(patterns: PhaseShift, shift_px: float, height_mm: Map, calibration: Calibration) -> Stack:
    """Noisy 8-bit frames whose Gray code is shifted against the fringes."""
    at = dict(zip(("column", "row"), coordinates(calibration, height_mm), strict=True))
    shown = patterns.frames()
    light = np.stack(
        [patterns.commanded(f, at[f.axis] + (shift_px if f.kind == "gray" else 0.0)) for f in shown]
    )
    noise = np.random.default_rng(5).normal(0.0, 1.0, light.shape)
    counts = np.clip(np.round(20.0 + 160.0 * light + noise), 0, 255).astype(np.uint8)
    sensor = SimpleSensor(sigma_dn=1.0, black_level_dn=20.0)
    return Stack(counts[None], shown, (1.0,), sensor, calibration)


def finding(stack: Stack, name: str) -> Finding:
    return next(f for f in decode.check(stack).findings if f.name.endswith(name))


@pytest.mark.parametrize("shift_px", [1.0, 4.0, 8.0])
@pytest.mark.parametrize("calibrated", [True, False])
def test_code_shifted_against_the_fringes_is_wrong(shift_px: float, calibrated: bool) -> None:
    stack = coded(CELL_IS_PERIOD, shift_px, hills(SIZE), level_rig())
    if not calibrated:
        stack = replace(stack, calibration=None, projector_resolution=(400, 400))
    found = finding(stack, "columns, neighbours")
    assert found.verdict == "wrong"
    assert "code is shifted" in found.message


@pytest.mark.parametrize(
    "change",
    [
        lambda f: replace(f, phase_shift_rad=-f.phase_shift_rad),
        # Jumps at two phases, 120 degrees apart: neither they nor twice them add up.
        lambda f: replace(f, phase_shift_rad=f.phase_shift_rad + 2.0 * np.pi / 3.0),
    ],
    ids=["direction", "first phase"],
)
def test_fringes_that_contradict_a_code_of_their_own_width_are_wrong(
    change: Callable[[Frame], Frame],
) -> None:
    stack = coded(CELL_IS_PERIOD, 0.0, hills(SIZE), level_rig())
    stated = tuple(change(f) if f.kind == "fringe" else f for f in stack.patterns)
    plain = replace(stack, calibration=None, projector_resolution=(400, 400), patterns=stated)
    assert finding(plain, "columns, neighbours").verdict == "wrong"


def test_smooth_surface_that_sees_both_ends_of_the_projector_is_wrong() -> None:
    """25 of 400 px's 24, 25 and 28 fringes half a period off fit coordinates that are 200 px off, modulo 400."""
    shown = PhaseShift(periods_px=(400 / 28, 400 / 25, 400 / 24))
    stack = coded(shown, 0.0, hills(SIZE), level_rig())
    stack = replace(stack, calibration=None, projector_resolution=(400, 400))
    assert finding(stack, "columns, neighbours").verdict == "ok"
    stated = tuple(
        replace(f, phase_shift_rad=f.phase_shift_rad + np.pi) if f.period_px == 16.0 else f
        for f in stack.patterns
    )
    found = finding(replace(stack, patterns=stated), "columns, neighbours")
    assert found.verdict == "wrong"
    assert "first and last" in found.message
    # Of pairs along rows and columns, nearly all of which are smooth.
    pairs = 2 * SIZE[0] * SIZE[1]
    assert found.value == pytest.approx(int(found.message.split()[0]) / pairs, rel=0.2)


@pytest.mark.parametrize("patterns", [CELL_IS_PERIOD, HALF_CELLS])
def test_aligned_code_passes(patterns: PhaseShift) -> None:
    report = decode.check(coded(patterns, 0.0, hills(SIZE), level_rig()))
    names = [f.name for f in report.findings]
    assert any("neighbours" in n for n in names) and any("epipolar order" in n for n in names)
    assert all(f.verdict in ("ok", "unknown") for f in report.findings)


def test_parts_whose_height_is_one_period_pass() -> None:
    # All edges of the parts jump by one period, but at any phase.
    calibration = level_rig()
    plane = coordinates(calibration, np.zeros(SIZE[::-1]))[0]
    top = coordinates(calibration, np.ones(SIZE[::-1]))[0]
    one_period_mm = 16.0 / float(np.median(np.abs(top - plane)))
    height = np.zeros(SIZE[::-1])
    rng = np.random.default_rng(2)
    for row in range(20, 280, 40):
        for column in range(20, 380, 45):
            right = column + int(rng.integers(12, 25))
            height[row : row + 20, column:right] = one_period_mm
    assert finding(coded(HALF_CELLS, 0.0, height, calibration), "neighbours").verdict == "ok"


@pytest.mark.parametrize("axis", ["column", "row"])
def test_coordinates_out_of_order_along_epipolar_lines_are_detected(axis: str) -> None:
    patterns, calibration = CELL_IS_PERIOD.model_copy(update={"axes": (axis,)}), level_rig(axis)
    aligned = finding(coded(patterns, 0.0, hills(SIZE), calibration), "epipolar order")
    assert aligned.verdict == "ok"
    shifted = finding(coded(patterns, 8.0, hills(SIZE), calibration), "epipolar order")
    # A code half a period off lowers half of the pixels by a period, below the half before them.
    assert shifted.verdict == "wrong"
    assert shifted.value is not None and shifted.value > 0.3


@pytest.mark.parametrize("right_mm", [35.0, -35.0])
def test_wires_in_front_of_the_board_are_in_order(right_mm: float) -> None:
    """Six wires of 4 px and 2.9 mm: each puts some 30 px behind it out of order, half of the board, but itself is small."""
    made = level_rig()
    pose = LookAt(origin_mm=(right_mm, 0.0, 50.0))
    projector = made.projectors[0].model_copy(update={"pose": pose})
    calibration = made.model_copy(update={"projectors": (projector,)})
    height = np.zeros(SIZE[::-1])
    for column in range(30, 380, 60):
        height[:, column : column + 4] = 2.9
    found = finding(coded(HALF_CELLS, 0.0, height, calibration), "epipolar order")
    assert found.verdict == "ok"
    # Six times 4 of 400 px, or less.
    assert found.value is not None and 0.0 < found.value <= 24 / 400


@pytest.mark.parametrize(("period_px", "verdict"), [(80, "wrong"), (300, "warning"), (700, "ok")])
def test_rare_jumps_are_in_doubt_and_frequent_ones_wrong(period_px: int, verdict: str) -> None:
    """A stripe of a wrong order in each fringe: two jumps along rows and none along columns, one in `period_px` pairs."""
    column = np.tile(np.arange(8400), (100, 1))
    order, place = np.divmod(column, period_px)
    order += (place >= period_px // 2) & (place < period_px // 2 + 8)
    wrapped = ((place / period_px + 0.5) % 1.0 - 0.5) * 2.0 * np.pi
    order += wrapped < 0.0
    phase = AxisPhase(float(period_px), wrapped.astype(np.float32), order.astype(np.int32))
    found = jumps(phase, np.ones(column.shape, np.bool_), None, "columns")
    assert found.verdict == verdict
    # Next to a jump are eight pairs that are not smooth, a tenth of the shortest period.
    assert found.value == pytest.approx(1.0 / period_px, rel=0.15)
