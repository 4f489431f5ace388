"""Acquisition plans: what they show, for how long, and that budgets are kept. No renderer: pictures are formulas."""

import json
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
from evaluation.hdr.capture_strategies import BUILT_IN, PlannedCapture, Strategy
from evaluation.hdr.coding_strategies import CODINGS
from evaluation.hdr.comparison import (
    MeanInterval,
    StrategyComparison,
    StrategyRegion,
    StrategyResult,
)
from evaluation.hdr.light_budget import BUDGETS, LightBudget, Reference, Shot
from evaluation.hdr.projector_plans import HEADROOM, LEVELS, _mask
from evaluation.hdr.strategy_lookup import strategies
from evaluation.theory.clipping import clipped_harmonic
from evaluation.theory.cramer_rao import efficiency
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError
from tests.decode.synthetic import calibrated_stack, rig

# 0.02 to 20 DN/ms beside each other
REFLECTANCE = np.geomspace(0.02, 20.0, 24).reshape(4, 6)
# A twelfth of the range is black: what is lost by forgetting it is more than a level.
SENSOR = SimpleSensor(sigma_dn=0.1, bits=12, black_level_dn=341.0)


def shoot(shot: Shot) -> Stack:
    """Fringes of full contrast at phase 0.3 on every pixel, without noise."""
    patterns, times_ms = shot.patterns, shot.times_ms
    levels = shot.levels or (1.0,) * len(times_ms)
    frames = np.stack(
        [
            [
                time_ms * REFLECTANCE * level * (1.0 + np.cos(0.3 + f.phase_shift_rad))
                for f in patterns.frames()
            ]
            for time_ms, level in zip(times_ms, levels, strict=True)
        ]
    )
    counts = np.clip(np.rint(SENSOR.black_level_dn + frames), 0, SENSOR.full_scale_dn).astype(
        np.uint16
    )
    return Stack(counts, patterns.frames(), times_ms, SENSOR)


def reference(steps: int = 4, times: tuple[float, ...] = (1.0, 10.0, 80.0)) -> Reference:
    return Reference(PhaseShift(steps=steps, periods_px=(16.0, 128.0)), times, overhead_ms=0.7)


def captured(name: str, ref: Reference, budget: LightBudget) -> PlannedCapture:
    (strategy,) = strategies([name])
    return strategy.plan(shoot, ref, budget)


NAMES = [*(strategy.name for strategy in BUILT_IN), "intensity-ladder"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "ref", [reference(), reference(3, (2.0, 5.0)), reference(6, (1.0, 2.0, 4.0, 8.0))]
)
def test_equal_times_are_equal_and_equal_frames_never_more(name: str, ref: Reference) -> None:
    for budget in BUDGETS:
        got = captured(name, ref, budget)
        assert got.frames >= got.stack.frames.shape[0] * got.stack.frames.shape[1]
        assert got.stack.exposure_ms == got.shot.times_ms
        assert got.cycle_ms == pytest.approx(got.exposure_ms + 0.7 * got.frames)
        if budget == "equal-time":
            assert got.exposure_ms == pytest.approx(ref.shot.light_ms(1), rel=1e-12)
        elif budget == "cycle-time":
            assert got.cycle_ms == pytest.approx(ref.cycle_ms(ref.shot), rel=1e-12)
        else:
            assert got.frames <= ref.shot.frames(1)


@pytest.mark.parametrize("share", [0.25, 2.0])
@pytest.mark.parametrize("name", ["max-modulation", "single", "complementary"])
def test_share_of_a_cycle_is_used_and_no_exposure_is_lengthened(name: str, share: float) -> None:
    ref = replace(reference(), share=share)
    got = captured(name, ref, "cycle-time")
    assert got.cycle_ms == pytest.approx(share * ref.cycle_ms(ref.shot), rel=1e-12)
    assert max(got.shot.times_ms) <= max(ref.times_ms) * (1.0 + 1e-9)


def test_overhead_turns_repeats_into_exposure_time() -> None:
    """One short exposure repeated to fill 728 ms of light takes many frames; where each costs 5 ms it takes few."""
    frames = [
        captured("single", replace(reference(), overhead_ms=ms), "cycle-time").frames
        for ms in (0.0, 5.0, 50.0)
    ]
    assert frames == sorted(frames, reverse=True)
    assert frames[0] > frames[2]


