"""How much of an opening's paste stays on the board: mean and scatter by area ratio, by package, and over a run of prints."""

from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, model_validator

from scenes.support.frozen import Frozen

# Spread of openings that empty wholly, and lumps of the transfer model.
FLOOR_CV = 0.05
LUMPS = 33.0
# Waves of the field that neighbours share.
FIELD_WAVES = 64


class TransferPoint(Frozen):
    """Statistics of deposits of one area ratio, as an inspection machine reports them."""

    area_ratio: PositiveFloat
    efficiency: Annotated[float, Field(ge=0.0, le=3.0)]
    """Mean transfer efficiency; above 1 where paste is pressed out under the stencil."""
    cv: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Coefficient of variation: standard deviation over mean."""


class Transfer(Frozen):
    """Share of an aperture's volume that stays on the board, by area ratio (IPC-7525: opening area over wall area).

    Without a table the mean is ``e = 1 - exp(-(ratio - onset) / scale)``. The defaults pass through the ends of the range
    that T. Lentz reports for laser-cut steel and Types 3-6 ("Size Matters", SMT007 Magazine, July 2019, p. 44), 5 % at
    0.30 and 60 % at 0.50, and through 80 % at 0.66, the industry's limit of acceptance at IPC-7525B's minimum area ratio,
    within 1 %. The coefficient of variation is ``sqrt(0.05^2 + (1 - e) / (33 e))``: 5 % between large openings, and the
    scatter of a share e of 33 lumps that each stay on the board or in the opening. 33 makes it 10 % at 0.66, the limit
    that print studies use (SMT007 Magazine, March 2018, p. 50). The form is a model: a table of one's own line is better.
    """

    onset: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.288
    """Area ratio up to which nothing transfers."""
    scale: PositiveFloat = 0.231
    table: tuple[TransferPoint, ...] = ()
    """Measured statistics, in rising order of area ratio; linear in between, constant beyond. It replaces both curves."""
    spread: Annotated[float, Field(ge=0.0, le=5.0)] = 1.0
    """Factor of the coefficient of variation; 0: every deposit has the mean."""
    neighbours: Annotated[float, Field(ge=0.0, le=1.0)] = 0.3
    """Share of the variance that neighbours have in common: pressure, stencil and board vary slowly over the print."""
    reach_mm: PositiveFloat = 5.0
    """Distance at which the common part's correlation is ``exp(-1/2)``."""
    across: Annotated[float, Field(gt=0.0, le=2.0)] = 1.0
    """Transfer of long openings across the stroke relative to those along it."""
    clogging: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Growth of the exponent of the mean per print since the stencil was wiped: small openings clog first."""
    prints_since_wipe: Annotated[int, Field(ge=0, le=1000)] = 0
    """At the first print of a run."""
    print_number: Annotated[int, Field(ge=0)] = 0
    """Prints made before this one in the run; `scenes.realise` adds the sample's number to it where `wipe_every` is given."""
    wipe_every: Annotated[int, Field(ge=0, le=1000)] = 0
    """Prints from one wipe of the stencil to the next; 0: it is not wiped."""
    after_wipe: Annotated[float, Field(gt=0.0, le=2.0)] = 1.0
    """Factor of the mean in the first print after a wipe: below 1 where the wipe draws paste out of the openings."""
    recovery_prints: PositiveFloat = 1.0
    """Prints in which what a wipe changed falls to 1/e."""
    mean: Annotated[float, Field(gt=0.0, le=3.0)] = 1.0
    """Factor of the mean."""

    @model_validator(mode="after")
    def _rising(self) -> Self:
        ratios = [point.area_ratio for point in self.table]
        if any(b <= a for a, b in pairwise(ratios)):
            raise ValueError(f"table: area ratios {ratios} must rise from row to row")
        return self

    @property
    def since_wipe(self) -> int:
        """Prints between the last wipe and this one."""
        count = self.prints_since_wipe + self.print_number
        return count % self.wipe_every if self.wipe_every else count

    def efficiency(self, area_ratio: float, slant: float = 0.0) -> float:
        """Mean transfer efficiency, 0 or more; `slant` is -1 for a line along the stroke, 1 for one across it."""
        if self.table:
            mean = self._interpolated(area_ratio, "efficiency")
        else:
            mean = float(-np.expm1(-max(area_ratio - self.onset, 0.0) / self.scale))
        # At most the whole opening clogs: an efficiency above 1 stays as it is.
        worn = mean ** (1.0 + self.clogging * self.since_wipe) if mean < 1.0 else mean
        wiped = 1.0 + (self.after_wipe - 1.0) * np.exp(-self.since_wipe / self.recovery_prints)
        return float(worn * wiped * self.mean * self.across ** max(slant, 0.0))

    def cv(self, area_ratio: float) -> float:
        """Coefficient of variation of the volume."""
        if self.table:
            return self.spread * self._interpolated(area_ratio, "cv")
        mean = max(self.efficiency(area_ratio), 1e-3)
        return self.spread * float(np.sqrt(FLOOR_CV**2 + (1.0 - min(mean, 1.0)) / (LUMPS * mean)))

    def factor(self, area_ratio: float, deviate: float) -> float:
        """A deposit's volume relative to the mean: log-normal, of mean 1 for standard normal deviates."""
        variance = float(np.log1p(self.cv(area_ratio) ** 2))
        return float(np.exp(np.sqrt(variance) * deviate - variance / 2.0))

    def common(self, xy_mm: tuple[float, float], rng: np.random.Generator) -> float:
        """The print's smooth field at a place: standard normal over prints, for the print's own random numbers."""
        phase = rng.uniform(0.0, 2.0 * np.pi, FIELD_WAVES)
        number = rng.standard_normal((FIELD_WAVES, 2)) / self.reach_mm
        return float(np.sqrt(2.0 / FIELD_WAVES) * np.cos(number @ np.asarray(xy_mm) + phase).sum())

    def _interpolated(self, area_ratio: float, name: Literal["efficiency", "cv"]) -> float:
        ratios = [point.area_ratio for point in self.table]
        return float(np.interp(area_ratio, ratios, [getattr(point, name) for point in self.table]))


class PackageTransfer(Frozen):
    """How deposits of one kind of part differ from all others."""

    mean: Annotated[float, Field(gt=0.0, le=3.0)] = 1.0
    """Factor of the mean."""
    spread: Annotated[float, Field(ge=0.0, le=5.0)] = 1.0
    """Factor of the coefficient of variation."""
    table: tuple[TransferPoint, ...] = ()
    """Its own statistics, as in `Transfer`; absent: those of all."""

    def of(self, transfer: Transfer) -> Transfer:
        """What is transferred to such parts where `transfer` holds for all."""
        return Transfer(
            **transfer.model_dump(exclude={"mean", "spread", "table"}),
            mean=transfer.mean * self.mean,
            spread=transfer.spread * self.spread,
            table=self.table or transfer.table,
        )
