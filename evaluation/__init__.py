"""Reconstruction against truth: scores, features, clouds, figures. Renders nothing."""

from evaluation.cloud import write_cloud
from evaluation.features import Feature
from evaluation.gauge import GaugeStudy, capability, gauge_study
from evaluation.pad_comparison import Limits, confusion, judge, pad_errors, threshold_shares
from evaluation.pads import PadMeasure, measure_pads
from evaluation.saturation_bias import SaturationBias, saturation_bias
from evaluation.score import RegionScore, Score, height_error_mm, score, scored

__all__ = [
    "Feature",
    "GaugeStudy",
    "Limits",
    "PadMeasure",
    "RegionScore",
    "SaturationBias",
    "Score",
    "capability",
    "confusion",
    "gauge_study",
    "height_error_mm",
    "judge",
    "measure_pads",
    "pad_errors",
    "saturation_bias",
    "score",
    "scored",
    "threshold_shares",
    "write_cloud",
]
