"""Acquisition plans: what they show, for how long, and that budgets are kept. No renderer: pictures are formulas."""

from collections.abc import Sequence

import numpy as np
import pytest

from evaluation.comparison import Comparison, Entry, Estimate, Region
from evaluation.strategies import (
    BUDGETS,
    LEVELS,
    Budget,
    Capture,
    Level,
    Reference,
    strategies,
)
from scenes.errors import ScoreError
from scenes.patterns import PhaseShift
from scenes.sensor import SimpleSensor
from scenes.stack import Stack

# 0.02 to 20 DN/ms beside each other
REFLECTANCE = np.geomspace(0.02, 20.0, 24).reshape(4, 6)
SENSOR = SimpleSensor(sigma_dn=0.1, bits=12)


def shoot(patterns: PhaseShift, times_ms: Sequence[float], level: Level = 1.0) -> Stack:
    """Fringes of full contrast at phase 0.3 on every pixel, without noise."""
    frames = np.stack(
        [
            [
                time_ms * REFLECTANCE * level * (1.0 + np.cos(0.3 + f.phase_shift_rad))
                for f in patterns.frames()
            ]
            for time_ms in times_ms
        ]
    )
    counts = np.clip(np.rint(frames), 0, SENSOR.full_scale_dn).astype(np.uint16)
    return Stack(counts, patterns.frames(), tuple(times_ms), SENSOR)


def reference(steps: int = 4, times: tuple[float, ...] = (1.0, 10.0, 80.0)) -> Reference:
    return Reference(PhaseShift(steps=steps, periods_px=(16.0, 128.0)), times)


def captured(name: str, ref: Reference, budget: Budget) -> Capture:
    (strategy,) = strategies([name])
    return strategy.plan(shoot, ref, budget)


NAMES = [strategy.name for strategy in strategies()]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "ref", [reference(), reference(3, (2.0, 5.0)), reference(6, (1.0, 2.0, 4.0, 8.0))]
)
def test_equal_time_is_equal_and_equal_frames_never_more(name: str, ref: Reference) -> None:
    for budget in BUDGETS:
        got = captured(name, ref, budget)
        assert got.frames >= got.stack.frames.shape[0] * got.stack.frames.shape[1]
        assert got.stack.exposure_ms == got.shot.times_ms
        if budget == "equal-time":
            assert got.exposure_ms == pytest.approx(ref.shot.light_ms(1), rel=1e-12)
        else:
            assert got.frames <= ref.shot.frames(1)


@pytest.mark.parametrize("name", ["single", "inverted", "complementary", "more-steps"])
def test_plans_of_one_exposure_never_expose_longer_than_it(name: str) -> None:
    """Lengthening it to fill the budget would add the very saturation that the plan is about."""
    for budget in BUDGETS:
        assert max(captured(name, reference(), budget).shot.times_ms) <= 10.0


def test_inverted_and_complementary_sets_are_what_their_papers_show() -> None:
    def degrees(name: str, ref: Reference) -> list[int]:
        shown = captured(name, ref, "equal-time").shot.patterns.frames()
        return [round(np.rad2deg(f.phase_shift_rad)) for f in shown if f.period_px == 16.0]

    assert degrees("inverted", reference()) == [0, 120, 240, 180, 300, 420]
    assert degrees("complementary", reference()) == [0, 90, 180, 270, 45, 135, 225, 315]
    assert degrees("complementary", reference(3)) == [0, 120, 240, 60, 180, 300]


def test_frames_that_whole_sets_would_leave_go_into_more_steps() -> None:
    """12 frames a period hold one set of 4 and its complement, and waste 4: two sets of 6 waste none."""
    assert captured("complementary", reference(), "equal-frames").frames == 24


def test_metering_takes_the_longest_exposure_that_clips_nothing() -> None:
    # the brightest pixel peaks at 40 DN/ms: 10 ms give 400, 80 ms 3200, 200 ms clip at 4095
    times = captured("auto-exposure", reference(times=(10.0, 80.0, 200.0)), "equal-frames").shot
    assert set(times.times_ms) == {80.0}


def test_adaptive_levels_bring_each_pixel_below_saturation_and_no_dimmer_than_a_level() -> None:
    got = captured("adaptive-projection", reference(times=(10.0, 80.0, 400.0)), "equal-frames")
    level = np.asarray(got.shot.level)
    peak = got.stack.frames.max(axis=(0, 1))
    assert (peak < SENSOR.saturation_dn).all()
    assert (level[0.8 * SENSOR.saturation_dn > REFLECTANCE * 2.0 * 400.0] == 1.0).all()
    dimmed = level < 1.0
    assert dimmed.any()
    # one level more would have crossed the headroom of 0.9
    wanted = 0.9 * SENSOR.saturation_dn / (REFLECTANCE * 2.0 * 400.0)
    assert (level[dimmed] > wanted[dimmed] * 0.98 - 1.0 / LEVELS).all()
    # the first look is paid for
    assert got.frames == got.stack.frames.shape[0] * got.stack.frames.shape[1] + 3


def test_unknown_strategy_is_refused_with_a_hint() -> None:
    with pytest.raises(ScoreError, match="did you mean 'max-modulation'"):
        strategies(["max-modulaton"])


def entry(name: str, rms: Sequence[float], coverage: float = 1.0) -> Entry:
    figures = {"coverage": Estimate(coverage, 0.0), "rms_mm": Estimate.of(rms)}
    region = Region(9, figures, None, None, None, None, tuple(rms))
    return Entry(name, "equal-time", "ladder", name, "", 1, 1.0, 0.0, {"base": region})


def test_a_difference_inside_the_interval_is_a_tie() -> None:
    rows = (
        entry("best", [1.0, 1.1, 0.9, 1.0]),
        entry("same-noise", [1.1, 1.2, 1.0, 1.1]),  # worse by 0.1 in every repeat: surely worse
        entry("other-noise", [1.3, 0.9, 1.2, 0.9]),  # worse by 0.075 +- 0.3
        entry("partial", [0.1, 0.1, 0.1, 0.1], coverage=0.5),  # small errors of the easy half
    )
    result = Comparison("s", 4, 0, 1, 0.1, 1, 1.0, rows, ())
    assert result.best("equal-time", "base") == ("best", "other-noise")
    told = result.to_dict()["strategies"]
    assert [s["regions"]["base"]["best_or_tied"] for s in told] == [True, False, True, False]


def test_one_repeat_establishes_nothing() -> None:
    result = Comparison("s", 1, 0, 1, 0.1, 1, 1.0, (entry("a", [1.0]), entry("b", [2.0])), ())
    assert result.best("equal-time", "base") == ("a", "b")
    assert result.to_dict()["strategies"][0]["regions"]["base"]["half_width"]["rms_mm"] is None
