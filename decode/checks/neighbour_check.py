"""Whether neighbouring pixels agree about the fringe order: jumps of whole periods, and order along epipolar lines.

Agreement of code and phase shows nothing where the code's cells are as wide as the period: a code shifted by half a period
then gives half of the pixels the order of the neighbouring fringe, and reversed fringes jump by two periods from cell to cell.
Such errors are of whole periods, come at the same phases in every fringe, and reverse the order of coordinates along an
epipolar line, which no opaque surface does. Fringes whose origin is wrong pass from the projector's last pixel to its first.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from decode.height.rig_geometry import Rig
from decode.phase.n_step import TURN
from decode.reconstruction import AxisPhase
from decode.validity.epipolar_order import image_lead
from scenes.acquisition.patterns import Axis
from scenes.support.finding import Finding, graded

Turns = NDArray[np.float64]

# Distance from a whole period within which a jump counts as one, and from smooth within which neighbours do, in periods.
NEAR = 1.0 / 8.0
# Share of neighbouring pixels. An order error at one boundary of each fringe of 100 px, the widest in use, makes 1 %.
JUMPS = (0.002, 0.01)
# Jumps of a wrong code come at one or two phases; at edges of parts they come at any: a resultant length of 0.5 is beyond
# chance. Of two phases, one of the first four harmonics is at least 0.7 long, whatever lies between them.
CONCENTRATED, HARMONICS = 0.5, (1, 2, 3, 4)
# Share of the fringes in view that show jumps: a wrong code affects them all, an edge those it crosses.
FRINGES = 0.5
FEWEST = 100
# Neighbours on both ends of the projector: a depth step would have to lie at both edges of the light.
FEWEST_ENDS = 20
# Share of pixels out of order along epipolar lines; wires and leads in the air reach a few per cent.
DISORDER = (0.1, 0.3)


def jumps(phase: AxisPhase, valid: NDArray[np.bool_], size_px: float | None, name: str) -> Finding:
    """Share of smooth neighbours whose order jumps by whole periods, beyond what edges of parts make; or from one end to
    the other of a projector of `size_px` (None: not known).
    """
    turns = phase.order + phase.wrapped_rad / TURN
    pairs, excess_pairs, ends, at, orders = 0, 0.0, 0, [], []
    for image, good, wrapped in (
        (turns, valid, phase.wrapped_rad),
        (turns.T, valid.T, phase.wrapped_rad.T),
    ):
        step, smooth = _steps(image, good)
        size = np.abs(step)
        pairs += int(smooth.sum())
        off = np.abs(size - np.round(size))
        whole = smooth & (off < NEAR) & (size > 0.5)
        # Between whole periods there are only the edges of parts; half a period has one whole one beside it.
        between = smooth & (off > 0.5 - NEAR) & (size > 0.25)
        excess_pairs += whole.sum() - between.sum() + 0.5 * (between & (size < 1.0)).sum()
        row, column = np.nonzero(whole)
        at.append(wrapped[row, column + 2])
        orders.append(np.floor(image[row, column + 2]))
        if size_px is not None:
            sides = np.sort([image[row, column + 2], image[row, column + 3]], axis=0)
            ends += int(((sides[0] < 1.0) & (sides[1] > size_px / phase.period_px - 1.0)).sum())
    if pairs < FEWEST:
        return Finding(name, "unknown", "too few pixels have valid neighbours")
    excess = float(max(excess_pairs, 0.0)) / pairs
    if ends > FEWEST_ENDS:
        said = (
            f"{ends} smooth neighbours see the projector's first and last {phase.period_px:g} px: a first phase, an origin or a "
            "period is not as stated"
        )
        return Finding(name, "wrong", said, ends / pairs)
    phases, fringes = np.concatenate(at), np.concatenate(orders)
    if excess > JUMPS[0] and _systematic(phases, fringes, turns[valid]):
        said = (
            f"{excess:.2%} of smooth neighbours differ by whole periods of {phase.period_px:g} px, at the same phase in "
            "every fringe: the code is shifted against the fringes (origin_px, cell_px), or a phase, direction or period is "
            "not as stated"
        )
        return Finding(name, graded(excess, *JUMPS), said, excess)
    return Finding(name, "ok", f"{excess:.2%} of smooth neighbours differ by whole periods", excess)


def _steps(turns: Turns, good: NDArray[np.bool_]) -> tuple[Turns, NDArray[np.bool_]]:
    """Step between neighbours along rows beyond the local slope, in periods, and where both sides are smooth."""
    if turns.shape[1] < 6:
        nothing = np.zeros((turns.shape[0], 0))
        return nothing, nothing.astype(np.bool_)
    step = np.diff(turns, axis=1)
    count = step.shape[1]
    sides = np.stack([step[:, k : count - 4 + k] for k in (0, 1, 3, 4)])
    slope = np.median(sides, axis=0)
    smooth = (np.abs(sides - slope) < NEAR).all(axis=0)
    for k in range(6):
        smooth &= good[:, k : good.shape[1] - 5 + k]
    return step[:, 2 : count - 2] - slope, np.asarray(smooth)


def _systematic(phases: NDArray[np.floating], fringes: Turns, seen: Turns) -> bool:
    """Whether jumps come at the same phases, in most of the fringes in view."""
    together = max(abs(np.exp(1j * k * phases).mean()) for k in HARMONICS)
    _, counts = np.unique(np.floor(seen), return_counts=True)
    in_view = int((counts > counts.max() / 10).sum())
    return bool(together > CONCENTRATED and len(np.unique(fringes)) >= FRINGES * in_view)


def disorder(
    phase: AxisPhase,
    valid: NDArray[np.bool_],
    rig: Rig,
    axis: Axis,
    heights_mm: tuple[float, float],
    name: str,
) -> Iterator[Finding]:
    """Share of valid pixels whose coordinate decreases along its epipolar line by more than half a period; nothing for
    inclined lines.
    """
    lead = image_lead(rig, axis, heights_mm, valid.shape)
    if lead is None:
        return
    along, sign = lead
    at = np.where(valid, sign * phase.coordinate_px, np.nan)
    good = valid
    if along == 1:
        at, good = at.T, good.T
    margin = 0.5 * phase.period_px
    before = np.fmax.accumulate(np.where(good, at, -np.inf), axis=1)
    after = np.fmin.accumulate(np.where(good, at, np.inf)[:, ::-1], axis=1)[:, ::-1]
    # A thin part in front puts the background behind it out of order, or itself: the smaller of the two counts.
    fewer = np.minimum(
        (good & (at < before - margin)).sum(axis=1), (good & (at > after + margin)).sum(axis=1)
    )
    if good.sum() < FEWEST:
        yield Finding(name, "unknown", "too few valid pixels")
        return
    share = float(fewer.sum() / good.sum())
    verdict = graded(share, *DISORDER)
    said = f"{share:.2%} of the pixels are out of order along the epipolar lines"
    if verdict != "ok":
        said += ": fringe orders are wrong, or the calibration is not this rig's"
    yield Finding(name, verdict, said, share)
