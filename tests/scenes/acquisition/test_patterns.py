"""Patterns, their basis, and the projector's tone response."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.acquisition.pattern_basis import basis
from scenes.acquisition.patterns import (
    GrayBits,
    GrayCode,
    ModulatedPhaseShift,
    Patterns,
    PatternSeries,
    PhaseShift,
    UnevenSteps,
)
from scenes.files.capture_frames import LineShift
from scenes.support.errors import SceneError
from tests.scenes.acquisition import emitted

COLUMNS, ROWS = 96, 64


projector = partial(emitted.projector, COLUMNS, ROWS)


@given(
    st.integers(3, 12),
    st.sampled_from([(8.0,), (8.0, 48.0), (7.5, 31.0, 96.0)]),
    st.sampled_from([("column",), ("row",), ("column", "row")]),
    st.floats(0.1, 1.0),
    st.floats(0.1, 1.0),
)
def test_basis_makes_every_frame_that_is_emitted(
    steps: int, periods: tuple[float, ...], axes: tuple[str, ...], contrast: float, amplitude: float
) -> None:
    patterns = PhaseShift(steps=steps, periods_px=periods, axes=axes, amplitude=amplitude)
    light = projector(contrast=contrast)
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, COLUMNS, 50), rng.uniform(0, ROWS, 50)
    expected = [
        light.emit(patterns.commanded(f, u if f.axis == "column" else v)) for f in patterns.frames()
    ]
    made = basis(patterns, light, light.resolution)
    np.testing.assert_allclose(emitted.emitted(made, u, v), expected, atol=1e-12)
    assert len(made.channels) == 1 + 2 * len(periods) * len(axes)


def test_black_frames_of_a_gray_code_are_emitted_at_the_black_level() -> None:
    patterns = GrayCode(axes=("column", "row"), bits=(6, 5), cell_px=2.0, flat=True)
    light = projector(contrast=0.5)
    u, v = np.arange(0.3, COLUMNS)[:ROWS], np.arange(0.9, ROWS)
    frames = patterns.frames()
    made = emitted.emitted(basis(patterns, light, light.resolution), u, v)
    # Michelson contrast 1/2: black is a third of white.
    for frame, light_of_frame in zip(frames, made, strict=True):
        pixel = np.floor(u if frame.axis == "column" else v) + 0.5
        np.testing.assert_allclose(light_of_frame, (1 + 2 * patterns.commanded(frame, pixel)) / 3)
    assert {frame.kind for frame in frames} == {"gray", "white", "black"}


@pytest.mark.parametrize(
    "patterns",
    [
        UnevenSteps(periods_px=(14.57, 16.09, 16.24), steps=(3, 1, 1), amplitude=0.8),
        ModulatedPhaseShift(periods_px=(128.0, 1024.0), axes=("row",), amplitude=0.7),
        PhaseShift(periods_px=(16.0,), gray=GrayBits(bits=8, cell_px=4.0, xor=True)),
        PatternSeries(
            parts=(PhaseShift(periods_px=(16.0, 128.0)), ModulatedPhaseShift(periods_px=(128.0,)))
        ),
    ],
    ids=["uneven", "modulated", "xor", "series"],
)
def test_basis_makes_every_frame_of_a_coding(patterns: Patterns) -> None:
    """At pixel centres, where tables are exact too."""
    light = projector()
    at = np.arange(0.5, min(COLUMNS, ROWS))
    made = emitted.emitted(basis(patterns, light, light.resolution), at, at)
    expected = [light.emit(patterns.commanded(f, at)) for f in patterns.frames()]
    np.testing.assert_allclose(made, expected, atol=1e-12)


@pytest.mark.parametrize(
    "make",
    [
        lambda axes: PhaseShift(periods_px=(16.0,), axes=axes),
        lambda axes: GrayCode(bits=(4, 4), axes=axes),
        lambda axes: UnevenSteps(periods_px=(14.57, 16.09), steps=(3, 2), axes=axes),
        lambda axes: ModulatedPhaseShift(periods_px=(128.0,), axes=axes),
    ],
    ids=["phase-shift", "gray", "uneven", "modulated"],
)
def test_axis_named_twice_is_refused(make: Callable[[tuple[str, ...]], Patterns]) -> None:
    make(("column", "row"))
    with pytest.raises(ValueError, match="name each axis once"):
        make(("column", "column"))


@pytest.mark.parametrize("emission", [{"gamma": 2.2}, {"bits": 8}, {"bits": 5, "gamma": 1.8}])
def test_gamma_and_quantisation_are_emitted_as_projector_pixels(emission: dict[str, float]) -> None:
    patterns = PhaseShift(steps=4, periods_px=(8.0, 48.0), axes=("column", "row"))
    light = projector(**emission)
    made = basis(patterns, light, light.resolution)
    u, v = np.arange(0.3, COLUMNS)[:ROWS], np.arange(0.9, ROWS)
    expected = [
        light.emit(patterns.commanded(f, np.floor(u if f.axis == "column" else v) + 0.5))
        for f in patterns.frames()
    ]
    # The decomposition drops directions 1e-7 of the strongest, whose tables are of the order of 1.
    np.testing.assert_allclose(emitted.emitted(made, u, v), expected, atol=1e-6)
    assert len(made.channels) <= len(expected)


@given(st.floats(0.05, 1.0))
def test_contrast_is_michelson_contrast_of_full_amplitude_fringes(contrast: float) -> None:
    light = projector(contrast=contrast)
    white, black = light.emit(np.array(1.0)), light.emit(np.array(0.0))
    assert (white - black) / (white + black) == pytest.approx(contrast)


@pytest.mark.parametrize("direction", [1, -1])
def test_shifted_lines_light_every_place_once(direction: Literal[1, -1]) -> None:
    shift = LineShift(axis="row", period_px=20.0, steps=8, direction=direction, origin_px=3.0)
    at_px = np.random.default_rng(0).uniform(0.0, 500.0, 2000)
    lit = np.array([frame.commanded(at_px) for frame in shift.frames()])
    np.testing.assert_array_equal(lit.sum(axis=0), 1.0)
    # The line of the first frame begins at the origin and is an eighth of 20 px wide; the next is beside it.
    np.testing.assert_array_equal(lit[0] == 1.0, (at_px - 3.0) % 20.0 < 2.5)
    np.testing.assert_array_equal(lit[1] == 1.0, (at_px - 3.0 - 2.5 * direction) % 20.0 < 2.5)


def test_four_steps_give_the_chapters_arctangent() -> None:
    patterns = PhaseShift(steps=4, periods_px=(16.0,))
    u = np.linspace(0, 16, 33)[:-1]
    i0, i1, i2, i3 = (patterns.commanded(f, u) for f in patterns.frames())
    expected = np.angle(np.exp(2j * np.pi * u / 16))
    np.testing.assert_allclose(
        np.exp(1j * np.arctan2(i3 - i1, i0 - i2)), np.exp(1j * expected), atol=1e-12
    )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"period_px": 0.0}, "period_px is 0"),
        ({"period_px": float("nan")}, "period_px is nan"),
        ({"phase_shift_rad": float("nan")}, "give a finite number"),
        ({"phase_shift_rad": float("inf")}, "give a finite number"),
        ({"step": 4}, "step 4 of 4"),
        ({"step": -1}, "step -1 of 4"),
        ({"projector": -1}, "projector -1"),
    ],
)
def test_impossible_frame_is_refused(change: dict[str, Any], says: str) -> None:
    frame = PhaseShift(periods_px=(16.0,)).frames()[1]
    with pytest.raises(SceneError, match=says):
        replace(frame, **change)
