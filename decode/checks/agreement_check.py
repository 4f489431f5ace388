"""Whether what an axis shows agrees with itself, with the other axis, and with the calibration, once it is decoded."""

from collections.abc import Iterator

import numpy as np

from decode.checks.neighbour_check import disorder, jumps
from decode.checks.remedy import fitting_change
from decode.checks.scale_check import scales
from decode.height.calibrated_view import view_of
from decode.phase.n_step import fringe_sets
from decode.pipeline import reconstruct
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding, graded

# A phase that has nothing to do with the coarser one misses its order by more than a quarter period every other time.
RANDOM_MISMATCH = 0.2
# Share of the lit pixels that may disagree before it is warned of.
DISAGREE = 0.05
# Share of coordinates beyond the projector, and what noise and gamma add at its border.
BEYOND, BORDER_PX = 0.01, 2.0
# Points of a good calibration meet the other axis to a pixel; a wrong one misses by tens.
EPIPOLAR_PX = (2.0, 8.0)
# Share of points outside the working volume that no stray light makes.
AWAY = 0.5


def agreement(stack: Stack, projector: int) -> Iterator[Finding]:
    """Decode each axis, and see whether its periods and its code agree; then compare the axes with each other."""
    if stack.calibration is not None and stack.calibration.screens:
        said = "the rig has a screen: only what mirrors it shows an order"
        yield Finding("agreement", "unknown", said)
        return
    decoded: dict[Axis, Reconstruction] = {}
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
        decoded[axis] = rec
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
    if stack.calibration is not None and decoded:
        yield _in_space(stack, projector)


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
        yield jumps(phase, rec.valid, f"{axis}s, neighbours")
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
    at = rec.phases[rec.axis].coordinate_px[rec.valid]
    share = float(((at < -BORDER_PX) | (at > size + BORDER_PX)).mean())
    said = f"{share:.2%} of the coordinates are beyond the projector's {size} px"
    if share > BEYOND:
        said += ": projector_resolution, a period, a first phase or an origin is not as stated"
    yield Finding(f"{rec.axis}s, range", "wrong" if share > BEYOND else "ok", said, share)


def _in_space(stack: Stack, projector: int) -> Finding:
    """Points must be in the volume; the point that one axis gives must show the other axis' coordinate, whatever the surface."""
    assert stack.calibration is not None
    name = "calibration"
    try:
        rec = reconstruct(stack, projector=projector)
    except DecodeError as error:
        return Finding(name, "wrong", f"no height comes out of it: {error}")
    every = max(1, int(np.sqrt(rec.valid.size / 100_000)))
    at = (slice(None, None, every), slice(None, None, every))
    away = float((rec.reason == Reason.OUT_OF_VOLUME).sum())
    away /= max(float(rec.valid.sum()) + away, 1.0)
    if away > AWAY:
        said = (
            f"{away:.0%} of the points lie outside the working volume: the calibration is not this rig's, an axis is "
            "mirrored, or the volume is wrong"
        )
        return Finding(name, "wrong", said, away)
    other: Axis = "row" if rec.axis == "column" else "column"
    if other not in rec.phases:
        return Finding(name, "ok", f"{away:.0%} of the points lie outside the working volume", away)
    valid = rec.valid[at]
    if valid.sum() < 100:
        return Finding(name, "unknown", "too few points to compare rows and columns")
    camera = stack.calibration.camera.projection()
    points = camera.points_at(rec.height_mm[at][valid], camera.pixel_centres()[at][valid])
    light = stack.calibration.projectors[projector].projection()
    seen = light.project(points)[0]
    pixels = seen[:, 0 if other == "column" else 1]
    miss = np.abs(pixels - rec.phases[other].coordinate_px[at][valid])
    middle = float(np.nanmedian(miss))
    verdict = graded(middle, *EPIPOLAR_PX)
    said = f"points from the {rec.axis}s miss their {other} by {middle:.2f} projector px (median)"
    if verdict != "ok":
        said += ": the calibration is not this rig's, or an axis is mirrored"
    return Finding(name, verdict, said, middle)
