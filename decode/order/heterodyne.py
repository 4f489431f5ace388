"""Heterodyne: from close fringe periods to a coarse, unambiguous one, and down again by the safest steps.

The difference of two fringes' phases is the phase of their beat, period ``1 / |1/P1 - 1/P2|`` (Gushov & Solodkin 1991,
Reich, Ritter & Thesing 1997); differences of beats beat again. A `Rung` is any such sum of measured phases with whole
coefficients, small ones where they serve. A ladder starts at a rung as wide as what is known beforehand (a Gray cell, the working volume, the
projector) and ends at the finest measured fringe; among all ladders it is the one whose worst step is the least likely to
slip a fringe: a step from period Pa to Pb multiplies the phase noise of the upper rung by Pa / Pb.
"""

import heapq
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd, hypot, inf, sqrt

from decode.device import Device, Lanes
from decode.phase.n_step import TURN

# Coefficients of one phase in beats, and in beats of beats.
COEFFICIENTS = (0, 1, -1, 2, -2)
# Periods without a common factor are unique over their product, which takes larger ones (number-theoretic unwrapping, Gushov &
# Solodkin 1991). They multiply the noise: such a ladder is taken where no other is wide enough, and its worst step slips a fringe
# at 1 / 128 of a turn or more. So many of the quietest wide rungs are tried.
LARGEST, WORST_SLIP, MOST_WIDE = {2: 40, 3: 10}, 64.0, 40
# Periods computed from fringe counts are rounded in their last digits, and so are their beats: a beat counts as wide as what
# it misses by this part.
ROUNDING = 1e-9
# More than these many periods would make the search slow, and are not used in practice.
MOST_SETS = 5


@dataclass(frozen=True)
class Rung:
    """A phase made of measured ones: sum of ``coefficient * phase`` over `terms`."""

    period_px: float
    terms: tuple[tuple[int, int], ...]
    """(index of the fringe set, coefficient), zeros left out."""

    @property
    def noise(self) -> float:
        """Standard deviation in units of one set's."""
        return sqrt(sum(c * c for _, c in self.terms))

    def phase(self, device: Device, phases: Sequence[Lanes]) -> Lanes:
        """The rung's phase in [-pi, pi] from the wrapped phases of the fringe sets, as lanes."""
        index, coefficient = self.terms[0]
        if len(self.terms) == 1 and coefficient == 1:
            return phases[index]
        total = sum(c * phases[i] for i, c in self.terms)
        return total - TURN * device.dr.round(total * (1.0 / TURN))


def single(periods_px: Sequence[float]) -> tuple[Rung, ...]:
    """The measured fringes themselves, coarsest first."""
    return tuple(Rung(period, ((i, 1),)) for i, period in enumerate(periods_px))


def ladder(periods_px: Sequence[float], width_px: float) -> tuple[Rung, ...] | None:
    """The safest ladder from a rung of at least `width_px` to the last period; None if there is none.

    `periods_px` are the measured ones, coarsest first. Where the coarsest is wide enough, all of them in turn are the
    ladder: that is what a hierarchy was made for.

    >>> [round(rung.period_px, 6) for rung in ladder((100.0, 200 / 3), 150.0)]
    [200.0, 100.0, 66.666667]
    """
    width_px *= 1.0 - ROUNDING
    if periods_px[0] >= width_px:
        return single(periods_px)
    if len(periods_px) > MOST_SETS:
        return None
    near = _rungs(periods_px)
    return _safest(near, width_px) or _safest(
        [*near, *_wide_rungs(periods_px, near)], width_px, WORST_SLIP
    )


def _safest(rungs: Sequence[Rung], width_px: float, limit: float = inf) -> tuple[Rung, ...] | None:
    """Ladder of smallest worst step, then fewest steps: Dijkstra's search with the maximum in place of the sum."""
    last = max(index for rung in rungs for index, _ in rung.terms)
    goal = next(i for i, r in enumerate(rungs) if r.terms == ((last, 1),))
    queue = [(0.0, 0, i) for i, rung in enumerate(rungs) if rung.period_px >= width_px]
    before: dict[int, int | None] = {i: None for _, _, i in queue}
    best = {i: (0.0, 0) for _, _, i in queue}
    heapq.heapify(queue)
    while queue:
        worst, steps, i = heapq.heappop(queue)
        if i == goal:
            return _path(rungs, before, i)
        if (worst, steps) > best[i]:
            continue
        for j, lower in enumerate(rungs):
            if lower.period_px >= rungs[i].period_px:
                continue
            slip = hypot(rungs[i].period_px / lower.period_px * rungs[i].noise, lower.noise)
            cost = (max(worst, slip), steps + 1)
            if cost[0] <= limit and cost < best.get(j, (inf, 0)):
                best[j], before[j] = cost, i
                heapq.heappush(queue, (*cost, j))
    return None


def widest_px(periods_px: Sequence[float]) -> float:
    """Longest range over which any sum of the phases is unique, px.

    >>> round(widest_px((48.0, 1920 / 41)))
    1920
    """
    if len(periods_px) > MOST_SETS:
        return max(periods_px)
    near = _rungs(periods_px)
    widths = sorted({rung.period_px for rung in _wide_rungs(periods_px, near)}, reverse=True)
    wide = (width for width in widths if ladder(periods_px, width) is not None)
    return next(wide, max(rung.period_px for rung in near))


def _wide_rungs(periods_px: Sequence[float], near: Sequence[Rung]) -> list[Rung]:
    """The quietest rungs of large coefficients that are wider than the others."""
    largest = LARGEST.get(len(periods_px), 0)
    widest = max(rung.period_px for rung in near) * (1.0 + ROUNDING)
    found = _rungs(periods_px, range(-largest, largest + 1), widest)
    return sorted(found, key=lambda rung: rung.noise)[:MOST_WIDE]


def _rungs(
    periods_px: Sequence[float], coefficients: Sequence[int] = COEFFICIENTS, wider_px: float = 0.0
) -> list[Rung]:
    found: dict[float, Rung] = {}
    for factors in itertools.product(coefficients, repeat=len(periods_px)):
        frequency = sum(c / period for c, period in zip(factors, periods_px, strict=True))
        finest = 1.0 / periods_px[-1]
        if not 1e-6 * finest <= frequency <= finest * (1.0 + 1e-9) or frequency * wider_px > 1.0:
            continue
        if gcd(*factors) != 1:
            continue
        rung = Rung(1.0 / frequency, tuple((i, c) for i, c in enumerate(factors) if c))
        key = round(frequency / finest, 9)
        if key not in found or rung.noise < found[key].noise:
            found[key] = rung
    return list(found.values())


def _path(rungs: Sequence[Rung], before: dict[int, int | None], last: int) -> tuple[Rung, ...]:
    path = []
    at: int | None = last
    while at is not None:
        path.append(rungs[at])
        at = before[at]
    return tuple(reversed(path))
