import numpy as np
import pytest

from evaluation.scoring.error_budget import budget, variants
from scenes.support.errors import ScoreError

CAUSES = ("blur", "noise", "tilt")
SHAPE = (50, 60)


def errors_of(on: frozenset[str]) -> np.ndarray:
    """Independent errors of 3 (blur, alternating), 4 (noise) and a bias of 2 (tilt); the method's own is 1."""
    rng = np.random.default_rng(3)
    total = np.ones((8, *SHAPE))
    if "blur" in on:
        total += 3.0 * np.where(np.arange(SHAPE[1]) % 2, 1.0, -1.0)
    if "noise" in on:
        total += 4.0 * rng.standard_normal(total.shape)
    if "tilt" in on:
        total += 2.0 * np.where(np.arange(SHAPE[0]) < 25, 1.0, -1.0)[:, None]
    return total


def test_independent_causes_add_up_without_interaction() -> None:
    made = {v: errors_of(v) for v in variants(CAUSES)}
    found = budget("s", CAUSES, made, {"all": np.ones(SHAPE, bool)}).regions["all"]
    # A mean of 24000 squares of standard deviation 4: relative error sqrt(2/24000); and products with the bias of 1.
    slack = 4 * (16 * np.sqrt(2 / 24000) + 2 * 4 / np.sqrt(24000))
    for cause, expected in (("blur", 9.0), ("noise", 16.0), ("tilt", 4.0)):
        share = found.causes[cause]
        assert share.alone_mm2 == pytest.approx(expected, abs=slack)
        assert share.removed_mm2 == pytest.approx(expected, abs=3 * slack)
    assert found.ideal_mm2 == pytest.approx(1.0)
    assert abs(found.interaction_mm2 or 0) < 3 * slack
    parts = sum(s.alone_mm2 or 0 for s in found.causes.values())
    assert parts + (found.ideal_mm2 or 0) + (found.interaction_mm2 or 0) == pytest.approx(
        found.total_mm2
    )


def test_errors_are_compared_on_pixels_that_every_variant_measures() -> None:
    made = {v: errors_of(v) for v in variants(CAUSES)}
    for v, e in made.items():
        if "noise" in v:
            e[0, :, :30] = np.nan
    region = np.ones(SHAPE, bool)
    found = budget("s", CAUSES, made, {"all": region, "gone": np.zeros(SHAPE, bool)})
    assert found.regions["all"].common_pixels == region.sum() // 2
    assert found.regions["all"].causes["noise"].coverage_alone == pytest.approx(-0.5 / 8)
    assert found.regions["gone"].total_mm2 is None


def test_missing_variant_is_named() -> None:
    made = {v: errors_of(v) for v in variants(CAUSES)[:-1]}
    with pytest.raises(ScoreError, match="tilt"):
        budget("s", CAUSES, made, {})


def test_squares_of_a_projector_are_measured_as_pixels_of_a_camera_see_them() -> None:
    causes = ("footprint", "projector-pixels")
    # Points would see 5 of the squares, pixels, with their own 2, see 1 (RMS).
    squares = {(): 0.0, causes[:1]: 2.0, causes[1:]: 5.0, causes: np.sqrt(5.0)}
    made = {frozenset(v): np.full((1, *SHAPE), rms) for v, rms in squares.items()}
    found = budget("s", causes, made, {"all": np.ones(SHAPE, bool)}).regions["all"]
    assert found.causes["projector-pixels"].alone_mm2 == pytest.approx(1.0)
    assert found.interaction_mm2 == pytest.approx(0.0)


def test_render_noise_of_each_variant_is_taken_out_of_its_error() -> None:
    causes = ("footprint", "interreflection")
    # RMS errors of the causes, and of the light's own noise, which here comes with a pixel's width, not with indirect light.
    own = {(): 0.0, causes[:1]: 3.0, causes[1:]: 0.0, causes: 3.0}
    real = {(): 1.0, causes[:1]: 2.0, causes[1:]: np.sqrt(6.0), causes: 3.0}
    errors = {frozenset(v): np.full((1, *SHAPE), np.hypot(real[v], own[v])) for v in own}
    noise = {frozenset(v): np.full(SHAPE, rms, np.float32) for v, rms in own.items()}
    found = budget("s", causes, errors, {"all": np.ones(SHAPE, bool)}, (), noise).regions["all"]
    alone = {c: share.alone_mm2 for c, share in found.causes.items()}
    assert alone == pytest.approx({"footprint": 3.0, "interreflection": 5.0, "render-noise": 9.0})
    assert found.total_mm2 == pytest.approx(18.0)
    assert found.interaction_mm2 == pytest.approx(0.0)
    with pytest.raises(ScoreError, match=r"render noise.*footprint"):
        budget("s", causes, errors, {}, (), {frozenset(): noise[frozenset()]})
