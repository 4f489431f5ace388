"""The budget charges each error to its cause, on scenes that have one cause each."""

import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from fringebench.experiments.cause_budget import CAUSES, budget
from scenes.support.errors import FringebenchError, RenderError

SMALL = {"camera.resolution": [120, 90], "sampling.samples": 16}
# One exposure far from saturation, direct light.
PLAIN = {
    **SMALL,
    "sampling.depth": 1,
    "exposures.relative": [1.0],
    "sensor": {"kind": "simple", "bits": 12, "sigma_dn": 20.0},
}


def rms(square: float | None) -> float:
    assert square is not None
    return float(np.sqrt(square))


def test_pixels_without_footprint_see_the_phase_of_their_centres() -> None:
    scene = scenes.load("step", {**SMALL, "sampling.depth": 1})
    transport, truth = render.trace(scene, footprint=0.0), render.truth(scene)
    cos, sin = transport.total[0, 1], transport.total[0, 2]
    lit = truth.lit_by[0]
    period = transport.bases[0].channels[1].period_px
    phase = 2 * np.pi * truth.columns_px[0] / period
    error = np.angle(np.exp(1j * (np.arctan2(sin, cos) - phase)))[lit]
    # float32 coordinates; and the rare ray that meets an edge
    assert np.percentile(np.abs(error), 99) < 1e-3
    with pytest.raises(RenderError, match="footprint"):
        render.trace(scene, footprint=1.5)


def test_noise_alone_equals_the_predicted_sigma() -> None:
    scene = scenes.load("step", PLAIN)
    found = budget(scene, repeats=8).regions["base"]
    transport, truth = render.trace(scene, footprint=0.0), render.truth(scene)
    rec = decode.reconstruct(render.expose(transport))
    base = evaluation.scored(truth, "base") & rec.valid
    predicted = float(np.sqrt(np.mean(rec.sigma_mm[base] ** 2)))
    # 8 x some 8000 heights: 4 standard deviations of a standard deviation are 1.1 %; modulation is noisy in sigma too.
    assert rms(found.causes["noise"].alone_mm2) == pytest.approx(predicted, rel=0.03)


def test_causes_of_an_unsaturated_scene_interact_little() -> None:
    """With fringes ten pixels wide: width takes contrast, by which noise grows, from narrower ones."""
    wide = {**PLAIN, "patterns.periods_px": [64.0, 1024.0]}
    found = budget(scenes.load("step", wide), repeats=8)
    assert set(CAUSES) - set(found.absent) == {"noise", "quantisation", "saturation", "footprint"}
    for label in ("base", "step"):
        region = found.regions[label]
        assert region.total_mm2 is not None
        assert abs(region.interaction_mm2 or 0) < 0.1 * region.total_mm2
        assert region.causes["quantisation"].alone_mm2 == pytest.approx(
            0, abs=1e-3 * region.total_mm2
        )
        assert region.causes["saturation"].coverage_removed == 0.0


@pytest.mark.parametrize(
    ("cause", "name", "overrides", "label"),
    [
        ("gamma", "step", {**PLAIN, "sensor.sigma_dn": 0.5, "projectors.0.gamma": 2.2, "patterns.steps": 3}, "base"),
        ("render-noise", "interreflection", {**SMALL, "sampling.samples": 8, "sensor.psf": "none"}, "left"),
        ("quantisation", "step", {**PLAIN, "sensor.bits": 4, "sensor.sigma_dn": 0.01, "exposures.auto.level_dn": 6.0}, "base"),
    ],
)  # fmt: skip
def test_dominant_cause_has_the_largest_share(
    cause: str, name: str, overrides: dict[str, object], label: str
) -> None:
    found = budget(scenes.load(name, overrides), repeats=2).regions[label]
    alone = {c: s.alone_mm2 or 0.0 for c, s in found.causes.items()}
    assert max(alone, key=lambda c: alone[c]) == cause
    assert (found.causes[cause].removed_mm2 or 0) > 0.3 * (found.total_mm2 or 0)


