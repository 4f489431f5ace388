"""Two cameras that see one texture, from formulas alone."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import decode
from decode.reason import Reason
from scenes.acquisition.frames import Frame
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt, Pinhole
from scenes.support.errors import DecodeError
from tests.decode.synthetic import LENS, rig
from tests.decode.test_stereo_phase import BOTH, heights, look

HEIGHTS = (-1.0, 4.0)
DOTS = Frame("column", 4.0, 0, 1, 0.0, kind="dots")
RIGHT, ABOVE, LEFT = (8.0, 2.0, 60.0), (0.0, 10.0, 60.0), (-8.0, 2.0, 61.0)


def camera(origin_mm: tuple[float, float, float]) -> Pinhole:
    return Pinhole(
        resolution=(160, 120),
        pose=LookAt(origin_mm=origin_mm),
        fx_px=600.0,
        fy_px=605.0,
        cx_px=83.3,
        cy_px=58.3,
        distortion=LENS,
    )


def texture(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    """A hundred waves 3 to 9 camera pixels long (a pixel is 0.1 mm), DN."""
    rng = np.random.default_rng(1)
    angle, phase = rng.uniform(0.0, 2.0 * np.pi, (2, 100))
    k = 2.0 * np.pi / rng.uniform(0.3, 0.9, 100)
    waves = np.cos(k * (np.cos(angle) * x[..., None] + np.sin(angle) * y[..., None]) + phase)
    return np.asarray(2000.0 + 60.0 * waves.sum(axis=-1))


@cache
def pair(second: Pinhole, contrast: float = 1.0) -> tuple[Stack, NDArray[np.float64]]:
    """Stack of both cameras with noise of 10 DN, and the first one's true heights."""
    first, rng, frames = camera((0.0, 2.0, 60.0)), np.random.default_rng(0), []
    for device in (first, second):
        geometry = device.projection()
        point = geometry.points_at(heights(device))
        light = 2000.0 + contrast * (texture(point[..., 0], point[..., 1]) - 2000.0)
        frames.append(light + rng.normal(0.0, 10.0, light.shape))
    calibration = Calibration(
        camera=first,
        projectors=rig("pinhole", "pinhole").projectors,
        height_range_mm=HEIGHTS,
        second_camera=second,
    )
    stack = Stack(
        np.stack(frames)[None].astype(np.float32),
        (DOTS, replace(DOTS, camera=1)),
        (1.0,),
        SimpleSensor(bits=0, sigma_dn=10.0),
        calibration,
    )
    return stack, heights(first)


@pytest.mark.parametrize("origin_mm", [RIGHT, ABOVE, LEFT], ids=["right", "above", "left"])
def test_heights_of_a_texture_are_found_wherever_the_second_camera_is(
    origin_mm: tuple[float, float, float],
) -> None:
    stack, height = pair(camera(origin_mm))
    rec = decode.reconstruct(stack)
    baseline = np.linalg.norm(np.subtract(origin_mm, (0.0, 2.0, 60.0)))
    mm_per_px = 60.0**2 / (600.0 * baseline)
    error = np.abs(rec.height_mm - height)[rec.valid]
    # The field's rim is seen by one camera alone; matchers resolve about a tenth of a pixel where the surface is flat.
    assert rec.valid.mean() > 0.6
    assert np.median(error) < 0.15 * mm_per_px
    assert (error > mm_per_px).mean() < 0.05
    assert np.isnan(rec.sigma_mm).all(), "no sigma is claimed"


def test_untextured_pair_is_refused_with_the_reason() -> None:
    stack, _ = pair(camera(RIGHT), contrast=0.0)
    with pytest.raises(DecodeError, match=r"no-texture (9|100).*project random dots"):
        decode.reconstruct(stack)


def test_matches_outside_the_working_volume_are_no_heights() -> None:
    # The surface is between 0.5 and 2.5 mm, and disparities are searched in whole sixteens: well beyond this volume.
    stack, _ = pair(camera(RIGHT))
    rec = decode.reconstruct(stack, height_range_mm=(1.2, 1.8))
    assert ((rec.height_mm >= 1.2) & (rec.height_mm <= 1.8))[rec.valid].all()
    outside = rec.height_mm[rec.reason == Reason.OUT_OF_VOLUME]
    assert (outside < 1.2).any() and (outside > 1.8).any()


def test_block_matcher_measures_a_region() -> None:
    stack, height = pair(camera(RIGHT))
    rec = decode.reconstruct(stack, matcher="bm", roi=(30, 90, 60, 140))
    assert (rec.reason[:30] == Reason.OUTSIDE_ROI).all()
    assert rec.settings["matcher"] == "bm"
    assert np.median(np.abs(rec.height_mm - height)[rec.valid]) < 0.15 * 60.0**2 / (600.0 * 8.0)


def test_a_saturated_pixel_has_its_reason_and_other_exposures_help() -> None:
    stack, _ = pair(camera(RIGHT))
    frames = np.concatenate([stack.frames, 2.0 * stack.frames])
    frames[:, :, 50:60, 70:80] = 5000.0
    sensor = SimpleSensor(bits=12, sigma_dn=10.0)
    rec = decode.reconstruct(replace(stack, frames=frames, exposure_ms=(1.0, 2.0), sensor=sensor))
    assert (rec.reason[52:58, 72:78] == Reason.SATURATED).all()
    assert set(np.unique(rec.exposure)) == {0, 1}
    assert rec.valid.mean() > 0.5


def test_a_pair_with_fringes_is_decoded_by_phase() -> None:
    eyes = camera((0.0, 2.0, 60.0)), camera(RIGHT)
    (left, height), (right, _) = (look(eye, BOTH, 0.0, 0) for eye in eyes)
    lamps = rig("pinhole", "pinhole").projectors
    calibration = Calibration(
        camera=eyes[0], second_camera=eyes[1], projectors=lamps, height_range_mm=HEIGHTS
    )
    patterns = (*left.patterns, *(replace(frame, camera=1) for frame in right.patterns))
    frames = np.concatenate([left.frames, right.frames], axis=1)
    stack = replace(left, frames=frames, patterns=patterns, calibration=calibration)
    rec = decode.reconstruct(stack, saturation="ignore")
    assert rec.calibration == calibration
    # As the two stacks by themselves, tests/decode/test_stereo_phase.py.
    assert np.abs(rec.height_mm - height)[rec.valid].max() < 2e-3
    assert rec.valid.mean() > 0.6
    with pytest.raises(DecodeError, match="matcher does not apply to stacks of two cameras with"):
        decode.reconstruct(stack, matcher="bm")


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        ({}, {"height": "linear"}, "height does not apply to stacks of two cameras"),
        ({}, {"axis": "row"}, "axis does not apply"),
        ({}, {"gamma": 2.0}, "gamma does not apply to stacks of two cameras without fringes"),
        ({}, {"uncertainty": "by-cause"}, "uncertainty does not apply"),
        ({}, {"matcher": "census"}, "sgbm"),
        ({}, {"height_range_mm": (55.0, 70.0)}, "not in front of both cameras"),
        ({"calibration": None}, {}, "second_camera"),
        ({"patterns": (DOTS, DOTS)}, {}, "no height with one camera"),
    ],
)
def test_wrong_mixtures_are_refused(
    change: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    stack, _ = pair(camera(RIGHT))
    with pytest.raises(DecodeError, match=said):
        decode.reconstruct(replace(stack, **change), **options)
