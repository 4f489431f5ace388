"""Reconstruction against truth: scores, features, clouds, figures. Renders nothing."""

from evaluation.cloud import write_cloud
from evaluation.features import Feature
from evaluation.saturation_bias import SaturationBias, saturation_bias
from evaluation.score import RegionScore, Score, height_error_mm, score, scored

__all__ = [
    "Feature",
    "RegionScore",
    "SaturationBias",
    "Score",
    "height_error_mm",
    "saturation_bias",
    "score",
    "scored",
    "write_cloud",
]
