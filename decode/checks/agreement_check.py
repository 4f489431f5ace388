"""Whether what an axis shows agrees with itself, with the other axis, and with the calibration, once it is decoded."""

from collections.abc import Iterator

import numpy as np
from scipy import ndimage

from decode.checks.neighbour_check import disorder, jumps
from decode.checks.remedy import fitting_change
from decode.checks.scale_check import scales
from decode.height.calibrated_view import view_of
from decode.phase.n_step import fringe_sets
from decode.pipeline import reconstruct
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding, graded

# A phase that has nothing to do with the coarser one misses its order by more than a quarter period every other time.
RANDOM_MISMATCH = 0.2
# Share of the lit pixels that may disagree before it is warned of.
DISAGREE = 0.05
# Share of coordinates beyond the projector, together with all their neighbours, and what noise and gamma add at its border.
BEYOND, BORDER_PX = 0.001, 2.0


def agreement(stack: Stack, projector: int) -> Iterator[Finding]:
    """Decode each axis, and see whether its periods and its code agree."""
    for axis in dict.fromkeys(f.axis for f in stack.patterns if f.kind in ("fringe", "gray")):
        sources = {f.period_px for f in stack.patterns if f.kind == "fringe" and f.axis == axis}
        coded = any(f.kind == "gray" and f.axis == axis for f in stack.patterns)
        name = f"{axis}s, agreement"
        try:
            rec = reconstruct(stack, height="phase", axis=axis, projector=projector)
        except DecodeError as error:
            change = fitting_change(stack, axis, projector)
            yield Finding(name, "wrong", f"{error}; {change}" if change else str(error))
            continue
        yield from _order_of(stack, rec, projector)
        if len(sources) + coded < 2:
            yield Finding(
                name, "unknown", "one period, or a code alone: nothing to compare its order with"
            )
            continue
        seen = (rec.reason == Reason.OK) | (rec.reason == Reason.ORDER_MISMATCH)
        share = float((rec.reason[seen] == Reason.ORDER_MISMATCH).mean())
        verdict = graded(share, DISAGREE, RANDOM_MISMATCH)
        change = fitting_change(stack, axis, projector) if verdict != "ok" else ""
        # Another manifest fits where this one does not: codes with a margin agree with most phases by chance.
        verdict = "wrong" if change else verdict
        said = f"{share:.2%} of the lit pixels have periods{' and Gray code' if coded else ''} that disagree"
        if verdict == "wrong":
            said += ": a period, the direction of shift, the first phase or the order of frames is not as stated"
        elif verdict == "warning":
            said += (
                ": light that comes by way of other surfaces, or a manifest that is nearly right"
            )
        said += f"; {change}" if change else ""
        yield Finding(name, verdict, said, share)


def _order_of(stack: Stack, rec: Reconstruction, projector: int) -> Iterator[Finding]:
    """Whether the order of one axis is known, and neighbours agree about it."""
    axis, phase = rec.axis, rec.phases[rec.axis]
    if not rec.order_known:
        said = "the fringe order is known only up to whole turns, so heights may be off by whole fringes: "
        cells = {f.period_px for f in stack.patterns if f.kind == "gray" and f.axis == axis}
        if cells:
            said += (
                f"the Gray code's cells of {max(cells):g} px are wider than what the fringes are unique over: correct cell_px or "
                "a period"
            )
        else:
            said += "add a coarser period or Gray code"
        if stack.projector_size(projector) is None:
            said += ", or give projector_resolution if the periods beat beyond the projector's size"
        yield Finding(f"{axis}s, fringe order", "wrong" if cells else "warning", said)
    if axis in fringe_sets(stack.patterns, projector):
        yield from _range(stack, rec, projector)
        size = stack.projector_size(projector)
        width = None if size is None else size[0 if axis == "column" else 1]
        yield jumps(phase, rec.valid, width, f"{axis}s, neighbours")
        yield from scales(stack, rec, projector)
    calibration = stack.calibration
    if calibration is not None:
        rig, heights = view_of(calibration, projector).rig, calibration.height_range_mm
        yield from disorder(phase, rec.valid, rig, axis, heights, f"{axis}s, epipolar order")


def _range(stack: Stack, rec: Reconstruction, projector: int) -> Iterator[Finding]:
    """Whether the projector has the coordinates that its fringes give; nothing where its size or the order is unknown."""
    resolution = stack.projector_size(projector)
    if resolution is None or not rec.order_known or not rec.valid.any():
        return
    size = resolution[0 if rec.axis == "column" else 1]
    at = rec.phases[rec.axis].coordinate_px
    beyond = rec.valid & ((at < -BORDER_PX) | (at > size + BORDER_PX))
    # Order errors at edges and in the dark are anywhere, and single.
    share = float(ndimage.binary_erosion(beyond, np.ones((3, 3), np.bool_)).sum() / rec.valid.sum())
    said = f"{share:.2%} of the coordinates are beyond the projector's {size} px"
    if share > BEYOND:
        said += ": projector_resolution, a period, a first phase or an origin is not as stated"
    yield Finding(f"{rec.axis}s, range", "wrong" if share > BEYOND else "ok", said, share)