def test_pixels_bits_and_gamma_of_a_projector_have_rows_of_their_own() -> None:
    """From so near that five camera pixels see one of the projector, whose column they find to half a pixel."""
    quiet = {**PLAIN, "sensor.sigma_dn": 0.01, "sensor.bits": 16, "exposures.auto.label": "step"}
    near = {**quiet, "camera.fx_px": 153_600.0, "camera.fy_px": 153_600.0}
    rows = {}
    for bits in (5, 16):
        scene = scenes.load("step", {**near, "projectors.0.bits": bits})
        found = budget(scene, repeats=1)
        assert "gamma" in found.absent
        rows[bits] = found.regions["step"].causes
    squares = [rms(rows[bits]["projector-pixels"].alone_mm2) for bits in (5, 16)]
    points = np.array([[0.0, 0.0, 1.5], [0.01, 0.0, 1.5], [0.0, 0.0, 1.51]])
    columns = scene.projectors[0].projection().project(points)[0][:, 0]
    width_mm = (300.0 - 1.5) / 153_600.0 * 640 / 120
    width_px = width_mm * (columns[1] - columns[0]) / 0.01
    # Fourier's series of a sawtooth of half a pixel, averaged over the width that a camera pixel sees.
    k = np.arange(1, 2000)
    column_px = np.sqrt(np.sum(np.sinc(k * width_px) ** 2 / (2.0 * np.pi**2 * k**2)))
    expected = column_px * 0.01 / abs(columns[2] - columns[0])
    # Some 23 sawteeth are seen, the last cut anywhere: 1/23 of their square.
    assert squares == pytest.approx([expected, expected], rel=0.03)
    assert squares[0] == pytest.approx(squares[1], rel=0.05)
    # Squares err by up to half a projector pixel, rounding by less than a level of 2 ** bits: 16 bits are 2 ** 11 times finer
    # than 5.
    fine = rms(abs(rows[16]["projector-quantisation"].alone_mm2 or 0.0))
    assert fine < squares[1] / 50
    assert rms(rows[5]["projector-quantisation"].alone_mm2) > 20 * fine


def test_squares_that_pixels_average_are_not_charged_for_render_noise() -> None:
    """Squares seen whole by every pixel, traced with few paths: what scatters is light, and no cause of the scene."""
    scene = scenes.load("step", {**SMALL, "projectors.0.pixels": True})
    found = budget(scene, repeats=2).regions["base"]
    causes = found.causes
    noise = causes["render-noise"].alone_mm2 or 0.0
    assert noise > 0.3 * (found.total_mm2 or 0.0)
    # Stated noise is right to 15 % in its deviation, a third in its square.
    for cause in ("interreflection", "projector-pixels"):
        assert abs(causes[cause].alone_mm2 or 0.0) < noise / 3


def test_vibration_alone_scatters_heights_by_061_of_it() -> None:
    few = {"camera.resolution": [60, 45], "sensor.sigma_dn": 0.01}
    scene = scenes.load("step", {**PLAIN, **few, "vibration_um": 5.0})
    found = budget(scene, repeats=24).regions["step"].causes["vibration"]
    # 24 repeats of about three independent displacements each: RMS known to 8 %.
    assert rms(found.alone_mm2) == pytest.approx(np.sqrt(3 / 8) * 5e-3, rel=0.25)


def test_bit_planes_alone_err_as_their_phases_do() -> None:
    """Eight planes in sequence, four steps, exposures of 2.5 frames that start anywhere: 0.0576 rad, by plain calculation."""
    few = {"camera.resolution": [60, 45], "sensor.sigma_dn": 0.01, "exposures": {"times_ms": [5.0]}}
    planes = {"projectors.0.bits": 8, "projectors.0.frame_ms": 2.0, "projectors.0.triggered": False}
    scene = scenes.load("step", {**PLAIN, **few, **planes})
    found = budget(scene, repeats=12).regions["step"].causes
    heights = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]])
    columns, _ = scene.projectors[0].projection().project(heights)
    fringe_mm = 16.0 / (2.0 * np.pi) / abs(float(np.diff(columns[:, 0])[0]))
    # 12 repeats of four starts each: RMS known to about 15 %.
    assert rms(found["bit-planes"].alone_mm2) == pytest.approx(0.0576 * fringe_mm, rel=0.3)
    assert rms(found["projector-quantisation"].alone_mm2) < rms(found["bit-planes"].alone_mm2) / 10


