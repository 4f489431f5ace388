"""What a calibration with both axes shows of the manifest, and what is said not to be shown."""

from dataclasses import replace

import numpy as np
import pytest

from decode.checks.stack_check import check
from scenes.acquisition.patterns import GrayBits, GrayCode, Patterns, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.devices import LookAt
from tests.decode.synthetic import coordinates, hills, rig

SIZE = (200, 150)
BOTH = ("column", "row")
CODED = PhaseShift(periods_px=(20.0,), gray=GrayBits(bits=6), axes=BOTH)
ALONE = GrayCode(bits=(9, 9), axes=BOTH, flat=False)
# A period that is unique, and one that tells three steps apart.
PERIODS = PhaseShift(periods_px=(20.0, 400.0))


def taken(patterns: Patterns, level: bool = False) -> Stack:
    """Noisy frames; `level`: the projector is straight to the camera's right, so that rows say nothing about columns."""
    # A deep volume, or shifted columns are outside of it.
    made = rig("pinhole", "pinhole", size=SIZE, heights_mm=(-20.0, 20.0))
    if level:
        light = made.projectors[0].model_copy(update={"pose": LookAt(origin_mm=(35, 0, 50))})
        made = made.model_copy(update={"projectors": (light,)})
    height = hills(SIZE)
    at_px = dict(zip(BOTH, coordinates(made, height), strict=True))
    shown = patterns.frames()
    light_dn = np.stack([160.0 * patterns.commanded(f, at_px[f.axis]) for f in shown])
    noise = np.random.default_rng(3).normal(0.0, 1.0, light_dn.shape)
    counts = np.round(30.0 + light_dn + noise).clip(0, 255).astype(np.uint8)
    return Stack(counts[None], shown, (1.0,), SimpleSensor(sigma_dn=1.0), made)


def shifted(stack: Stack, axis: str, shift_px: float) -> Stack:
    """The stack whose manifest has the axis' Gray code begin elsewhere."""
    return replace(
        stack,
        patterns=tuple(
            replace(f, phase_shift_rad=-2.0 * np.pi * shift_px / f.period_px)
            if (f.kind, f.axis) == ("gray", axis)
            else f
            for f in stack.patterns
        ),
    )


@pytest.mark.parametrize("axis", BOTH)
@pytest.mark.parametrize("periods", [-1, 1, 2])
@pytest.mark.parametrize("patterns", [CODED, ALONE], ids=["fringes", "alone"])
def test_code_of_another_period_is_seen_by_the_other_axis(
    patterns: Patterns, axis: str, periods: int
) -> None:
    """Without a calibration the images are those of another manifest."""
    right = taken(patterns)
    stack = shifted(right, axis, 20.0 * periods)
    found = check(stack)
    assert [f.name for f in found.wrong] == ["calibration"]
    if patterns is CODED:
        assert f"{axis}s that are {-20 * periods:+g} px" in found.wrong[0].message
    plain = replace(stack, calibration=None, projector_resolution=(400, 400))
    assert not check(plain).wrong
    assert "gray.origin_px" in check(plain).not_verified
    assert not check(right).wrong


@pytest.mark.parametrize(
    ("patterns", "calibrated", "keys"),
    [
        (ALONE, True, set()),
        (ALONE, False, {"gray.cell_px", "gray.origin_px"}),
        (CODED, True, set()),
        (CODED, False, {"gray.origin_px", "fringes.period_px"}),
        (PERIODS, False, {"fringes.period_px", "fringes.origin_px", "fringes.direction"}),
        (PERIODS, True, {"fringes.period_px", "fringes.origin_px", "fringes.direction", "calibration"}),
    ],
)  # fmt: skip
def test_parts_that_images_cannot_verify_are_named(
    patterns: Patterns, calibrated: bool, keys: set[str]
) -> None:
    stack = taken(patterns)
    if not calibrated:
        stack = replace(stack, calibration=None, projector_resolution=(400, 400))
    report = check(stack)
    assert not report.wrong
    # Less than four of the coarse fringes are in view.
    assert set(report.not_verified) - {"brightness of the source", "gamma"} == keys
    assert report.to_dict()["not_verified"] == report.not_verified


def test_columns_are_not_verified_where_epipolar_lines_are_the_projectors_rows() -> None:
    report = check(taken(CODED, level=True))
    assert "columns" in report.not_verified["gray.origin_px"]
    assert "rows" not in report.not_verified["gray.origin_px"]


def test_order_of_three_steps_of_one_period_is_not_verified() -> None:
    stack = replace(taken(PhaseShift(steps=3, periods_px=(20.0,))), calibration=None)
    assert "three steps" in check(stack).not_verified["files"]
