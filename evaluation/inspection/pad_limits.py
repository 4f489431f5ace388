"""Measured pads against the truth: errors, verdicts at given limits, and the threshold's share."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from evaluation.inspection.pad_measurement import THRESHOLD_MM, PadMeasure
from scenes.board.board import Board
from scenes.board.printing import printed
from scenes.labels.pad_truth import BoardTruth, PadTruth
from scenes.support.errors import ScoreError
from scenes.support.frozen import Frozen

Verdict = Literal[
    "pass",
    "missing",
    "insufficient",
    "excess",
    "low-area",
    "high-area",
    "high",
    "offset",
    "bridge",
    "unmeasured",
]


class PadLimits(Frozen):
    """What an inspection accepts; percentages are of the aperture's area and of aperture area x stencil thickness."""

    volume_percent: tuple[float, float] = (50.0, 150.0)
    area_percent: tuple[float, float] = (60.0, 150.0)
    missing_percent: Annotated[float, Field(ge=0.0)] = 10.0
    """Volume below which a deposit counts as missing rather than insufficient."""
    peak_mm: Annotated[float, Field(gt=0.0)] = 0.25
    """Highest paste."""
    offset_percent: Annotated[float, Field(gt=0.0)] = 25.0
    """Farthest centre of volume, of the aperture's shorter side."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for name in ("volume_percent", "area_percent"):
            low, high = getattr(self, name)
            if not 0.0 <= low < high:
                raise ValueError(f"{name} {[low, high]}: give the lower limit, then the upper")
        return self


@dataclass(frozen=True)
class PadErrors:
    """Measured against true, over the pads that have both, relative where the name says percent."""

    pads: int
    unmeasured: int
    """Pads of the board without a measurement."""
    volume_bias_percent: float
    volume_sd_percent: float
    volume_max_percent: float
    """Largest absolute error."""
    area_bias_percent: float
    height_bias_mm: float
    """Of the mean height, which is volume over area."""
    offset_rms_mm: float
    """Root mean square distance between measured and true centre of volume."""


@dataclass(frozen=True)
class VerdictCounts:
    """Accept or reject, measured against true."""

    caught: int
    """Rejected, correctly."""
    escaped: int
    """Accepted, and should not have been."""
    false_calls: int
    """Rejected, and should not have been."""
    passed: int
    """Accepted, correctly."""


@dataclass(frozen=True)
class Confusion:
    """Verdicts of an inspection at given limits, against the truth."""

    gates: dict[str, VerdictCounts]
    """By verdict, and `any` for all together: the same limits applied to measured and to true figures."""
    verdicts: dict[str, dict[str, int]]
    """Defect that was printed (`good` for none) -> verdict -> pads; a pad with several defects counts under each."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return asdict(self)


def pad_errors(
    measured: Sequence[PadMeasure], board: BoardTruth, min_size_mm: float = 0.0
) -> PadErrors:
    """Errors of measured pads against the truth.

    Parameters
    ----------
    measured
        From `measure_pads`, of the same board.
    board
        Truth of every pad.
    min_size_mm
        Pads whose aperture is narrower than this are left out.

    Returns
    -------
    PadErrors
        Over the pads that were both printed and measured; percent of the true value, or mm.

    Raises
    ------
    ScoreError
        When the two are of different boards, or no pad is left.
    """
    pairs = [(m, t) for m, t in _pairs(measured, board) if min(t.size_mm) >= min_size_mm]
    both = [(m, t) for m, t in pairs if m.volume_mm3 and t.volume_mm3 > 0.0]
    if not both:
        raise ScoreError(
            f"no pad of {len(pairs)} was both printed and measured: there is no error to state"
        )
    volume = np.array([_relative(m.volume_mm3, t.volume_mm3) for m, t in both])
    area = np.array([_relative(m.area_mm2, t.area_mm2) for m, t in both])
    height = np.array([(m.mean_height_mm or 0.0) - t.mean_height_mm for m, t in both])
    offset = np.array(
        [
            (
                (m.offset_x_mm or 0.0) - (t.offset_x_mm or 0.0),
                (m.offset_y_mm or 0.0) - (t.offset_y_mm or 0.0),
            )
            for m, t in both
        ]
    )
    return PadErrors(
        len(both),
        sum(m.volume_mm3 is None for m, _ in pairs),
        float(volume.mean()),
        float(volume.std()),
        float(np.abs(volume).max()),
        float(area.mean()),
        float(height.mean()),
        float(np.sqrt((offset**2).sum(axis=1).mean())),
    )


