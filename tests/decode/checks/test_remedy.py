"""The change of a manifest that makes its fringes agree, for planted mistakes."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from decode.checks.stack_check import check
from scenes.acquisition.patterns import Frame, GrayBits, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack

PERIODS = (16.0, 120.0, 1024.0)


def taken(
    steps: int, periods_px: tuple[float, ...] = PERIODS, gray: GrayBits | None = None
) -> Stack:
    patterns = PhaseShift(steps=steps, periods_px=periods_px, gray=gray)
    y, x = np.mgrid[:90, :200] + 0.5
    column = 3.0 * x + 20.0 + 20.0 * np.exp(-((x - 90.0) ** 2 + (y - 45.0) ** 2) / 900.0)
    light = np.stack([patterns.commanded(f, column) for f in patterns.frames()])
    noisy = 20.0 + 180.0 * light + np.random.default_rng(0).normal(0.0, 1.0, light.shape)
    return Stack(
        np.round(noisy).astype(np.uint8)[None],
        patterns.frames(),
        (1.0,),
        SimpleSensor(sigma_dn=1.0),
        projector_resolution=(1024, 768),
    )


def stated(stack: Stack, change: Callable[[Frame], float], period_px: float | None) -> Stack:
    """The stack with other phase shifts stated for one period, or for all."""
    patterns = tuple(
        replace(f, phase_shift_rad=change(f)) if period_px in (None, f.period_px) else f
        for f in stack.patterns
    )
    return replace(stack, patterns=patterns)


@pytest.mark.parametrize("steps", [3, 4])
@pytest.mark.parametrize(
    ("change", "period_px", "said"),
    [
        (lambda f: f.phase_shift_rad + np.pi, 16.0, "first_phase_deg = 0 (180 more than now) of the column fringes of 16 px"),
        (lambda f: f.phase_shift_rad + np.pi / 2, 120.0, "first_phase_deg = 0 (270 more than now) of the column fringes of 120 px"),
        (lambda f: f.phase_shift_rad + np.pi, None, "first_phase_deg = 0 (180 more than now) of all column fringes"),
        (lambda f: -f.phase_shift_rad, 16.0, "direction = -1 instead of 1, or the reverse, of the column fringes of 16 px"),
    ],
    ids=["180", "90 of a coarser set", "180 of all", "direction"],
)  # fmt: skip
def test_message_names_the_value_that_fits(
    steps: int, change: Callable[[Frame], float], period_px: float | None, said: str
) -> None:
    wrong = stated(taken(steps), change, period_px)
    messages = [f.message for f in check(wrong).findings if f.name == "columns, agreement"]
    assert said in messages[0]


def test_fringes_of_one_period_are_named_by_it_once() -> None:
    stack = taken(4, (16.0,), GrayBits(bits=8, cell_px=4.0))
    wrong = stated(stack, lambda f: f.phase_shift_rad + np.pi, 16.0)
    (message,) = [f.message for f in check(wrong).findings if f.name == "columns, agreement"]
    assert (
        message.count("180 more than now") == message.count("of the column fringes of 16 px") == 1
    )


def stated_period(stack: Stack, period_px: float, other_px: float) -> Stack:
    patterns = tuple(
        replace(f, period_px=other_px) if f.period_px == period_px else f for f in stack.patterns
    )
    return replace(stack, patterns=patterns)


@pytest.mark.parametrize("factor", [0.97, 0.99, 1.01, 1.04])
def test_right_period_is_named_from_orders_that_disagree(factor: float) -> None:
    """One turn of the coarse fringes is in view: their phase cannot show the scale, and one pixel in ten disagrees."""
    stack = stated_period(taken(4, (24.0, 1024.0)), 24.0, 24.0 * factor)
    found = check(stack).wrong
    (message,) = [f.message for f in found if f.name == "columns, agreement"]
    named = re.search(r"period_px = ([\d.]+) instead of", message)
    # The grid of 0.05 %.
    assert named and float(named[1]) == pytest.approx(24.0, rel=1e-3)


def test_exchanged_frames_of_three_steps_are_named() -> None:
    stack = taken(3)
    frames = stack.frames.copy()
    first = next(k for k, f in enumerate(stack.patterns) if f.period_px == 16.0)
    frames[:, [first, first + 1]] = frames[:, [first + 1, first]]
    found = [
        f.message
        for f in check(replace(stack, frames=frames)).findings
        if f.name == "columns, agreement"
    ]
    # Exchanging two of three steps is the other direction with another first phase.
    assert "exchanging steps 0 and 1 of the column fringes of 16 px" in found[0]
