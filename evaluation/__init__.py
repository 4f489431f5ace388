"""Evaluation of reconstructions: scores, features, point clouds, figures. Renders nothing."""

from evaluation.hdr.capture_strategies import Strategy
from evaluation.hdr.strategy_lookup import strategies
from evaluation.inspection.pad_limits import (
    PadLimits,
    confusion,
    judge,
    pad_errors,
    threshold_shares,
)
from evaluation.inspection.pad_measurement import PadMeasure, measure_pads, measured_warp
from evaluation.inspection.repeatability import GaugeStudy, capability, gauge_study
from evaluation.inspection.spi_csv import read_spi_csv, write_spi_csv
from evaluation.output.cloud import normals, triangles, write_cloud
from evaluation.output.height_image import write_height_image
from evaluation.scoring.disparity import DisparityScore
from evaluation.scoring.error_budget import ErrorBudget
from evaluation.scoring.feature_fits import Feature, features, robust_fit
from evaluation.scoring.reference_bodies import FittedPlane, FittedSphere, fit_plane, fit_sphere
from evaluation.scoring.regions import height_error_mm, region_scores, score, scored
from evaluation.scoring.score_result import RegionScore, Score, UnlitScore
from evaluation.theory.clipping import SaturationBias, saturation_bias
from evaluation.theory.cramer_rao import Efficiency, FringeLight, efficiency, phase_bound_rad2

__all__ = [
    "DisparityScore", "Efficiency", "ErrorBudget", "Feature", "FittedPlane", "FittedSphere", "FringeLight",
    "GaugeStudy", "PadLimits", "PadMeasure", "RegionScore", "SaturationBias", "Score", "Strategy",
    "UnlitScore", "capability", "confusion", "efficiency", "features", "fit_plane", "fit_sphere",
    "gauge_study", "height_error_mm", "judge", "measure_pads", "measured_warp", "normals", "pad_errors",
    "phase_bound_rad2", "read_spi_csv", "region_scores", "robust_fit", "saturation_bias", "score",
    "scored", "strategies", "threshold_shares", "triangles", "write_cloud", "write_height_image",
    "write_spi_csv",
]  # fmt: skip

# Its name up to 0.1.
Limits = PadLimits