def test_strategy_that_does_not_fit_is_refused_with_what_it_needs() -> None:
    slow = replace(reference(), min_exposure_ms=5.0)
    with pytest.raises(ScoreError, match="at least 5 ms"):
        captured("max-modulation", slow, "equal-time")  # its shortest exposure is 1 ms
    with pytest.raises(ScoreError, match="do not fit"):
        captured("more-steps", replace(reference(), share=0.1), "equal-frames")


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("ratio", [1.25, 1.5])
def test_saturation_bias_of_two_sets_is_that_of_the_closed_form(steps: int, ratio: float) -> None:
    """One set, the mean of two maps and the joint fit of 2N steps, against the Fourier series of the clipped wave.

    N samples fold the harmonics 1 + qN onto the first: the phase errs by ``arg(1 + sum_q (c_(1+qN)/c_1) exp(j q N phi))``.
    Harmonics fall as 1/m^2, so those above 400 leave some 1e-4 rad; float32 leaves 1e-6.
    """
    phi = np.linspace(-np.pi, np.pi, 720, endpoint=False) + 1e-3

    def clipped(shot: Shot) -> Stack:
        shown = shot.patterns.frames()
        shifts = np.array([f.phase_shift_rad for f in shown])[:, None, None]
        wave = np.minimum(255.0 * ratio / 2.0 * (1.0 + np.cos(phi + shifts)), 255.0)
        frames = np.repeat(wave.astype(np.float32)[None], len(shot.times_ms), axis=0)
        return Stack(frames, shown, shot.times_ms, SENSOR)

    def error(at: NDArray[np.float64], n: int) -> NDArray[np.float64]:
        first, orders = clipped_harmonic(1, ratio), range(-400 // n, 400 // n + 1)
        folded = [
            clipped_harmonic(1 + q * n, ratio) / first * np.exp(1j * q * n * at)
            for q in orders
            if q
        ]
        return np.asarray(np.angle(1.0 + np.sum(folded, axis=0)))

    ref = Reference(PhaseShift(steps=steps, periods_px=(16.0,)), (1.0, 2.0))
    expected = {
        "single": error(phi, steps),
        "complementary": (error(phi, steps) + error(phi + np.pi / steps, steps)) / 2.0,
        "2n-step": error(phi, 2 * steps),
    }
    # Root mean squares, computed independently of this series.
    published = {
        (3, 1.5): (0.188, 0.0114, 0.0345),
        (3, 1.25): (0.0715, 0.0127, 0.0086),
        (4, 1.5): (0.0847, 0.0124, 0.0108),
    }
    for i, (name, theory) in enumerate(expected.items()):
        (strategy,) = strategies([name])
        stack = strategy.plan(clipped, ref, "equal-time").stack
        rec = decode.reconstruct(
            stack,
            fusion=strategy.fusion,
            saturation=strategy.saturation,
            height="phase",
            unwrap="row-scan",
        )
        found = rec.wrapped_rad[0].astype(np.float64)
        off = (found - phi + np.pi) % (2.0 * np.pi) - np.pi
        assert np.abs(off - theory).max() < 1e-3
        if (steps, ratio) in published:
            # Three digits of it.
            assert np.sqrt(np.mean(off**2)) == pytest.approx(
                published[steps, ratio][i], abs=1e-4 if i else 5e-4
            )


@pytest.mark.parametrize("name", ["single", "inverted", "complementary", "2n-step", "more-steps"])
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
    # Of nine frames two sets of four steps use eight, those of three only six.
    shot = captured("complementary", reference(3), "equal-frames").shot
    assert sum(f.period_px == 16.0 for f in shot.patterns.frames()) == 8


def test_leftover_frames_become_more_steps() -> None:
    """12 frames a period hold one set of 4 and its complement, and waste 4: two sets of 6 waste none."""
    assert captured("complementary", reference(), "equal-frames").frames == 24


def test_metering_takes_the_longest_exposure_that_clips_nothing() -> None:
    # the brightest pixel peaks at 40 DN/ms: 10 ms give 400, 80 ms 3200, 200 ms clip at 4095
    times = captured("auto-exposure", reference(times=(10.0, 80.0, 200.0)), "equal-frames").shot
    assert set(times.times_ms) == {80.0}


def test_intensities_have_one_exposure_and_need_the_choice_by_modulation() -> None:
    """`max-modulation` takes each pixel's brightest unclipped level in any order; exposure times, equal, do not show it. On a
    series of times both choose alike: modulation is proportional to time.
    """
    times = (10.0, 20.0, 8000.0)
    got = captured("intensity-ladder", reference(times=times), "equal-frames")
    assert len(set(got.shot.times_ms)) == 1
    assert got.shot.levels == pytest.approx([1 / 800, 800**-0.5, 1.0])

    def chosen(stack: Stack) -> list[NDArray[np.uint8]]:
        rules = ("max-modulation", "brightest-unsaturated")
        recs = [
            decode.reconstruct(stack, fusion=r, height="phase", unwrap="row-scan") for r in rules
        ]
        return [rec.exposure for rec in recs]

    brightest = 2 - np.argmax((got.stack.frames.max(axis=1) < SENSOR.saturation_dn)[::-1], axis=0)
    assert set(np.unique(brightest)) == {0, 1, 2}
    by_modulation, by_time = chosen(replace(got.stack, frames=got.stack.frames[::-1].copy()))
    assert (2 - by_modulation == brightest).all()
    assert (2 - by_time != brightest).any()
    one, two = chosen(captured("max-modulation", reference(times=times), "equal-frames").stack)
    assert (one == two).all()


def test_projectors_of_one_scene_are_not_compared() -> None:
    for name in ("one-projector", "every-projector"):
        with pytest.raises(ScoreError, match="one projector"):
            captured(name, reference(), "equal-time")


def test_one_projector_alone_costs_as_much_as_all() -> None:
    ref = replace(reference(), projectors=4)
    for budget in BUDGETS:
        one, every = (captured(name, ref, budget) for name in ("one-projector", "every-projector"))
        assert one.shot.projectors == 1
        assert ref.cost(budget, one.shot) == pytest.approx(ref.cost(budget, every.shot))


@pytest.mark.parametrize("strategy", CODINGS, ids=lambda s: s.name)
def test_coding_is_shown_at_the_references_exposures(strategy: Strategy) -> None:
    """Repeated, shortened by one factor, and as fine as the reference: every code numbers 1024 px."""
    ref = reference()
    got = strategy.plan(shoot, ref, "equal-time")
    assert got.exposure_ms == pytest.approx(ref.shot.light_ms(1), rel=1e-12)
    times = got.shot.times_ms
    assert np.divide(times[1:3], times[0]) == pytest.approx([10.0, 80.0])
    frames = got.shot.patterns.frames()
    fine = min(f.carrier_px or f.period_px for f in frames if f.kind not in ("gray", "xor"))
    assert 14.0 <= fine <= 16.0
    # Gupta & Nayar: two frames more than frequencies, of which there are five; Moreno et al.: three, two and two shifts.
    known = {"heterodyne": 3 * 4, "micro-phase-shift": 5 + 2, "embedded-phase-shift": 3 + 2 + 2}
    assert len(frames) == known.get(strategy.name, len(frames))


def test_unknown_strategy_is_refused_with_a_hint() -> None:
    with pytest.raises(ScoreError, match="did you mean 'max-modulation'"):
        strategies(["max-modulaton"])


@pytest.mark.parametrize("exposure_ms", [4.0, 7.3, 60.0])
def test_mask_is_the_brightest_that_keeps_its_pixels_below_saturation(exposure_ms: float) -> None:
    """Of whole levels, and never dark; projector pixels that no camera pixel sees stay white."""
    made = calibrated_stack(
        rig(), np.zeros((48, 64)), PhaseShift(periods_px=(16.0, 80.0)), offset=50.0, modulation=40.0
    )
    sensor = SimpleSensor(bits=8)
    counts = np.clip(made.frames * [[[[1.0]]], [[[2.0]]]], 0, 255).astype(np.uint8)
    mask = _mask(
        replace(made, frames=counts, exposure_ms=(1.0, 2.0), sensor=sensor), 0, exposure_ms
    )
    brightest, most = counts[1].max() * exposure_ms / 2.0, HEADROOM * sensor.saturation_dn
    level = mask.min()
    assert level * brightest <= most or level == 1.0 / LEVELS
    assert (level + 1.0 / LEVELS) * brightest > most
    assert mask.max() == 1.0


def entry(
    name: str, rms: Sequence[float], coverage: float = 1.0, cycle_ms: float = 1.0
) -> StrategyResult:
    figures = {"coverage": MeanInterval(coverage, 0.0), "rms_mm": MeanInterval.of(rms)}
    region = StrategyRegion(9, figures, None, None, None, None, tuple(rms))
    return StrategyResult(
        name, "equal-time", "ladder", name, "", 1, 1.0, cycle_ms, 0.0, {"base": region}
    )


LIMITS = {"equal-time": 1.0, "equal-frames": 1.0, "cycle-time": 1.0}


def test_difference_within_the_interval_is_a_tie() -> None:
    rows = (
        entry("best", [1.0, 1.1, 0.9, 1.0]),
        entry("same-noise", [1.1, 1.2, 1.0, 1.1]),  # worse by 0.1 in every repeat: surely worse
        entry("other-noise", [1.3, 0.9, 1.2, 0.9]),  # worse by 0.075 +- 0.3
        entry("partial", [0.1, 0.1, 0.1, 0.1], coverage=0.5),  # small errors of the easy half
    )
    result = StrategyComparison("s", 4, 0, 1, 0.1, LIMITS, rows, ())
    assert result.best("equal-time", "base") == ("best", "other-noise")
    listed = result.to_dict()["strategies"]
    assert [s["regions"]["base"]["best_or_tied"] for s in listed] == [True, False, True, False]


def test_interval_of_two_repeats_is_that_of_the_cauchy_distribution() -> None:
    """Student's t of one degree of freedom, whose quantiles are tangents; half the difference is the standard error of the mean."""
    found = MeanInterval.of([3.0, 7.0])
    assert found.value == 5.0
    assert found.half_width == pytest.approx(2.0 * np.tan(np.pi * 0.95 / 2.0))


def test_one_repeat_establishes_nothing() -> None:
    result = StrategyComparison(
        "s", 1, 0, 1, 0.1, LIMITS, (entry("a", [1.0]), entry("b", [2.0])), ()
    )
    assert result.best("equal-time", "base") == ("a", "b")
    assert result.to_dict()["strategies"][0]["regions"]["base"]["half_width"]["rms_mm"] is None


def test_comparison_is_json_where_a_region_has_one_pixel_or_no_scatter() -> None:
    """One pixel's scatter over pixels is unknown, and the bound over a variance of 0 infinite: neither is a number of JSON."""
    one_pixel = efficiency(np.array([[0.1], [-0.1]]), np.array([0.01]))
    no_scatter = efficiency(np.full((2, 3), 0.1), np.full(3, 0.01))
    assert one_pixel is not None
    found = [MeanInterval.of_efficiency(e) for e in (one_pixel, no_scatter, None)]
    assert found == [MeanInterval(one_pixel.value, None), None, None]
    rows = [entry(name, [1.0]) for name in "ab"]
    rows = [
        replace(e, regions={"base": replace(e.regions["base"], efficiency=reached)})
        for e, reached in zip(rows, found[:2], strict=True)
    ]
    result = StrategyComparison("s", 2, 0, 1, 0.1, LIMITS, tuple(rows), ())
    json.dumps(result.to_dict(), allow_nan=False)


def test_front_leaves_out_what_a_shorter_cycle_beats() -> None:
    rows = (
        entry("short", [3.0, 3.0], cycle_ms=1.0),
        entry("worse", [4.0, 4.0], cycle_ms=2.0),
        entry("long", [2.0, 2.0], cycle_ms=3.0),
        entry("half", [0.1, 0.1], coverage=0.5, cycle_ms=1.0),
    )
    result = StrategyComparison("s", 2, 0, 1, 0.1, LIMITS, (), (), pareto=rows)
    assert [e.name for e in result.front("base")] == ["short", "long"]
    marked = {p["name"]: p["regions"]["base"]["on_front"] for p in result.to_dict()["pareto"]}
    assert marked == {"short": True, "worse": False, "long": True, "half": False}
