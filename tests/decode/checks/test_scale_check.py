"""Periods that are wrong by a per cent where less than two turns of the coarser fringes are in view."""

from dataclasses import replace

import numpy as np
import pytest

from decode.checks.stack_check import check
from scenes.acquisition.patterns import GrayBits, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.finding import Finding


def taken(
    patterns: PhaseShift,
    span_px: float = 100.0,
    start_px: float = 60.0,
    coarse_gain: float = 0.0,
    gamma: float = 1.0,
) -> Stack:
    """A bump, seen by 200 x 100 pixels; step 1 of the coarsest fringes is brighter by `coarse_gain`."""
    y, x = np.mgrid[:100, :200] + 0.5
    at_px = start_px + span_px * (x / 200.0 + 0.05 * np.exp(-((x - 90) ** 2 + (y - 50) ** 2) / 900))
    coarsest = max(f.period_px for f in patterns.frames() if f.kind == "fringe")
    light = [
        160.0
        * patterns.commanded(f, at_px) ** gamma
        * (1.0 + coarse_gain * ((f.period_px, f.step) == (coarsest, 1)))
        for f in patterns.frames()
    ]
    noisy = (
        20.0 + np.array(light) + np.random.default_rng(3).normal(0.0, 0.7, (len(light), *x.shape))
    )
    sensor = SimpleSensor(sigma_dn=0.76, black_level_dn=20.0)
    return Stack(
        np.round(noisy).clip(0, 255).astype(np.uint8)[None],
        patterns.frames(),
        (1.0,),
        sensor,
        projector_resolution=(1024, 768),
    )


def stated(stack: Stack, period_px: float, factor: float) -> Stack:
    patterns = tuple(
        replace(f, period_px=factor * f.period_px)
        if f.kind == "fringe" and f.period_px == period_px
        else f
        for f in stack.patterns
    )
    return replace(stack, patterns=patterns)


def wrong_scales(stack: Stack) -> list[Finding]:
    return [f for f in check(stack).wrong if f.name.endswith("scale")]


@pytest.mark.parametrize("steps", [3, 4, 8])
@pytest.mark.parametrize("factor", [0.99, 1.01])
@pytest.mark.parametrize("period_px", [24.0, 1024.0])
def test_period_wrong_by_a_per_cent_is_detected_in_a_tenth_of_a_turn(
    steps: int, factor: float, period_px: float
) -> None:
    stack = taken(PhaseShift(steps=steps, periods_px=(24.0, 1024.0)))
    (found,) = wrong_scales(stated(stack, period_px, factor))
    named = {24.0: "24", 1024.0: "1024"}[period_px]
    # 20 000 pixels, whose coarse coordinates have 2 px of noise, fix a slope over 100 px to 5e-4.
    value = float(found.message.split(" instead of " + f"{period_px * factor:g}")[0].split()[-1])
    assert value == pytest.approx(float(named), rel=2e-3)


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize(
    ("coarse_gain", "gamma"), [(0.0, 1.0), (0.01, 1.0), (-0.02, 1.0), (0.0, 1.1), (0.0, 2.2)]
)
@pytest.mark.parametrize("start_px", [60.0, 400.0])
def test_gamma_and_flicker_of_the_coarse_fringes_are_no_wrong_period(
    steps: int, coarse_gain: float, gamma: float, start_px: float
) -> None:
    stack = taken(
        PhaseShift(steps=steps, periods_px=(24.0, 1024.0)), 100.0, start_px, coarse_gain, gamma
    )
    assert not wrong_scales(stack)


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_period_wrong_by_a_per_cent_is_detected_against_six_cells(factor: float) -> None:
    stack = taken(
        PhaseShift(steps=3, periods_px=(20.0,), gray=GrayBits(bits=7, cell_px=10.0)), 65.0
    )
    assert not wrong_scales(stack)
    assert wrong_scales(stated(stack, 20.0, factor))


@pytest.mark.parametrize("factor", [0.98, 0.99, 1.01, 1.02])
@pytest.mark.parametrize("span_px", [150.0, 300.0])
def test_period_is_compared_with_cells_of_its_own_width(span_px: float, factor: float) -> None:
    """The orders come from the cells, so they jump where the two differ by half a period."""
    stack = taken(
        PhaseShift(steps=4, periods_px=(16.0,), gray=GrayBits(bits=6, cell_px=16.0)), span_px
    )
    assert not wrong_scales(stack)
    assert check(stated(stack, 16.0, factor)).wrong


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize("degrees", [0.0, 4.5, -4.5])
def test_first_phase_of_less_than_a_turn_of_coarse_fringes_is_compared(
    steps: int, degrees: float
) -> None:
    """4.5 degrees of 1024 px are 13 px, a fifth of the finer fringes, so all orders agree."""
    stack = taken(PhaseShift(steps=steps, periods_px=(64.0, 1024.0)), 300.0)
    patterns = tuple(
        replace(f, phase_shift_rad=f.phase_shift_rad + np.deg2rad(degrees))
        if f.period_px == 1024.0
        else f
        for f in stack.patterns
    )
    found = check(replace(stack, patterns=patterns)).wrong
    assert bool(found) == (degrees != 0.0)


@pytest.mark.parametrize("origin_px", [0.0, 1.5, -3.0])
@pytest.mark.parametrize("cell_px", [10.0, 20.0])
def test_code_and_fringes_of_different_origins_are_wrong(origin_px: float, cell_px: float) -> None:
    """Less than a quarter of a period, so that half cells give every pixel the right order: but which origin is right?"""
    stack = taken(
        PhaseShift(periods_px=(20.0,), gray=GrayBits(bits=7, cell_px=cell_px)), span_px=300.0
    )
    patterns = tuple(
        replace(f, phase_shift_rad=f.phase_shift_rad - 2.0 * np.pi * origin_px / 20.0)
        if f.kind == "fringe"
        else f
        for f in stack.patterns
    )
    found = [f for f in check(replace(stack, patterns=patterns)).wrong if "place" in f.name]
    assert len(found) == (origin_px != 0.0)
    # 20 crossings or more at each of 15 edges, by pixels of 1.5 px: the mean of 300 uniform numbers is good to 0.03 px.
    if found:
        assert found[0].value == pytest.approx(abs(origin_px), abs=0.15)
