"""Scores of reconstructions whose errors are known."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

import evaluation
from decode import Reconstruction
from scenes.support.errors import ScoreError
from tests.evaluation.synthetic_truth import TruthMaker

SHAPE = (20, 30)
REGION_KEYS = [
    "pixels",
    "coverage",
    "bias_mm",
    "rms_mm",
    "sd_mm",
    "median_abs_mm",
    "p95_abs_mm",
    "max_abs_mm",
    "outlier_fraction",
    "flagged_fraction",
    "predicted_sd_mm",
    "render_to_sensor_noise",
    "total_outlier_fraction",
    "total_sd_mm",
]
# Heights are float32: their rounding, relative.
ROUNDING = 2.0**-23


def reconstruction(
    height: ArrayLike, sigma: float = 0.01, valid: ArrayLike | None = None
) -> Reconstruction:
    rec = Reconstruction.of_heights(height, valid)
    return replace(rec, sigma_mm=np.full(rec.height_mm.shape, sigma, np.float32))


def test_scores_json_has_its_documented_keys(truth_of: TruthMaker, tmp_path: Path) -> None:
    truth = truth_of(np.zeros(SHAPE), {"base": True, "ink": False})
    path = tmp_path / "scores.json"
    evaluation.score(reconstruction(np.zeros(SHAPE)), truth).write(path)
    read = json.loads(path.read_text("utf-8"))
    assert list(read) == ["scene", "regions", "features", "unlit"]
    assert read["scene"] == "synthetic"
    assert list(read["regions"]) == ["base", "ink"]
    assert all(list(region) == REGION_KEYS for region in read["regions"].values())


def test_heights_invented_in_shadow_are_counted(truth_of: TruthMaker) -> None:
    lit = np.ones(SHAPE, bool)
    lit[:, :4] = False
    valid = np.ones(SHAPE, bool)
    valid[:15, :4] = False
    truth = truth_of(np.zeros(SHAPE), lit=lit)
    score = evaluation.score(reconstruction(np.zeros(SHAPE), valid=valid), truth)
    assert score.to_dict()["unlit"] == {"pixels": 4 * 20, "valid": 4 * 5}
    assert score.regions["base"].pixels == 26 * 20


def test_empty_region_has_no_figures(truth_of: TruthMaker) -> None:
    truth = truth_of(np.zeros(SHAPE), {"base": True, "ink": False})
    ink = evaluation.score(reconstruction(np.zeros(SHAPE)), truth).to_dict()["regions"]["ink"]
    assert ink.pop("pixels") == 0
    assert set(ink.values()) == {None}


def test_region_without_valid_pixels_has_no_statistics(truth_of: TruthMaker) -> None:
    ink = np.zeros(SHAPE, bool)
    ink[:5] = True
    truth = truth_of(np.zeros(SHAPE), {"base": True, "ink": ink})
    region = evaluation.score(reconstruction(np.zeros(SHAPE), valid=~ink), truth).regions["ink"]
    assert (region.pixels, region.coverage, region.flagged_fraction) == (150, 0.0, 1.0)
    assert region.bias_mm is region.rms_mm is region.sd_mm is region.max_abs_mm is None
    assert region.outlier_fraction is region.predicted_sd_mm is None


@settings(deadline=None)
@given(bias=st.floats(-1.0, 1.0), spread=st.floats(0.0, 1.0))
def test_statistics_are_those_of_the_errors_put_in(
    truth_of: TruthMaker, bias: float, spread: float
) -> None:
    # Half the pixels err by bias + spread, half by bias - spread: every figure has a closed form.
    sign = np.where(np.indices(SHAPE).sum(axis=0) % 2, 1.0, -1.0)
    region = evaluation.score(
        reconstruction(bias + spread * sign), truth_of(np.zeros(SHAPE))
    ).regions["base"]
    assert region.bias_mm == pytest.approx(bias, rel=4 * ROUNDING, abs=4 * ROUNDING)
    assert region.sd_mm == pytest.approx(spread, rel=4 * ROUNDING, abs=4 * ROUNDING)
    assert region.rms_mm == pytest.approx(
        np.hypot(bias, spread), rel=4 * ROUNDING, abs=4 * ROUNDING
    )
    assert region.max_abs_mm == pytest.approx(
        abs(bias) + spread, rel=4 * ROUNDING, abs=4 * ROUNDING
    )
    assert region.median_abs_mm == pytest.approx(
        max(abs(bias), spread), rel=4 * ROUNDING, abs=4 * ROUNDING
    )
    assert region.p95_abs_mm == pytest.approx(
        abs(bias) + spread, rel=4 * ROUNDING, abs=4 * ROUNDING
    )


def test_rejected_pixels_stay_out_of_the_statistics(truth_of: TruthMaker) -> None:
    height = np.zeros(SHAPE)
    bad = np.zeros(SHAPE, bool)
    bad[3:7] = True
    height[bad] = 8.0
    region = evaluation.score(reconstruction(height, valid=~bad), truth_of(np.zeros(SHAPE)))
    base = region.regions["base"]
    assert base.max_abs_mm == 0.0
    assert base.coverage == pytest.approx(1.0 - 4 / 20)
    assert base.flagged_fraction == pytest.approx(4 / 20)


def test_noise_of_light_is_compared_with_the_sensors(truth_of: TruthMaker) -> None:
    noise = np.full(SHAPE, 0.03, np.float32)
    noise[:, ::2] = 0.01
    noise[0] = np.nan  # Not known there.
    truth = replace(truth_of(np.zeros(SHAPE)), render_noise_mm=noise)
    base = evaluation.score(reconstruction(np.zeros(SHAPE), sigma=0.02), truth).regions["base"]
    # Root mean squares: sqrt((9 + 1) / 2) against 2.
    assert base.render_to_sensor_noise == pytest.approx(np.sqrt(5.0) / 2.0, rel=1e-6)


def test_outliers_are_counted_by_the_sensors_sigma_and_by_that_of_all_causes(
    truth_of: TruthMaker,
) -> None:
    error = np.zeros(SHAPE)
    error[:, 0::8], error[:, 1::8], error[:, 2::8] = 0.1, 0.1, 0.2
    rec = reconstruction(error, sigma=0.01)
    rec = replace(rec, cause_sigma_mm={"mixed": np.full(SHAPE, 0.03, np.float32)})
    base = evaluation.score(rec, truth_of(np.zeros(SHAPE))).regions["base"]
    # 0.1 mm is ten of the sensor's sigmas and 3.2 of all, 0.2 mm is 6.3 of all.
    assert base.outlier_fraction == pytest.approx((error > 0).mean())
    assert base.total_outlier_fraction == pytest.approx((error > 0.15).mean())
    assert base.total_sd_mm == pytest.approx(0.01 * np.sqrt(10.0), rel=1e-6)


def test_shadow_does_not_count_as_missed(truth_of: TruthMaker) -> None:
    lit = np.ones(SHAPE, bool)
    lit[:, 10:14] = False
    base = evaluation.score(
        reconstruction(np.zeros(SHAPE), valid=lit), truth_of(np.zeros(SHAPE), lit=lit)
    ).regions["base"]
    assert base.pixels == lit.sum()
    assert (base.coverage, base.flagged_fraction) == (1.0, 0.0)


def test_pixel_lit_by_one_of_two_projectors_is_scored(truth_of: TruthMaker) -> None:
    truth = truth_of(np.zeros(SHAPE), lit=False)
    first = np.zeros(SHAPE, bool)
    first[:, 5:] = True
    second = np.zeros(SHAPE, bool)
    second[:, :20] = True
    both = replace(truth, lit_by=np.stack([first, second]))
    assert evaluation.scored(both, "base").all()


def test_margin_removes_pixels_at_borders_and_keeps_those_at_the_frame(
    truth_of: TruthMaker,
) -> None:
    ink = np.zeros(SHAPE, bool)
    ink[8:14, 10:20] = True
    lit = np.ones(SHAPE, bool)
    lit[:3, :3] = False
    truth = truth_of(np.zeros(SHAPE), {"base": True, "ink": ink}, lit=lit)
    assert np.array_equal(evaluation.scored(truth, "ink"), truth.region("ink"))
    assert evaluation.scored(truth, "ink", 1).sum() == 4 * 8
    assert evaluation.scored(truth, "ink", 3).sum() == 0
    base = evaluation.scored(truth, "base", 1)
    grown = np.zeros(SHAPE, bool)
    grown[7:15, 9:21] = True
    grown[:4, :4] = True
    np.testing.assert_array_equal(base, ~grown)


def test_outlier_is_what_its_own_sigma_cannot_explain(truth_of: TruthMaker) -> None:
    height = np.zeros(SHAPE)
    height[0, :10] = 0.06
    height[0, 10:13] = 0.04
    truth = truth_of(np.zeros(SHAPE))
    rec = reconstruction(height, sigma=0.01)
    assert evaluation.score(rec, truth).regions["base"].outlier_fraction == pytest.approx(10 / 600)
    wider = evaluation.score(rec, truth, outlier_sigmas=3.0).regions["base"]
    assert wider.outlier_fraction == pytest.approx(13 / 600)
    fixed = evaluation.score(rec, truth, outlier_mm=0.1).regions["base"]
    assert fixed.outlier_fraction == 0.0


def test_sigma_of_all_causes_is_judged_next_to_the_sensors(truth_of: TruthMaker) -> None:
    height = np.zeros(SHAPE)
    height[0, :10], height[1, :4] = 0.06, 0.2
    truth = truth_of(np.zeros(SHAPE))
    rec = reconstruction(height, sigma=0.01)
    assert evaluation.score(rec, truth).regions["base"].total_outlier_fraction is None
    # sqrt(0.03^2 + 0.01^2) = 0.0316: five of it explain 0.06, not 0.2.
    causes = {"mixed": np.full(SHAPE, 0.03, np.float32), "stray": np.zeros(SHAPE, np.float32)}
    base = evaluation.score(replace(rec, cause_sigma_mm=causes), truth).regions["base"]
    assert base.outlier_fraction == pytest.approx(14 / 600)
    assert base.total_outlier_fraction == pytest.approx(4 / 600)
    assert base.total_sd_mm == pytest.approx(0.1**0.5 * 0.1)
    assert base.predicted_sd_mm == pytest.approx(0.01)


def test_outliers_below_the_truth_count_like_those_above(truth_of: TruthMaker) -> None:
    height = np.zeros(SHAPE)
    height[0, :7] = -0.06
    height[1, :5] = 0.06
    truth = truth_of(np.zeros(SHAPE))
    rec = reconstruction(height, sigma=0.01)
    assert evaluation.score(rec, truth).regions["base"].outlier_fraction == 12 / 600
    assert (
        evaluation.score(rec, truth, outlier_mm=0.05).regions["base"].outlier_fraction == 12 / 600
    )


def test_pixels_of_unknown_sigma_count_neither_way(truth_of: TruthMaker) -> None:
    rec = Reconstruction.of_heights(np.full(SHAPE, 0.5))
    base = evaluation.score(rec, truth_of(np.zeros(SHAPE))).regions["base"]
    assert base.outlier_fraction is base.predicted_sd_mm is None
    assert base.rms_mm == 0.5
    known = evaluation.score(rec, truth_of(np.zeros(SHAPE)), outlier_mm=0.1).regions["base"]
    assert known.outlier_fraction == 1.0


def test_predicted_sd_is_the_root_mean_square(truth_of: TruthMaker) -> None:
    rec = reconstruction(np.zeros(SHAPE))
    sigma = np.full(SHAPE, 0.03, np.float32)
    sigma[:, ::2] = 0.04
    base = evaluation.score(replace(rec, sigma_mm=sigma), truth_of(np.zeros(SHAPE))).regions["base"]
    assert base.predicted_sd_mm == pytest.approx(np.sqrt((0.03**2 + 0.04**2) / 2), rel=ROUNDING)


def test_sizes_that_differ_are_refused(truth_of: TruthMaker) -> None:
    with pytest.raises(ScoreError, match="30 x 20 pixels, the truth 12 x 10"):
        evaluation.score(reconstruction(np.zeros(SHAPE)), truth_of(np.zeros((10, 12))))


def test_senseless_parameters_are_refused(truth_of: TruthMaker) -> None:
    rec, truth = reconstruction(np.zeros(SHAPE)), truth_of(np.zeros(SHAPE))
    with pytest.raises(ScoreError, match="margin_px = -1"):
        evaluation.score(rec, truth, margin_px=-1)
    with pytest.raises(ScoreError, match="outlier_sigmas"):
        evaluation.score(rec, truth, outlier_sigmas=0.0)
    with pytest.raises(ScoreError, match="outlier_mm"):
        evaluation.score(rec, truth, outlier_mm=-0.1)
    with pytest.raises(ScoreError, match="no label 'bse': did you mean 'base'"):
        evaluation.scored(truth, "bse")
