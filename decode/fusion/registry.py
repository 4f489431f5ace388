"""Fusion rules by name: the built-in ones, and those of other distributions.

Another distribution adds a rule by an entry point of group ``fringebench.fusion`` that names a `FusionRule` subclass::

    [project.entry-points."fringebench.fusion"]
    my-rule = "my_package:MyRule"
"""

from collections.abc import Callable
from importlib.metadata import EntryPoints, entry_points

from decode.fusion.censored_likelihood import CensoredMl
from decode.fusion.choosing import AutoExposureRule, BrightestUnsaturated
from decode.fusion.interface import FusionRule, MaxModulation, Single
from decode.fusion.least_squares import InverseVariance, MaskedLeastSquares
from decode.fusion.merging import PhasorSum, RadianceMerge
from scenes.support.errors import DecodeError, nearest

ENTRY_POINT_GROUP = "fringebench.fusion"

RULES: dict[str, Callable[[], FusionRule]] = {
    "single": Single,
    "auto-exposure": AutoExposureRule,
    "brightest-unsaturated": BrightestUnsaturated,
    "max-modulation": MaxModulation,
    "radiance-merge": RadianceMerge,
    "phasor-sum": PhasorSum,
    "inverse-variance": InverseVariance,
    "masked-least-squares": MaskedLeastSquares,
    "censored-ml": CensoredMl,
}


def rules() -> tuple[str, ...]:
    """Names of all fusion rules: the built-in ones, then those of other distributions."""
    return tuple(RULES) + tuple(sorted({point.name for point in _foreign()} - RULES.keys()))


def rule(name: str) -> FusionRule:
    """The fusion rule of that name. Raises `DecodeError` for an unknown name or a broken entry point."""
    if name in RULES:
        return RULES[name]()
    for point in _foreign():
        if point.name == name:
            try:
                found = point.load()()
            except Exception as error:  # A package outside the project may raise anything.
                raise DecodeError(
                    f"fusion rule '{name}' ({point.value}) cannot be loaded: {error}"
                ) from error
            if not isinstance(found, FusionRule):
                raise DecodeError(
                    f"fusion rule '{name}' ({point.value}) gives a {type(found).__name__}: "
                    "the entry point must name a subclass of decode.FusionRule"
                )
            return found
    raise DecodeError(f"unknown fusion rule '{name}': {nearest(name, rules())}")


def _foreign() -> EntryPoints:
    return entry_points(group=ENTRY_POINT_GROUP)
