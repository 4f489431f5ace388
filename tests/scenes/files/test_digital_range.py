"""Where a camera saturates, seen in frames of known truth."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import decode
from scenes.acquisition.patterns import Frame, GrayBits, PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.digital_range import DigitalRange
from scenes.files.noise_estimate import noise_dn
from scenes.files.stack import Stack
from scenes.support.errors import FileError

ROWS, COLUMNS = 90, 160
TOP = 255.0


def scene(gain: float) -> tuple[np.ndarray, np.ndarray]:
    """Projector column and reflectance times `gain` of a bump, with a patch that is 3.5 times as bright."""
    y, x = np.mgrid[:ROWS, :COLUMNS] + 0.5
    bump = 30.0 * np.exp(-((x - 80.0) ** 2 + (y - 45.0) ** 2) / 225.0)
    shiny = (x - 40.0) ** 2 + (y - 45.0) ** 2 < 300.0
    return 4.0 * x + 100.0 + bump, gain * np.where(shiny, 3.5, 1.0)


def light(
    patterns: PhaseShift, gain: float, texture: float = 0.0
) -> tuple[np.ndarray, tuple[Frame, ...]]:
    """Noise-free frames (frame, row, col), 1 is white on reflectance 1."""
    column, reflectance = scene(gain)
    rng = np.random.default_rng(3)
    reflectance = reflectance * rng.uniform(1.0 - texture, 1.0, reflectance.shape)
    shown = patterns.frames()
    return reflectance * (
        0.04 + 0.25 * np.stack([patterns.commanded(f, column) for f in shown])
    ), shown


def counts(values: np.ndarray, top: float, clip: float, sigma: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, sigma, values.shape)
    return np.clip(np.round(values * top + noise), 0, clip)


def patterns(steps: int, gray: bool = False) -> PhaseShift:
    code = GrayBits(bits=7, cell_px=16.0, inverted=False, flat=True) if gray else None
    return PhaseShift(steps=steps, periods_px=(16.0,) if gray else (16.0, 128.0, 1024.0), gray=code)


@pytest.mark.parametrize("clip", [235, 240, 200])
@pytest.mark.parametrize("steps", [3, 4, 8])
@pytest.mark.parametrize("gray", [False, True])
@pytest.mark.parametrize("sigma", [0.0, 1.0])
def test_level_below_full_scale_at_which_samples_clip_is_found(
    clip: int, steps: int, gray: bool, sigma: float
) -> None:
    values, shown = light(patterns(steps, gray), 2.0)
    frames = counts(values, TOP, clip, sigma).astype(np.uint8)[None]
    found = DigitalRange.of(frames, shown, 8)
    assert found.saturation_dn == clip
    assert [f.verdict for f in found.findings] == ["warning"]


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_range_of_left_aligned_counts_ends_at_their_largest_value(bits: int) -> None:
    step, top = 2 ** (16 - bits), 2**bits - 1
    for gain in (1.0, 4.0):
        values, shown = light(patterns(4), gain)
        frames = (counts(values, top, top, 0.004 * top) * step).astype(np.uint16)[None]
        found = DigitalRange.of(frames, shown, 16)
        assert (found.step_dn, found.saturation_dn) == (step, top * step)
        # Fringes of four pixels on the bump are rough too, so that the estimate is an upper one.
        assert 0.9 < found.noise_dn / (0.004 * top * step) < 1.4
        with pytest.raises(FileError, match="set bits = 16"):
            DigitalRange.of(frames, shown, 8)


@pytest.mark.parametrize("quality", [90, 98])
def test_clipping_is_found_through_lossy_compression(quality: int) -> None:
    values, shown = light(patterns(4), 3.0)
    clean = counts(values, TOP, 235, 1.0).astype(np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    coded = [cv2.imencode(".jpg", frame, options)[1] for frame in clean]
    frames = np.stack([np.asarray(cv2.imdecode(c, cv2.IMREAD_GRAYSCALE)) for c in coded])
    found = DigitalRange.of(frames[None], shown, 8)
    assert 225 <= found.saturation_dn <= 237


@pytest.mark.parametrize("sigma", [0.0, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("steps", [3, 4, 16])
@pytest.mark.parametrize("texture", [0.0, 0.5])
@pytest.mark.parametrize("gray", [False, True])
def test_unclipped_frames_saturate_at_full_scale(
    sigma: float, steps: int, texture: float, gray: bool
) -> None:
    values, shown = light(patterns(steps, gray), 0.8, texture)
    frames = counts(values, TOP, TOP, sigma).astype(np.uint8)
    # A defective pixel is as bright in every frame.
    frames[:, 3, ::3] = 252
    found = DigitalRange.of(frames[None], shown, 8)
    assert found.saturation_dn == 255.0
    assert not found.findings


@pytest.mark.parametrize("clip", [200, 235])
def test_clipped_samples_are_not_decoded_as_valid(clip: int) -> None:
    shown_patterns = patterns(3)
    values, shown = light(shown_patterns, 1.0)
    exposures = (1.0, 4.0)
    frames = np.stack([counts(t * values, TOP, clip, 1.0, int(t)) for t in exposures])
    found = DigitalRange.of(frames.astype(np.uint8), shown, 8)
    sensor = SimpleSensor(sigma_dn=found.noise_dn, saturated_from_dn=found.saturation_dn)
    stack = Stack(
        frames.astype(np.uint8), shown, exposures, sensor, projector_resolution=(1024, 768)
    )
    rec = decode.reconstruct(stack, height="phase", fusion="max-modulation")
    phase = rec.phases["column"]
    off = np.abs(phase.coordinate_px - scene(1.0)[0])[rec.valid]
    # Noise of 1 DN on a modulation of 16 DN or more: 0.13 px for three steps of 16 px.
    assert rec.valid.mean() > 0.9
    assert np.sqrt(np.mean(off**2)) < 0.13
    unaware = replace(stack, sensor=SimpleSensor(sigma_dn=found.noise_dn))
    bad = decode.reconstruct(unaware, height="phase", fusion="max-modulation")
    worst = np.abs(bad.phases["column"].coordinate_px - scene(1.0)[0])[bad.valid]
    assert np.sqrt(np.mean(worst**2)) > 2.0 * np.sqrt(np.mean(off**2))


@pytest.mark.parametrize("share", [0.01, 0.05, 0.5])
def test_noise_is_that_of_lit_pixels(share: float) -> None:
    rng = np.random.default_rng(2)
    lit = np.zeros((200, 300), np.bool_)
    lit[:, : int(300 * share)] = True
    frames = np.where(lit, 120.0 + rng.normal(0.0, 3.0, (1, 6, 200, 300)), 2.0)
    assert noise_dn(np.round(frames).astype(np.uint8)) == pytest.approx(3.0, rel=0.15)


@pytest.mark.parametrize("steps", [4, 8])
def test_noise_of_a_textured_surface_is_that_of_its_samples(steps: int) -> None:
    values, shown = light(PhaseShift(steps=steps, periods_px=(16.0, 128.0)), 1.0, texture=0.4)
    frames = np.round(200.0 * values + np.random.default_rng(4).normal(20.0, 1.0, values.shape))
    digital = frames.clip(0, 255).astype(np.uint8)[None]
    # Rounding adds a twelfth of a DN squared; a thousand bright pixels fix sigma to 2 %.
    wanted = np.hypot(1.0, 12.0**-0.5)
    assert noise_dn(digital, 255.0, 1.0, shown) == pytest.approx(wanted, rel=0.06)


def test_noise_of_frames_too_small_to_show_it_is_that_of_rounding() -> None:
    assert noise_dn(np.zeros((1, 3, 2, 2), np.uint8), step_dn=4.0) == pytest.approx(4.0 / 12.0**0.5)


def test_noise_leaves_out_saturated_pixels() -> None:
    rng = np.random.default_rng(2)
    level = np.full((200, 300), 120.0)
    level[:, :150] = 300.0
    frames = np.clip(np.round(level + rng.normal(0.0, 2.0, (1, 6, 200, 300))), 0, 255)
    assert noise_dn(frames.astype(np.uint8), 255.0) == pytest.approx(2.0, rel=0.1)
