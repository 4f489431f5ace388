"""What a run of the gate found: judged figures, and what failed where."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from evaluation.gate.regression import Figures, JudgedFigure
from fringebench.gate.error_maps import ErrorMaps, WorstPixel
from fringebench.gate.wording import sentence, short_name


@dataclass(frozen=True)
class RegionFailure:
    """What failed in a region of a case."""

    worst: JudgedFigure
    where: str
    """Place of the worst figure in the image, in words."""
    others: tuple[str, ...] = ()
    """Other figures that failed there."""

    def sentence(self) -> str:
        """The worst figure, by how much and where, and the names of the others."""
        others = ", ".join(map(short_name, self.others))
        return sentence(self.worst, self.where) + (f"; failed too: {others}" if others else "")


@dataclass(frozen=True)
class Regression:
    """What a run of the gate found."""

    decoder: str
    baseline: str
    """Whose figures these were compared with."""
    seeds: tuple[int, ...]
    """Seeds of the noise, one decode each."""
    rows: tuple[JudgedFigure, ...]
    figures: dict[str, Figures] = field(repr=False)
    updated: bool = False
    """Whether the figures were stored as the new baseline."""
    places: Mapping[tuple[str, str, str], str] = field(default_factory=dict, repr=False)
    """(case, region, metric) of what failed -> where in the image, in words."""
    maps: Mapping[str, ErrorMaps] = field(default_factory=dict, repr=False, compare=False)
    """Error maps of each case."""
    baseline_maps: Mapping[str, ErrorMaps] = field(default_factory=dict, repr=False, compare=False)
    """Those of the baseline, for the cases that failed, where they are known."""
    worst: tuple[WorstPixel, ...] = field(default=(), repr=False)
    """The worst pixels of what failed, with what the camera saw there."""

    @property
    def failed(self) -> tuple[JudgedFigure, ...]:
        """Figures that got worse, or are not shown to have stayed the same."""
        return tuple(row for row in self.rows if not row.comparison.passed)

    @property
    def improved(self) -> tuple[JudgedFigure, ...]:
        """Figures that got better by more than the margin."""
        return tuple(row for row in self.rows if row.comparison.verdict == "better")

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return not self.failed

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "decoder": self.decoder,
            "baseline": self.baseline,
            "seeds": list(self.seeds),
            "passed": self.passed,
            "updated": self.updated,
            "rows": [self._plain(row) for row in self.rows],
            "worst_pixels": [asdict(pixel) for pixel in self.worst],
        }

    def _plain(self, row: JudgedFigure) -> dict[str, Any]:
        tree = asdict(row)
        for side in ("new", "old"):
            del tree[side]["values"]
        where = self.where(row)
        return tree | ({"where": where} if where else {})

    def where(self, row: JudgedFigure) -> str:
        """Place of a failed figure in the image, in words; empty where it passed."""
        return self.places.get((row.case, row.region, row.metric), "")

    def failures(self) -> tuple[RegionFailure, ...]:
        """What failed, by region, the worst first."""
        regions: dict[tuple[str, str], list[JudgedFigure]] = {}
        for row in sorted(self.failed, key=_rank, reverse=True):
            regions.setdefault((row.case, row.region), []).append(row)
        return tuple(
            RegionFailure(rows[0], self.where(rows[0]), tuple(row.metric for row in rows[1:]))
            for rows in regions.values()
        )

    def describe(self) -> str:
        """One line for each region in which a figure failed: case, region, how much, where."""
        return "\n".join(failure.sentence() for failure in self.failures())


def severity(row: JudgedFigure) -> float:
    """Upper end of a figure's change, in margins; above 1 it fails."""
    return row.comparison.upper / row.comparison.margin


def _rank(row: JudgedFigure) -> tuple[bool, bool, float]:
    """Order of failures: what is worse before what is undecided, errors before claims of sigma."""
    return row.comparison.verdict == "worse", "sigma" not in row.metric, severity(row)
