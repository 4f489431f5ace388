"""The fast pass against Mitsuba's own `path`, which renders the very scene the user gets from `mitsuba_scene`.

Both are unbiased estimates of one integral, so their means agree in every pixel and in the whole image; a wrong
footprint, lens, BSDF, shadow or depth shows as a difference.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.render.oracle import compare, fast_pass
from tests.render.rigs import (
    DISTORTION,
    board,
    groove,
    pinhole,
    pinhole_projector,
    resin,
    scene,
    telecentric,
    telecentric_projector,
)

CASES = {
    "pinhole": scene(pinhole(), pinhole_projector()),
    "telecentric": scene(telecentric(), telecentric_projector(), ambient=5.0),
    "thin lenses": scene(
        pinhole(lens={"aperture_mm": 20.0, "focus_mm": 180.0}),
        pinhole_projector(lens={"aperture_mm": 20.0, "focus_mm": 190.0}),
    ),
    "telecentric lenses": scene(
        telecentric(lens={"numerical_aperture": 0.1, "focus_mm": 180.0}),
        telecentric_projector(lens={"numerical_aperture": 0.12, "focus_mm": 190.0}),
    ),
    "distorted": scene(
        pinhole(field_mm=120.0, distortion=DISTORTION),
        pinhole_projector(field_mm=120.0, distortion=DISTORTION),
    ),
    "interreflection": scene(pinhole(), pinhole_projector(), objects=groove(), depth=6),
    "two axes": scene(
        telecentric(),
        telecentric_projector(),
        objects=groove(),
        depth=4,
        patterns={"axes": ("column", "row")},
    ),
    "translucent": scene(pinhole(), pinhole_projector(), objects=resin(), depth=6),
    "mirror": scene(pinhole(), pinhole_projector(), objects=board("mirror"), depth=4, ambient=2.0),
    "tables": scene(
        pinhole(), pinhole_projector(gamma=2.2, bits=8), patterns={"axes": ("column", "row")}
    ),
    "second projector": scene(
        telecentric(),
        telecentric_projector(),
        telecentric_projector(
            x_mm=70.0,
            irradiance_w_m2=40.0,
            gamma=1.8,
            lens={"numerical_aperture": 0.05, "focus_mm": 190.0},
        ),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_fast_pass_equals_path_in_every_pixel_and_in_the_mean(case: str, tmp_path: Path) -> None:
    checked = CASES[case]
    # What comes back out of resin scatters most, in `path` above all: more repeats keep the bias detectable.
    repeats = 22 if case == "translucent" else 16
    comparison = compare(checked, frame=1, projector=len(checked.projectors) - 1, repeats=repeats)

    comparison.require_equal(tmp_path)
    # Half a percent of bias would be detected.
    assert comparison.mean_bias()[1] < 0.005 / 3


def test_z_test_finds_a_footprint_a_tenth_of_a_pixel_off() -> None:
    moved = pinhole(cx_px=12.1)
    comparison = compare(CASES["pinhole"], frame=1)
    off = fast_pass(scene(moved, pinhole_projector()), frame=1)

    assert type(comparison)(off, comparison.oracle).smallest_p() < 1e-6
    assert np.isfinite(comparison.pixel_p_values()).all()
