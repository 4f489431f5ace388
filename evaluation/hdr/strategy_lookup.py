"""Strategies by name."""

from collections.abc import Sequence

import decode
from evaluation.hdr.capture_strategies import BUILT_IN, Strategy, ladder
from evaluation.hdr.coding_strategies import CODINGS
from evaluation.hdr.exposure_plans import PLANNED
from evaluation.hdr.projector_plans import PROJECTOR
from scenes.support.errors import ScoreError, nearest


def strategies(names: Sequence[str] | None = None) -> tuple[Strategy, ...]:
    """Strategies by name.

    Parameters
    ----------
    names
        Their names; None for all: the built-in ones, the codings, and every fusion rule of another distribution on the reference's
        exposures.

    Returns
    -------
    tuple of Strategy
        In the order of the names.

    Raises
    ------
    ScoreError
        For an unknown name or an empty list.

    Examples
    --------
    >>> [strategy.fusion for strategy in strategies(["single", "inverted"])]
    ['phasor-sum', 'masked-least-squares']
    """
    built_in = (*BUILT_IN, *PLANNED, *PROJECTOR, *CODINGS)
    known = {strategy.name: strategy for strategy in built_in}
    used = {strategy.fusion for strategy in BUILT_IN}
    for rule in sorted(set(decode.rules()) - used):
        known.setdefault(rule, Strategy(rule, ladder, rule, "another distribution's rule"))
    chosen = dict.fromkeys(known if names is None else names)
    if not chosen:
        raise ScoreError(
            f"no strategy is named: leave the choice out for all, or name some of {', '.join(known)}"
        )
    for name in chosen:
        if name not in known:
            raise ScoreError(f"unknown strategy '{name}': {nearest(name, known)}")
    return tuple(known[name] for name in chosen)
