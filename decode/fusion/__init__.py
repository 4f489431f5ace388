"""Rules that turn several exposures of a pixel into one phase."""

from decode.fusion.choosing import AutoExposureRule
from decode.fusion.interface import MERGED, FusionRule, Samples, Single, middle_exposure
from decode.fusion.registry import rule, rules

__all__ = [
    "MERGED", "AutoExposureRule", "FusionRule", "Samples", "Single", "middle_exposure", "rule", "rules",
]  # fmt: skip