def test_causes_of_a_camera_are_found_in_its_scene() -> None:
    scene = scenes.load(
        "step",
        {
            **SMALL,
            "sensor.psf": "diffraction",
            "camera.vignetting": [-0.3],
            "projectors.0.fluctuation": 0.01,
            "exposures.relative": [1.0],
        },
    )
    found = budget(scene, repeats=2)
    assert {"psf", "vignetting", "source", "interreflection"} <= set(found.causes)
    base = found.regions["base"].causes
    # A gain that differs by 1 % between four steps: phase errors of 0.01 / sqrt(2 x 4) and, through the mean, twice that.
    assert rms(base["source"].alone_mm2) > 5 * rms(abs(base["vignetting"].alone_mm2 or 0.0))


def test_a_conveyor_errs_at_edges_along_its_way() -> None:
    few = {"camera.resolution": [160, 120], "sampling.samples": 4, "sensor.sigma_dn": 0.01}
    scene = scenes.load("step", {**PLAIN, **few, "conveyor_um": [100.0, 0.0]})
    regions = budget(scene, repeats=1).regions
    # A block of 1.5 mm whose edges move by 1.1 mm in 12 pictures, a pixel for every two, and a plate that looks the same.
    step, base = (regions[name].causes["conveyor"] for name in ("step", "base"))
    assert rms(step.alone_mm2) > 2 * rms(base.alone_mm2)
    assert step.coverage_alone < base.coverage_alone < 0.0


def test_defocus_acts_through_noise_by_lowering_contrast() -> None:
    """It moves no fringe: alone it does little, but removing it removes most of the noise it lets in.

    On the step of 9 mm one pixel of seven is measured, next to edges, and what blur does there outweighs noise.
    """
    found = budget(scenes.load("defocus", {**SMALL, "sampling.samples": 256}), repeats=4).regions[
        "step-6mm"
    ]
    defocus = found.causes["defocus"]
    assert (defocus.removed_mm2 or 0) > 2 * abs(defocus.alone_mm2 or 0)
    assert (found.interaction_mm2 or 0) > 0.3 * (found.total_mm2 or 0)


def test_ignored_saturation_is_attributed_to_saturation() -> None:
    trap = scenes.load("chapter-trap", {"camera.resolution": [200, 150], "sampling.samples": 16})
    found = budget(trap, repeats=2, fusion="single", saturation="ignore").regions["highlight"]
    clipped = found.causes["saturation"]
    others = [s.alone_mm2 or 0 for c, s in found.causes.items() if c not in ("saturation", "noise")]
    assert (clipped.alone_mm2 or 0) > 3 * max(others)
    # The chapter's 0.1087 mm RMS is noise and saturation together; 0.094 to 0.109 with shading.
    assert 0.07 < rms(clipped.alone_mm2) < 0.12


def test_rows_that_see_the_next_pattern_have_a_row_of_their_own() -> None:
    """Where every row sees the next of four patterns for a share s, phases turn by up to about s: more, the later the row."""
    shutter = {
        "sensor": {"kind": "emva1288", "psf": "none", "row_time_us": 40.0, "read_noise_e": 0.0}
    }
    few = {**SMALL, **shutter, "camera.resolution": [60, 45], "sampling.depth": 1, "exposures": {"times_ms": [2.0]}}  # fmt: skip
    found = {}
    for overhead_ms in (0.0, 5.0):
        scene = scenes.load("step", {**few, "acquisition.overhead_ms": overhead_ms})
        budgeted = budget(scene, repeats=1)
        assert "rolling-shutter" not in budgeted.absent
        found[overhead_ms] = budgeted.regions["base"].causes["rolling-shutter"].alone_mm2 or 0.0
    # 45 rows take 1.8 ms: less than the overhead of 5 ms, before which no pattern changes.
    assert found[5.0] == 0.0
    assert found[0.0] > (10e-3) ** 2


def test_zero_repeats_are_refused() -> None:
    with pytest.raises(FringebenchError, match="repeats"):
        budget(scenes.load("step"), repeats=0)
    assert len(set(CAUSES)) == len(CAUSES) == 17
