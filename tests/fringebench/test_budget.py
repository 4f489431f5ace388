"""The budget charges each error to its cause, on scenes that have one cause each."""

import numpy as np
import pytest

import decode
import evaluation
import render
import scenes
from fringebench.budget import CAUSES, budget
from scenes.errors import FringebenchError, RenderError

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


def test_pixels_without_width_see_the_phase_of_their_centres() -> None:
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


def test_noise_alone_is_what_the_decoder_predicts() -> None:
    scene = scenes.load("step", PLAIN)
    found = budget(scene, repeats=8).regions["base"]
    transport, truth = render.trace(scene, footprint=0.0), render.truth(scene)
    rec = decode.reconstruct(render.expose(transport))
    base = evaluation.scored(truth, "base") & rec.valid
    predicted = float(np.sqrt(np.mean(rec.sigma_mm[base] ** 2)))
    # 8 x some 8000 heights: 4 standard deviations of a standard deviation are 1.1 %; modulation is noisy in sigma too.
    assert rms(found.causes["noise"].alone_mm2) == pytest.approx(predicted, rel=0.03)


def test_causes_of_an_unsaturated_scene_hardly_interact() -> None:
    """With fringes ten pixels wide: width takes contrast, by which noise grows, from narrower ones."""
    wide = {**PLAIN, "patterns.periods_px": [64.0, 1024.0]}
    found = budget(scenes.load("step", wide), repeats=8)
    assert set(found.absent) == {"interreflection", "defocus", "gamma"}
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
        ("interreflection", "interreflection", {**SMALL, "sampling.samples": 64}, "left"),
        ("quantisation", "step", {**PLAIN, "sensor.bits": 4, "sensor.sigma_dn": 0.01, "exposures.auto.level_dn": 6.0}, "base"),
    ],
)  # fmt: skip
def test_the_cause_that_a_scene_is_made_of_owns_the_most(
    cause: str, name: str, overrides: dict[str, object], label: str
) -> None:
    found = budget(scenes.load(name, overrides), repeats=2).regions[label]
    alone = {c: s.alone_mm2 or 0.0 for c, s in found.causes.items()}
    assert max(alone, key=lambda c: alone[c]) == cause
    assert (found.causes[cause].removed_mm2 or 0) > 0.3 * (found.total_mm2 or 0)


def test_defocus_shows_as_noise_for_it_takes_contrast() -> None:
    """It moves no fringe: alone it does little, but removing it removes most of the noise it lets in."""
    found = budget(scenes.load("defocus", {**SMALL, "sampling.samples": 64}), repeats=4).regions[
        "step-9mm"
    ]
    defocus = found.causes["defocus"]
    assert (defocus.removed_mm2 or 0) > 2 * abs(defocus.alone_mm2 or 0)
    assert (found.interaction_mm2 or 0) > 0.3 * (found.total_mm2 or 0)


def test_ignored_saturation_is_charged_to_saturation() -> None:
    trap = scenes.load("chapter-trap", {"camera.resolution": [200, 150], "sampling.samples": 16})
    found = budget(trap, repeats=2, fusion="single", saturation="ignore").regions["highlight"]
    clipped = found.causes["saturation"]
    others = [s.alone_mm2 or 0 for c, s in found.causes.items() if c not in ("saturation", "noise")]
    assert (clipped.alone_mm2 or 0) > 3 * max(others)
    # The chapter's 0.1087 mm RMS is noise and saturation together; 0.094 to 0.109 with shading.
    assert 0.07 < rms(clipped.alone_mm2) < 0.12


def test_impossible_repeats_are_refused_and_every_cause_is_known() -> None:
    with pytest.raises(FringebenchError, match="repeats"):
        budget(scenes.load("step"), repeats=0)
    assert len(set(CAUSES)) == len(CAUSES) == 7
