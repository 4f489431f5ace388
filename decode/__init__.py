"""Stack to reconstruction: phases, fringe orders, heights, and a reason for every rejected pixel."""

from decode.fusion import FusionRule, Samples, middle_exposure
from decode.options import Options
from decode.phase import FringeSet, Phasor
from decode.pipeline import reconstruct
from decode.reconstruction import AxisPhase, Reconstruction
from decode.registry import rules
from decode.validity import Reason

__all__ = [
    "AxisPhase",
    "FringeSet",
    "FusionRule",
    "Options",
    "Phasor",
    "Reason",
    "Reconstruction",
    "Samples",
    "middle_exposure",
    "reconstruct",
    "rules",
]
