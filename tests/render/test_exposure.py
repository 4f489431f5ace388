"""Exposing synthetic transport, whose every number is known, so that no light needs tracing."""

import itertools
import os
import sys
from typing import Any

import numpy as np
import pytest

import render
import scenes
from render.sensor_stages import Noise, digital_numbers
from scenes.acquisition.patterns import GrayCode, Patterns, PhaseShift
from scenes.acquisition.sensor import Emva, SimpleSensor
from scenes.scene import AutoExposure, Exposures
from scenes.support.errors import RenderError

COLUMNS, ROWS = 40, 30
IDEAL = SimpleSensor(bits=0, sigma_dn=0.0, responsivity_dn=2.0, black_level_dn=10.0)


def transport(
    scene: scenes.Scene | None = None, seed: int = 0, overrides: dict[str, Any] | None = None
) -> render.Transport:
    """A transport in which pixel (row, col) sees one projector pixel, a random albedo, and half as much direct light.

    Label 1 (base) is the left half of the image and label 2 (step) the next quarter; nothing else is seen.
    """
    resolution = {"camera.resolution": [COLUMNS, ROWS]}
    scene = scene or scenes.load("step", resolution | (overrides or {}))
    rng = np.random.default_rng(seed)
    bases = tuple(scenes.basis(scene.patterns, p, p.resolution) for p in scene.projectors)
    albedo = rng.uniform(0.2, 0.9, (len(bases), ROWS, COLUMNS))
    column, row = projector_pixels(scene)
    total = np.zeros((len(bases), max(len(b.channels) for b in bases), ROWS, COLUMNS), np.float32)
    for p, basis in enumerate(bases):
        for c, channel in enumerate(basis.channels):
            u = column[p] if channel.axis == "column" else row[p]
            phase = 2 * np.pi * u / (channel.period_px or 1.0)
            value = {
                "one": np.ones_like(u),
                "cos": np.cos(phase),
                "sin": np.sin(phase),
                "table": np.array(channel.values or [0.0])[
                    u.astype(int) if channel.values else np.zeros(u.shape, int)
                ],
            }[channel.kind]
            total[p, c] = albedo[p] * value
    label = np.zeros((ROWS, COLUMNS), np.uint16)
    label[:, : COLUMNS // 2] = 1
    label[:, COLUMNS // 2 : 3 * COLUMNS // 4] = 2
    ambient = rng.uniform(0.0, 0.1, (ROWS, COLUMNS)).astype(np.float32)
    return render.Transport(
        total,
        total / np.float32(2),
        ambient,
        label,
        scene.labels,
        bases,
        scene,
        seed,
        samples=4,
        depth=2,
    )


def projector_pixels(scene: scenes.Scene) -> tuple[np.ndarray, np.ndarray]:
    """Continuous projector column and row that each camera pixel sees, (projector, row, col)."""
    rng = np.random.default_rng(99)
    shape = (len(scene.projectors), ROWS, COLUMNS)
    width, height = scene.projectors[0].resolution
    return rng.uniform(0, width, shape), rng.uniform(0, height, shape)


def emitted(scene: scenes.Scene, patterns: Patterns, projector: int = 0) -> np.ndarray:
    """What each camera pixel's projector pixel emits, (frame, row, col), from the patterns' definition."""
    device = scene.projectors[projector]
    images = []
    for frame in patterns.frames():
        u = projector_pixels(scene)[0 if frame.axis == "column" else 1][projector]
        if device.pixelated:
            u = np.floor(u) + 0.5
        images.append(device.emit(patterns.commanded(frame, u)))
    return np.array(images)


def rounding(light: render.Transport) -> float:
    """What float32 channels and their sum may be off by."""
    terms = light.total.shape[1] + 2
    return float(terms * 2.0**-24 * np.abs(light.total).max() * terms)


def test_noise_free_exposure_is_linear_in_the_transports_frames() -> None:
    light = transport()
    stack = render.expose(light, sensor=IDEAL, exposures=[1.0, 3.0])
    assert stack.frames.dtype == np.float32
    for e, time_ms in enumerate((1.0, 3.0)):
        expected = 10.0 + 2.0 * time_ms * light.frames().astype(float)
        # Plus the rounding of a digital number to float32.
        bound = 2.0 * time_ms * rounding(light) + 2.0**-24 * expected.max()
        assert np.abs(stack.frames[e] - expected).max() <= bound


def test_traced_scene_exposes_to_its_own_frames() -> None:
    scene = scenes.load("step", {"camera.resolution": [32, 24], "ambient.radiance_w_m2_sr": 0.5})
    light = render.trace(scene, samples=2)
    for direct_only in (False, True):
        stack = render.expose(light, sensor=IDEAL, exposures=[1.0], direct_only=direct_only)
        expected = 10.0 + 2.0 * light.frames(direct_only=direct_only)
        np.testing.assert_allclose(stack.frames[0], expected, atol=4 * rounding(light))


@pytest.mark.parametrize(
    "patterns",
    [
        PhaseShift(steps=7, periods_px=(16.0, 128.0, 1024.0)),
        PhaseShift(steps=3, periods_px=(128.0,), amplitude=0.4),
        PhaseShift(steps=64, periods_px=(16.0, 1024.0)),
    ],
    ids=["more-steps", "one-period-weaker", "two-periods"],
)
def test_other_patterns_of_the_traced_periods_need_no_trace(patterns: PhaseShift) -> None:
    light = transport()
    stack = render.expose(light, sensor=IDEAL, exposures=[0.5], patterns=patterns)
    assert stack.patterns == patterns.frames()
    white = light.total[0, 0].astype(float)
    expected = 10.0 + white * emitted(light.scene, patterns) + light.ambient
    # Traced channels carry float32 cosines.
    np.testing.assert_allclose(stack.frames[0], expected, atol=rounding(light) + 2e-6)


def test_patterns_along_both_axes_come_in_the_scenes_order() -> None:
    light = transport(overrides={"patterns.axes": ["row", "column"]})
    stack = render.expose(light, sensor=IDEAL, exposures=[0.5])
    assert [f.axis for f in stack.patterns[::12]] == ["row", "column"]
    expected = 10.0 + light.total[0, 0] * emitted(light.scene, light.scene.patterns) + light.ambient
    np.testing.assert_allclose(stack.frames[0], expected, atol=rounding(light) + 2e-6)
    one = PhaseShift(periods_px=(16.0,), axes=("column",))
    alone = render.expose(light, sensor=IDEAL, exposures=[0.5], patterns=one)
    np.testing.assert_array_equal(alone.frames[0], stack.frames[0, 12:16])


@pytest.mark.parametrize(
    ("patterns", "channel"),
    [
        (PhaseShift(periods_px=(32.0,)), "cos-column-32px"),
        (PhaseShift(periods_px=(16.0,), axes=("row",)), "cos-row-16px"),
    ],
)
def test_pattern_outside_the_span_is_refused_with_the_missing_channel(
    patterns: PhaseShift, channel: str
) -> None:
    with pytest.raises(RenderError, match=rf"'{channel}'.*not traced.*trace the scene again"):
        render.expose(transport(), patterns=patterns)


def test_pixelated_projector_shows_only_combinations_of_its_traced_patterns() -> None:
    light = transport(overrides={"projectors.0.gamma": 2.2, "projectors.0.bits": 8})
    whole = render.expose(light, sensor=IDEAL, exposures=[0.5])
    albedo = np.random.default_rng(0).uniform(0.2, 0.9, (1, ROWS, COLUMNS))[0]
    expected = 10.0 + albedo * emitted(light.scene, light.scene.patterns) + light.ambient
    # Tables keep directions down to 1e-7 of the strongest; each is stored in float32.
    np.testing.assert_allclose(whole.frames[0], expected, atol=rounding(light) + 2e-6)
    part = PhaseShift(periods_px=(16.0, 1024.0))
    subset = render.expose(light, sensor=IDEAL, exposures=[0.5], patterns=part)
    np.testing.assert_allclose(
        subset.frames[0], whole.frames[0][[0, 1, 2, 3, 8, 9, 10, 11]], atol=1e-5
    )
    for outside in (
        PhaseShift(steps=5, periods_px=(16.0,)),
        PhaseShift(periods_px=(16.0,), amplitude=0.9),
        PhaseShift(periods_px=(16.0,), axes=("row",)),
    ):
        with pytest.raises(RenderError, match=r"outside the span.*\d+ tables.*trace the scene"):
            render.expose(light, patterns=outside)


def test_gray_code_and_fringes_share_a_transport() -> None:
    gray = {"bits": 7, "inverted": True, "flat": True}
    light = transport(overrides={"patterns.periods_px": [16.0], "patterns.gray": gray})
    stack = render.expose(light, sensor=IDEAL, exposures=[0.5])
    white = next(c for c, channel in enumerate(light.bases[0].channels) if channel.kind == "one")
    albedo = light.total[0, white].astype(float)
    expected = 10.0 + albedo * emitted(light.scene, light.scene.patterns) + light.ambient
    # Tables of Gray code have entries up to the root of their number of pixels.
    np.testing.assert_allclose(stack.frames[0], expected, atol=rounding(light) + 2e-6)
    fringes = light.scene.patterns.model_copy(update={"gray": None, "steps": 5})
    alone = render.expose(light, sensor=IDEAL, exposures=[0.5], patterns=fringes)
    assert alone.frames.shape[1] == 5
    finer = GrayCode(bits=(9,), cell_px=2.0)
    with pytest.raises(RenderError, match=r"gray, column, 2 px.*outside the span"):
        render.expose(light, patterns=finer)


def test_frames_of_several_projectors_are_in_the_scenes_order() -> None:
    one = scenes.load("step", {"camera.resolution": [COLUMNS, ROWS]})
    scene = one.model_copy(update={"projectors": one.projectors * 2})
    light = transport(scene)
    stack = render.expose(light, sensor=IDEAL, exposures=[1.0])
    assert stack.patterns == scene.frames
    for p in (0, 1):
        shown = [i for i, f in enumerate(stack.patterns) if f.projector == p]
        expected = 10.0 + 2.0 * light.frames(p)
        np.testing.assert_allclose(stack.frames[0, shown], expected, atol=4 * rounding(light))
    assert np.abs(light.frames(0) - light.frames(1)).max() > 0.1


@pytest.mark.parametrize(
    "sensor",
    [IDEAL, Emva(bits=0, full_well_e=1e9, dark_current_e_per_s=3e4, read_noise_e=0)],
    ids=lambda s: s.kind,
)
def test_auto_exposure_reaches_its_level(sensor: SimpleSensor | Emva) -> None:
    light = transport()
    frames = light.frames()
    for statistic, value in itertools.product(("mean", "peak"), (150.0, 900.0)):
        auto = AutoExposure(label="step", level_dn=value, statistic=statistic)
        stack = render.expose(
            light,
            sensor=sensor,
            exposures=Exposures(auto=auto, relative=(0.5, 1.0, 4.0)),
            noise=False,
        )
        times = np.array(stack.exposure_ms)
        np.testing.assert_allclose(times / times[1], [0.5, 1.0, 4.0], rtol=1e-12)
        on_label = stack.frames[1][:, light.label == 2].astype(float)
        met = on_label.mean()
        if statistic == "peak":
            met = max(np.percentile(image, 99) for image in on_label)
        assert met == pytest.approx(value, rel=1e-6)
    assert frames[:, light.label == 2].mean() != pytest.approx(frames.mean(), rel=1e-3)


def test_direct_light_alone_is_exposed_as_long_as_all_light() -> None:
    light = transport()
    exposures = Exposures(auto=AutoExposure(label="base", level_dn=200.0))
    total, direct = (
        render.expose(light, sensor=IDEAL, exposures=exposures, direct_only=d)
        for d in (False, True)
    )
    assert direct.exposure_ms == total.exposure_ms
    gain = 2.0 * total.exposure_ms[0]
    dark = 10.0 + gain * light.ambient.astype(float)
    # Float32 digital numbers, of which dark is most in some pixels.
    atol = 4 * 2.0**-24 * float(total.frames.max()) + gain * rounding(light)
    np.testing.assert_allclose((direct.frames - dark) * 2, total.frames - dark, atol=atol)


@pytest.mark.parametrize(
    ("auto", "message"),
    [
        (AutoExposure(label="steep", level_dn=100.0), "did you mean 'step'"),
        (AutoExposure(label="step", level_dn=300.0), r"300.*up to saturation 255"),
        (AutoExposure(label="step", level_dn=5.0), r"5.*above the black level 20"),
    ],
)
def test_impossible_auto_exposure_is_refused_with_the_reason(
    auto: AutoExposure, message: str
) -> None:
    with pytest.raises(RenderError, match=message):
        render.expose(
            transport(), sensor=SimpleSensor(black_level_dn=20.0), exposures=Exposures(auto=auto)
        )


def test_auto_exposure_of_an_unseen_or_dark_label_is_refused() -> None:
    light = transport()
    exposures = Exposures(auto=AutoExposure(label="step", level_dn=100.0))
    light.label[light.label == 2] = 0
    with pytest.raises(RenderError, match="'step' is seen by no pixel"):
        render.expose(light, exposures=exposures)
    dark = transport()
    dark.total[:, :, dark.label == 2] = 0
    dark.ambient[dark.label == 2] = 0
    # Dark current alone must not pass for light.
    with pytest.raises(RenderError, match="'step' is dark"):
        render.expose(dark, sensor=Emva(psf="none"), exposures=exposures)


@pytest.mark.parametrize("times", [[], [1.0, -2.0], [0.0], [float("nan")], ["soon"], 3.0])
def test_impossible_exposure_times_are_refused(times: Any) -> None:
    with pytest.raises(RenderError, match=r"times in ms, each above 0"):
        render.expose(transport(), exposures=times)


def test_negative_seed_is_refused() -> None:
    with pytest.raises(RenderError, match=r"seed = -1"):
        render.expose(transport(), seed=-1)


@pytest.mark.parametrize("sensor", [SimpleSensor(), Emva(prnu=0.01)], ids=lambda s: s.kind)
def test_noise_depends_on_the_seed_alone(
    sensor: SimpleSensor | Emva, monkeypatch: pytest.MonkeyPatch
) -> None:
    light = transport()
    exposures = [20.0, 40.0]
    once = render.expose(light, seed=1, sensor=sensor, exposures=exposures)
    for threads in (1, 7):
        monkeypatch.setattr(os, "cpu_count", lambda threads=threads: threads)
        again = render.expose(light, seed=1, sensor=sensor, exposures=exposures)
        assert np.array_equal(once.frames, again.frames)
    other = render.expose(light, seed=2, sensor=sensor, exposures=exposures)
    assert (once.frames != other.frames).mean() > 0.5


def test_frame_taken_alone_equals_the_frame_in_the_stack(monkeypatch: pytest.MonkeyPatch) -> None:
    light = transport()
    # The stack is taken in blocks (the module is behind the function of its name), the frame at once.
    monkeypatch.setattr(sys.modules["render.exposure"], "BLOCK", 123)
    stack = render.expose(light, seed=6, sensor=Emva(psf="none"), exposures=[5.0, 9.0])
    for e, f in ((0, 0), (1, 0), (1, 7)):
        radiance = light.ambient.astype(float)
        for weight, channel in zip(light.bases[0].weights[f], light.total[0], strict=True):
            radiance += weight * channel
        alone = digital_numbers(radiance, stack.exposure_ms[e], Emva(psf="none"), Noise.of(6, e, f))
        assert np.array_equal(alone, stack.frames[e, f])


def test_without_noise_a_sample_is_its_clipped_and_rounded_mean() -> None:
    light = transport()
    sensor = Emva(prnu=0.1, dsnu_e=20.0, gain_dn_per_e=0.5, psf="none")
    stack = render.expose(light, sensor=sensor, exposures=[100.0, 3000.0], noise=False)
    assert stack.seed is None
    for e, time_ms in enumerate(stack.exposure_ms):
        mean = sensor.mean_dn(light.frames(), time_ms)
        full = sensor.black_level_dn + 0.5 * sensor.full_well_e
        expected = np.clip(np.minimum(mean, full), 0, 4095)
        # Half a DN of rounding, and the rounding of float32 radiance.
        assert np.abs(stack.frames[e] - expected).max() <= 0.5 + 1e-6 * 4095
    assert stack.frames[1].max() == 4095


def test_stack_records_sensor_patterns_times_and_seed() -> None:
    light = transport()
    patterns = PhaseShift(steps=5, periods_px=(16.0,))
    sensor = Emva(bits=10)
    stack = render.expose(
        light, seed=4, sensor=sensor, exposures=[2.0], patterns=patterns, direct_only=True
    )
    scene = scenes.parse(stack.scene)
    assert (scene.sensor, scene.patterns) == (sensor, patterns)
    assert scene.exposures.times_ms == stack.exposure_ms == (2.0,)
    assert (scene.sampling.samples, scene.sampling.depth) == (4, 1)
    assert stack.sensor == sensor
    assert stack.seed == 4
    assert stack.calibration == light.scene.calibration()
    assert stack.frames.shape == (1, 5, ROWS, COLUMNS)
    assert stack.frames.dtype == np.uint16


def test_images_of_one_chip_share_its_fixed_pattern_but_no_noise() -> None:
    light = transport()
    sensor = Emva(prnu=0.05, dsnu_e=0.0, bits=0, psf="none")
    first, again, other = (
        render.expose(
            light, seed=seed, sensor=sensor, exposures=[1.0], chip_seed=chip
        ).frames.astype(float)
        for seed, chip in ((1, 9), (2, 9), (1, 8))
    )
    clean = render.expose(light, sensor=sensor, exposures=[1.0], noise=False).frames.astype(float)
    # Where light is strong, what two pictures share is the chip's.
    lit = clean > np.median(clean)
    parts = [(frames / clean - 1.0)[lit] for frames in (first, again, other)]
    assert not np.array_equal(first, again)
    # Thousands of samples: a correlation's own standard error is below 0.02.
    same, apart = (np.corrcoef(parts[0], part)[0, 1] for part in parts[1:])
    assert same > apart + 0.1
    with pytest.raises(RenderError, match="chip_seed = -1"):
        render.expose(light, chip_seed=-1)
