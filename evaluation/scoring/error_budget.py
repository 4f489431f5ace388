"""Error budget: how much each cause contributes, by switching causes off and on one at a time.

Mean square errors of independent causes add. The rest is their interaction, which is reported: one cause may amplify another
(noise matters more where blur reduces the contrast), or mask it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.support.errors import ScoreError

Floats = NDArray[np.float64]
RENDER_NOISE = "render-noise"
Mask = NDArray[np.bool_]
Causes = frozenset[str]
"""Which causes are switched on."""
# A cause that exists only with another is measured together with it, and compared with that alone: a point would see the
# sharp squares that every pixel of a camera averages.
TOGETHER = {"projector-pixels": "footprint"}


@dataclass(frozen=True)
class CauseShare:
    """What one cause does in one region."""

    alone_mm2: float | None
    """Mean square error with only this cause on (and the one it needs, `TOGETHER`), minus that without it."""
    removed_mm2: float | None
    """Mean square error with all causes on, minus that of all but this one; negative where the cause reduces the error."""
    bias_alone_mm: float | None
    bias_removed_mm: float | None
    """Change of the mean error, likewise."""
    coverage_alone: float
    """Change of the share of measured pixels, likewise: a cause may cost pixels instead of accuracy."""
    coverage_removed: float


@dataclass(frozen=True)
class RegionBudget:
    """One region; None where no pixel is measured in every variant."""

    pixels: int
    common_pixels: int
    """Pixels measured in every variant; errors are over these, so that all variants are compared at the same places."""
    coverage: float
    """Share of the region measured with everything on."""
    total_mm2: float | None
    """Mean square error with everything on."""
    ideal_mm2: float | None
    """With everything off: the method's own error."""
    interaction_mm2: float | None
    """``total - ideal - sum of the causes alone``."""
    causes: Mapping[str, CauseShare]


@dataclass(frozen=True)
class ErrorBudget:
    """An error budget: in each region, the ideal error, the causes and the interaction add up to the total."""

    scene: str
    causes: tuple[str, ...]
    absent: tuple[str, ...]
    """Causes that this scene does not have."""
    regions: Mapping[str, RegionBudget]

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def variants(causes: Sequence[str]) -> list[Causes]:
    """Combinations of causes that a budget needs: all on, none on, each one off, each one on; each once.

    >>> [sorted(v) for v in variants(["blur", "noise"])]
    [['blur', 'noise'], [], ['noise'], ['blur']]
    """
    every = frozenset(causes)
    alone = [_needed(c, causes) | {c} for c in causes]
    return list(dict.fromkeys([every, frozenset(), *(every - {c} for c in causes), *alone]))


def _needed(cause: str, causes: Sequence[str]) -> Causes:
    """What is on when a cause is measured alone."""
    return frozenset(c for c in causes if c == TOGETHER.get(cause))


def budget(
    scene: str,
    causes: Sequence[str],
    errors: Mapping[Causes, Floats],
    regions: Mapping[str, Mask],
    absent: Sequence[str] = (),
    render_noise_mm: Mapping[Causes, NDArray[np.float32]] | None = None,
) -> ErrorBudget:
    """Compute the error budget from errors (repeat, row, col) in mm of all `variants`, NaN where not measured.

    `render_noise_mm` is, of each variant, the standard deviation of height from the noise of its light paths, (row, col).
    It cannot be switched off, but it is known: its square is taken out of each variant's mean square, and that of all
    causes together becomes a cause of its own. Raises `ScoreError` if a variant is missing.
    """
    noise = render_noise_mm or {}
    for known, what in ((errors, "errors"), (noise or errors, "render noise")):
        missing = [sorted(v) for v in variants(causes) if v not in known]
        if missing:
            raise ScoreError(
                f"{what} of the variants {missing} are missing: a budget needs them all"
            )
    common = np.logical_and.reduce([np.isfinite(e).all(axis=0) for e in errors.values()])
    found = {
        name: _region(causes, errors, noise, region, common & region)
        for name, region in regions.items()
    }
    if noise:
        return ErrorBudget(scene, (*causes, RENDER_NOISE), tuple(absent), found)
    return ErrorBudget(scene, tuple(causes), (*absent, RENDER_NOISE), found)


def _region(
    causes: Sequence[str],
    errors: Mapping[Causes, Floats],
    noise: Mapping[Causes, NDArray[np.float32]],
    region: Mask,
    common: Mask,
) -> RegionBudget:
    every: Causes = frozenset(causes)
    none: Causes = frozenset()
    covered = {
        v: float(np.isfinite(e[:, region]).mean()) if region.any() else 0.0
        for v, e in errors.items()
    }
    square: dict[Causes, float] | None = None
    bias: dict[Causes, float] | None = None
    rendered = None
    if common.any():
        own = {v: _mean_square(n[common]) for v, n in noise.items()}
        rendered = own.get(every)
        square = {v: float(np.mean(e[:, common] ** 2)) - own.get(v, 0.0) for v, e in errors.items()}
        bias = {v: float(np.mean(e[:, common])) for v, e in errors.items()}

    def change(of: dict[Causes, float] | None, on: Causes, off: Causes) -> float | None:
        return None if of is None else of[on] - of[off]

    shares = {}
    for cause in causes:
        without = _needed(cause, causes)
        alone = without | {cause}
        shares[cause] = CauseShare(
            change(square, alone, without),
            change(square, every, every - {cause}),
            change(bias, alone, without),
            change(bias, every, every - {cause}),
            covered[alone] - covered[without],
            covered[every] - covered[every - {cause}],
        )
    interaction = None
    if square is not None:
        interaction = (
            square[every] - square[none] - sum(s.alone_mm2 or 0.0 for s in shares.values())
        )
    if noise:
        change_of_mean = None if rendered is None else 0.0
        shares[RENDER_NOISE] = CauseShare(
            rendered, rendered, change_of_mean, change_of_mean, 0.0, 0.0
        )
    return RegionBudget(
        int(region.sum()),
        int(common.sum()),
        covered[every],
        None if square is None else square[every] + (rendered or 0.0),
        None if square is None else square[none],
        interaction,
        shares,
    )


def _mean_square(noise_mm: NDArray[np.float32]) -> float:
    """Over the pixels whose noise is known; 0 where none is."""
    known = noise_mm[np.isfinite(noise_mm)].astype(np.float64)
    return float(np.mean(known**2)) if known.size else 0.0