def judge(pad: PadMeasure | PadTruth, nominal: PadTruth, limits: PadLimits) -> tuple[Verdict, ...]:
    """Every limit that a pad (measured or true) violates, worst first; ``("pass",)`` if there is none.

    Parameters
    ----------
    pad
        Its figures, mm.
    nominal
        The same pad's truth, of which only the aperture and nominal volume are read.
    limits
        What is accepted.

    Returns
    -------
    tuple of str
        Verdicts.
    """
    if pad.volume_mm3 is None or pad.area_mm2 is None or pad.peak_height_mm is None:
        return ("missing",) if isinstance(pad, PadMeasure) and pad.bare else ("unmeasured",)
    volume = 100.0 * pad.volume_mm3 / nominal.nominal_volume_mm3
    area = 100.0 * pad.area_mm2 / nominal.aperture_area_mm2
    if volume < limits.missing_percent:
        return ("missing",)
    found: list[Verdict] = []
    if pad.bridged_to:
        found.append("bridge")
    if volume < limits.volume_percent[0]:
        found.append("insufficient")
    if volume > limits.volume_percent[1]:
        found.append("excess")
    if area < limits.area_percent[0]:
        found.append("low-area")
    if area > limits.area_percent[1]:
        found.append("high-area")
    if pad.peak_height_mm > limits.peak_mm:
        found.append("high")
    offset = float(np.hypot(pad.offset_x_mm or 0.0, pad.offset_y_mm or 0.0))
    if 100.0 * offset > limits.offset_percent * min(nominal.size_mm):
        found.append("offset")
    return tuple(found) or ("pass",)


def confusion(
    measured: Sequence[PadMeasure], board: BoardTruth, limits: PadLimits | None = None
) -> Confusion:
    """Judge every pad, measured and true, at the same limits.

    Parameters
    ----------
    measured
        From `measure_pads`, of the same board.
    board
        Truth of every pad.
    limits
        What is accepted; by default `PadLimits()`.

    Returns
    -------
    Confusion
        Caught, escaped and falsely rejected pads for each limit, and verdicts for each printed defect.

    Raises
    ------
    ScoreError
        When the boards differ.
    """
    limits = limits or PadLimits()
    gates: dict[str, list[int]] = {}
    verdicts: dict[str, dict[str, int]] = {}
    names = [name for name in Verdict.__args__ if name not in ("pass", "unmeasured")]  # type: ignore[attr-defined]
    for pad, truth in _pairs(measured, board):
        seen, real = set(judge(pad, truth, limits)), set(judge(truth, truth, limits))
        for name in [*names, "any"]:
            said = bool(seen - {"pass"}) if name == "any" else name in seen
            true = bool(real - {"pass"}) if name == "any" else name in real
            place = {(True, True): 0, (False, True): 1, (True, False): 2, (False, False): 3}
            gates.setdefault(name, [0, 0, 0, 0])[place[said, true]] += 1
        for defect in truth.defects or ("good",):
            row = verdicts.setdefault(defect, {})
            for name in seen:
                row[name] = row.get(name, 0) + 1
    return Confusion({name: VerdictCounts(*counts) for name, counts in gates.items()}, verdicts)


def threshold_shares(
    board: Board, threshold_mm: float = THRESHOLD_MM
) -> dict[int, tuple[float, float]]:
    """Share of paste above a threshold, in closed form from the meshes: the small-pad bias of an ideal machine.

    Parameters
    ----------
    board
        The board, with everything drawn from its seed.
    threshold_mm
        Height above the pad from which paste counts, mm.

    Returns
    -------
    dict
        Pad id -> shares of its (area, volume) above the threshold, 0 to 1. Pads without paste are left out.
    """
    shares = {}
    for deposit in printed(board).deposits:
        if deposit.field is not None:
            area, volume = deposit.field.above(threshold_mm)
            shares[deposit.pad.id] = (
                area / deposit.field.area_mm2,
                volume / deposit.field.volume_mm3,
            )
    return shares


def _pairs(measured: Sequence[PadMeasure], board: BoardTruth) -> list[tuple[PadMeasure, PadTruth]]:
    truth = {pad.pad: pad for pad in board.pads}
    if {pad.pad for pad in measured} != truth.keys():
        raise ScoreError(
            f"{len(measured)} pads were measured, the truth has {len(truth)}, and they are not the same: "
            "compare a board with its own truth"
        )
    return [(pad, truth[pad.pad]) for pad in measured]


def _relative(measured: float | None, true: float) -> float:
    """Error in percent."""
    return 100.0 * ((measured or 0.0) / true - 1.0)
