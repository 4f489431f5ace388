"""Stack to reconstruction: phases, fringe orders, heights, and a reason for every rejected pixel."""

from decode.checks.stack_check import CheckReport, check
from decode.fusion.interface import FusionRule, Samples, middle_exposure
from decode.fusion.registry import rules
from decode.height.triangulation import triangulate
from decode.options import Options
from decode.phase.n_step import FringeSet, Phasor
from decode.pipeline import reconstruct, reconstruct_with
from decode.reason import Reason
from decode.reconstruction import AxisPhase, Reconstruction
from decode.stereo_phase import stereo
from scenes.support.finding import Finding

__all__ = [
    "AxisPhase", "CheckReport", "Finding", "FringeSet", "FusionRule", "Options", "Phasor", "Reason",
    "Reconstruction", "Samples", "check", "middle_exposure", "reconstruct", "reconstruct_with",
    "rules", "stereo", "triangulate",
]  # fmt: skip
