"""Which cause owns which millimetre: errors with causes switched off one at a time, and on one at a time.

Mean square errors of independent causes add. What they do not add up to is the interaction, and it is stated: a cause may
need another to do harm (noise hurts more where blur took the contrast), or hide it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.errors import ScoreError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Causes = frozenset[str]
"""Which causes are switched on."""


@dataclass(frozen=True)
class Share:
    """What one cause does in one region."""

    alone_mm2: float | None
    """Mean square error with this cause alone on, above that of none."""
    removed_mm2: float | None
    """Mean square error with all on, above that of all but this one; negative where the cause helped."""
    bias_alone_mm: float | None
    bias_removed_mm: float | None
    """Change of the mean error, likewise."""
    coverage_alone: float
    """Change of the share of pixels measured, likewise: a cause may cost pixels instead of accuracy."""
    coverage_removed: float


@dataclass(frozen=True)
class RegionBudget:
    """One region; None where no pixel is measured in every variant."""

    pixels: int
    common_pixels: int
    """Measured in every variant: the errors are over these, so that all are of the same places."""
    coverage: float
    """Share of the region measured with everything on."""
    total_mm2: float | None
    """Mean square error with everything on."""
    ideal_mm2: float | None
    """With everything off: what is left is the method's own."""
    interaction_mm2: float | None
    """``total - ideal - sum of the causes alone``."""
    causes: Mapping[str, Share]


@dataclass(frozen=True)
class Budget:
    """An error budget: `causes` of each region add up to its total, with what is ideal and the interaction."""

    scene: str
    causes: tuple[str, ...]
    absent: tuple[str, ...]
    """Causes that this scene does not have."""
    regions: Mapping[str, RegionBudget]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def variants(causes: Sequence[str]) -> list[Causes]:
    """The states a budget needs: all on, none on, each one off, each one on; each once.

    >>> [sorted(v) for v in variants(["blur", "noise"])]
    [['blur', 'noise'], [], ['noise'], ['blur']]
    """
    every = frozenset(causes)
    found = [every, frozenset(), *(every - {c} for c in causes), *(frozenset({c}) for c in causes)]
    return list(dict.fromkeys(found))


def budget(
    scene: str,
    causes: Sequence[str],
    errors: Mapping[Causes, Floats],
    regions: Mapping[str, Mask],
    absent: Sequence[str] = (),
) -> Budget:
    """The budget from errors in mm (repeat, row, col) of every one of `variants`, NaN where not measured.

    Regions are (row, col) masks. Raises `ScoreError` if a variant is missing.
    """
    missing = [sorted(v) for v in variants(causes) if v not in errors]
    if missing:
        raise ScoreError(f"errors of the variants {missing} are missing: a budget needs them all")
    common = np.logical_and.reduce([np.isfinite(e).all(axis=0) for e in errors.values()])
    return Budget(
        scene,
        tuple(causes),
        tuple(absent),
        {
            name: _region(causes, errors, region, common & region)
            for name, region in regions.items()
        },
    )


def _region(
    causes: Sequence[str], errors: Mapping[Causes, Floats], region: Mask, common: Mask
) -> RegionBudget:
    every: Causes = frozenset(causes)
    none: Causes = frozenset()
    covered = {
        v: float(np.isfinite(e[:, region]).mean()) if region.any() else 0.0
        for v, e in errors.items()
    }
    square: dict[Causes, float] | None = None
    bias: dict[Causes, float] | None = None
    if common.any():
        square = {v: float(np.mean(e[:, common] ** 2)) for v, e in errors.items()}
        bias = {v: float(np.mean(e[:, common])) for v, e in errors.items()}

    def change(of: dict[Causes, float] | None, on: Causes, off: Causes) -> float | None:
        return None if of is None else of[on] - of[off]

    shares = {
        cause: Share(
            change(square, frozenset({cause}), none),
            change(square, every, every - {cause}),
            change(bias, frozenset({cause}), none),
            change(bias, every, every - {cause}),
            covered[frozenset({cause})] - covered[none],
            covered[every] - covered[every - {cause}],
        )
        for cause in causes
    }
    interaction = None
    if square is not None:
        alone = sum(square[frozenset({cause})] - square[none] for cause in causes)
        interaction = square[every] - square[none] - alone
    return RegionBudget(
        int(region.sum()),
        int(common.sum()),
        covered[every],
        None if square is None else square[every],
        None if square is None else square[none],
        interaction,
        shares,
    )
