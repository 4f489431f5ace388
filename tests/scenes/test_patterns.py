"""Patterns, their basis, and the projector's tone response."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenes.basis import Basis, basis
from scenes.emission import TelecentricProjector
from scenes.errors import SceneError
from scenes.patterns import PhaseShift
from scenes.rig import LookAt

COLUMNS, ROWS = 96, 64


def projector(**emission: float) -> TelecentricProjector:
    return TelecentricProjector(
        resolution=(COLUMNS, ROWS),
        pose=LookAt(origin_mm=(-1, 0, 2)),
        field_width_mm=10.0,
        **emission,
    )


def shown(made: Basis, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Frames (frame, point) that a basis makes at continuous projector coordinates."""
    rows = []
    for channel in made.channels:
        along = u if channel.axis == "column" else v
        if channel.kind == "one":
            rows.append(np.ones_like(u))
        elif channel.kind == "table":
            rows.append(np.asarray(channel.values)[along.astype(int)])
        else:
            wave = np.cos if channel.kind == "cos" else np.sin
            rows.append(wave(2 * np.pi * along / channel.period_px))
    return made.weights @ np.stack(rows)


@given(
    st.integers(3, 12),
    st.sampled_from([(8.0,), (8.0, 48.0), (7.5, 31.0, 96.0)]),
    st.sampled_from([("column",), ("row",), ("column", "row")]),
    st.floats(0.1, 1.0),
    st.floats(0.1, 1.0),
)
def test_the_basis_makes_every_frame_that_is_emitted(
    steps: int,
    periods: tuple[float, ...],
    axes: tuple[str, ...],
    contrast: float,
    amplitude: float,
) -> None:
    patterns = PhaseShift(steps=steps, periods_px=periods, axes=axes, amplitude=amplitude)
    light = projector(contrast=contrast)
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, COLUMNS, 50), rng.uniform(0, ROWS, 50)
    expected = [
        light.emit(patterns.commanded(f, u if f.axis == "column" else v)) for f in patterns.frames()
    ]
    made = basis(patterns, light, light.resolution)
    np.testing.assert_allclose(shown(made, u, v), expected, atol=1e-12)
    assert len(made.channels) == 1 + 2 * len(periods) * len(axes)


@pytest.mark.parametrize("emission", [{"gamma": 2.2}, {"bits": 8}, {"bits": 5, "gamma": 1.8}])
def test_gamma_and_quantisation_reach_the_scene_as_projector_pixels(
    emission: dict[str, float],
) -> None:
    patterns = PhaseShift(steps=4, periods_px=(8.0, 48.0), axes=("column", "row"))
    light = projector(**emission)
    made = basis(patterns, light, light.resolution)
    u, v = np.arange(0.3, COLUMNS)[:ROWS], np.arange(0.9, ROWS)
    expected = [
        light.emit(patterns.commanded(f, np.floor(u if f.axis == "column" else v) + 0.5))
        for f in patterns.frames()
    ]
    # The decomposition drops directions 1e-7 of the strongest, whose tables are of the order of 1.
    np.testing.assert_allclose(shown(made, u, v), expected, atol=1e-6)
    assert len(made.channels) <= len(expected)


@given(st.floats(0.05, 1.0))
def test_contrast_is_michelsons_of_full_amplitude_fringes(contrast: float) -> None:
    light = projector(contrast=contrast)
    white, black = light.emit(np.array(1.0)), light.emit(np.array(0.0))
    assert (white - black) / (white + black) == pytest.approx(contrast)


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
def test_a_frame_that_nothing_shows_is_refused(change: dict[str, float], says: str) -> None:
    frame = PhaseShift(periods_px=(16.0,)).frames()[1]
    with pytest.raises(SceneError, match=says):
        replace(frame, **change)
