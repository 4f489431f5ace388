"""Gray code and unequal steps as patterns: what is commanded, and that a basis of tables makes it."""

from dataclasses import replace

import numpy as np
import pytest

from scenes.acquisition.pattern_basis import basis
from scenes.acquisition.patterns import GrayBits, GrayCode, PhaseShift
from tests.scenes.acquisition.emitted import emitted, projector

RESOLUTION = (96, 40)


@pytest.mark.parametrize("cell_px", [1.0, 5.0])
def test_gray_code_of_neighbours_differs_in_one_bit_and_decodes_to_its_cell(cell_px: float) -> None:
    patterns = GrayCode(bits=(7,), cell_px=cell_px, inverted=False, flat=False)
    cells = np.arange(96.0)
    bits = np.stack([f.commanded((cells + 0.5) * cell_px) for f in patterns.frames()])
    assert (np.abs(np.diff(bits, axis=1)).sum(axis=0) == 1).all()
    binary = np.cumsum(bits, axis=0) % 2
    assert ((binary * 2.0 ** np.arange(6, -1, -1)[:, None]).sum(axis=0) == cells).all()


def test_phase_of_a_gray_code_moves_its_cells_as_that_of_fringes_moves_them() -> None:
    column = np.arange(0.5, 200.0)
    for frame in GrayCode(bits=(5,), cell_px=8.0).frames():
        later = replace(frame, phase_shift_rad=frame.phase_shift_rad + np.pi / 2)
        np.testing.assert_array_equal(later.commanded(column), frame.commanded(column + 2.0))
    fringe = PhaseShift(steps=4, periods_px=(8.0,)).frames()[0]
    later = replace(fringe, phase_shift_rad=fringe.phase_shift_rad + np.pi / 2)
    np.testing.assert_allclose(later.commanded(column), fringe.commanded(column + 2.0), atol=1e-12)


@pytest.mark.parametrize("kind", [{}, {"gamma": 2.2}, {"bits": 8, "contrast": 0.8}])
@pytest.mark.parametrize(
    "patterns",
    [
        GrayCode(axes=("column", "row"), bits=(7, 6)),
        GrayCode(axes=("row",), bits=(4,), cell_px=3.0, inverted=False),
        PhaseShift(steps=3, periods_px=(12.0, 16.0), axes=("column", "row"), gray=GrayBits(bits=4)),
        PhaseShift(steps=4, periods_px=(8.0,), shifts_rad=(0.0, 1.0, 2.5, 4.0)),
    ],
)
def test_basis_makes_every_frame_of_gray_code_and_unequal_steps(
    patterns: PhaseShift | GrayCode, kind: dict[str, float]
) -> None:
    light = projector(96, 40, **kind)
    rng = np.random.default_rng(1)
    u, v = (np.floor(rng.uniform(0, size, 500)) + 0.5 for size in RESOLUTION)
    wanted = np.stack(
        [
            light.emit(patterns.commanded(f, u if f.axis == "column" else v))
            for f in patterns.frames()
        ]
    )
    # float64 rounding of a sum of some ten terms of order one
    made = emitted(basis(patterns, light, RESOLUTION), u, v)
    np.testing.assert_allclose(made, wanted, atol=1e-12)


def test_inverses_cost_at_most_one_channel() -> None:
    light = projector(*RESOLUTION)
    plain = basis(GrayCode(bits=(7,), inverted=False, flat=False), light, RESOLUTION)
    both = basis(GrayCode(bits=(7,), flat=False), light, RESOLUTION)
    assert len(both.channels) <= len(plain.channels) + 1


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"shifts_rad": (0.0, 1.0)}, "2 values for 4 steps"),
        ({"shifts_rad": (0.0, 0.0, 2 * np.pi, 1.0)}, "three different shifts"),
        ({"gray": GrayBits(bits=5, cell_px=40.0)}, "wider than the coarsest period"),
    ],
)
def test_patterns_that_determine_no_phase_are_refused(keys: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        PhaseShift.model_validate({"kind": "phase-shift", "periods_px": (16.0,), **keys})
