"""Whether a stack's frames are what its patterns say: order, period, direction, response, saturation, calibration.

Every check reports what it measured and what follows from it. What a stack cannot show (three steps of one period fit any
order) is reported as unknown, never left out. `check` is for other people's captures: a rendered stack passes by construction.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from decode.checks.flicker import flicker_findings
from decode.checks.gray_check import flats, gray_code
from decode.checks.neighbour_check import disorder, jumps
from decode.checks.remedy import fitting_change
from decode.checks.scale_check import scales
from decode.codings.rewriting import as_fringes
from decode.height.calibrated_view import view_of
from decode.order.gray_cells import gray_sets
from decode.phase.gamma import TOLERANCE, Harmonics, clearest, harmonics
from decode.phase.n_step import FringeSet, fringe_sets
from decode.pipeline import reconstruct
from decode.reason import Reason
from decode.reconstruction import Reconstruction
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding, graded

# Two exchanged frames of four leave a residual of half the modulation, of eight a quarter; a gamma of 2.2 leaves 0.2, most
# of it a second harmonic, which is subtracted.
MISFIT = 0.2
# A phase that has nothing to do with the coarser one misses its order by more than a quarter period every other time.
RANDOM_MISMATCH = 0.2
# Share of the pixels that one cause may cost before the capture is worth repeating.
LOST = 0.05
# Points of a good calibration meet the other axis to a pixel; a wrong one misses by tens.
EPIPOLAR_PX = (2.0, 8.0)
# Share of points outside the working volume that no stray light makes.
AWAY = 0.5
LINEARITY = (0.03, 0.3)


@dataclass(frozen=True)
class CheckReport:
    """All findings about a stack."""

    findings: tuple[Finding, ...]

    @property
    def wrong(self) -> tuple[Finding, ...]:
        """Findings that no capture of these patterns can have."""
        return tuple(f for f in self.findings if f.verdict == "wrong")

    def raise_if_wrong(self) -> None:
        """Raise `DecodeError` with every reason why the stack is not what it claims to be."""
        if self.wrong:
            raise DecodeError(
                "the frames are not what the patterns state:\n"
                + "\n".join(f"  {f.name}: {f.message}" for f in self.wrong)
            )

    def to_dict(self) -> dict[str, list[dict[str, str | float | None]]]:
        """In JSON's types."""
        return {"findings": [vars(f) for f in self.findings]}


def check(
    stack: Stack, resolution: tuple[int, int] | None = None, projector: int = 0
) -> CheckReport:
    """Look at one projector's frames, and report whether they show what the patterns state.

    Parameters
    ----------
    stack
        Frames (exposure, frame, row, col) in DN.
    resolution
        The projector's (columns, rows); None: the stack's.
    projector
        Index of the projector.

    Returns
    -------
    CheckReport
        One finding for each thing that was checked.

    Raises
    ------
    DecodeError
        The patterns give neither phase nor code.

    Examples
    --------
    >>> report = check(stack)  # doctest: +SKIP
    >>> report.raise_if_wrong()  # doctest: +SKIP
    """
    if resolution is not None and stack.calibration is None:
        stack = replace(stack, projector_resolution=resolution)
    resolution = resolution or stack.projector_size(projector)
    found = [*_saturation(stack), *_exposures(stack)]
    try:
        plain = as_fringes(stack)
    except DecodeError as error:
        return CheckReport((*found, Finding("codings", "wrong", str(error))))
    stack = plain.stack
    rewritten = {axis for p, axis in plain.sigma_factor if p == projector}
    for axis, sets in fringe_sets(stack.patterns, projector).items():
        if axis in rewritten:
            said = "every frame serves the one fit of all: see agreement"
            found.append(Finding(f"{axis} fringes, order", "unknown", said))
            continue
        for fringes in sets:
            found += _fringes(stack, fringes)
        found += flicker_findings(stack, projector, axis)
    codes = gray_sets(stack.patterns, projector)
    for gray in codes.values():
        found += gray_code(stack, gray, resolution)
    if codes:
        found += flats(stack, next(iter(codes.values())))
    found += _agreement(stack, projector)
    return CheckReport(tuple(found))


def _saturation(stack: Stack) -> Iterator[Finding]:
    shortest = int(np.argmin(stack.exposure_ms))
    share = float((stack.frames[shortest].max(axis=0) >= stack.saturation_dn).mean())
    yield Finding(
        "saturation",
        "warning" if share > LOST else "ok",
        f"{share:.2%} of the pixels reach {stack.saturation_dn:g} DN in the shortest exposure"
        + ("; expose less" if share > LOST else ""),
        share,
    )


def _exposures(stack: Stack) -> Iterator[Finding]:
    """Digital numbers above black against exposure time, between neighbouring exposures."""
    order = np.argsort(stack.exposure_ms)
    black = stack.sensor.black_level_dn
    for one, two in pairwise(order):
        low = stack.frames[one].max(axis=0).astype(np.float64) - black
        high = stack.frames[two].max(axis=0).astype(np.float64) - black
        usable = (high + black < stack.saturation_dn) & (low > 0.05 * stack.frames.max())
        name = f"exposures {stack.exposure_ms[one]:g} and {stack.exposure_ms[two]:g} ms"
        if usable.sum() < 100:
            yield Finding(
                name, "unknown", "too few pixels are bright in one and unsaturated in both"
            )
            continue
        wanted = stack.exposure_ms[two] / stack.exposure_ms[one]
        off = float(np.median(high[usable] / low[usable])) / wanted - 1.0
        verdict = graded(abs(off), *LINEARITY)
        said = f"brightness grows {1 + off:.3f} times as much as exposure time"
        if verdict != "ok":
            said += "; check exposures_ms, their order, dark_dn, and gamma in the camera"
        yield Finding(name, verdict, said, off)


def _fringes(stack: Stack, fringes: FringeSet) -> Iterator[Finding]:
    name = f"{fringes.axis} fringes of {fringes.period_px:g} px"
    exposure = clearest(stack, fringes)
    seen = harmonics(stack, fringes, exposure)
    if not np.isfinite(seen.residual):
        yield Finding(
            name, "wrong", "no fringes are seen: fewer than a thousand pixels are modulated"
        )
        return
    if len(fringes.frames) == 3:
        yield Finding(
            f"{name}, order", "unknown", "three steps fit a sinusoid in any order: see agreement"
        )
    else:
        yield _order(stack, fringes, exposure, seen, f"{name}, order")
    if not np.isfinite(seen.gamma):
        yield Finding(f"{name}, gamma", "unknown", "too few fringes in view to measure harmonics")
        return
    said = f"second harmonic {seen.second:+.3f} of the first, as of gamma {seen.gamma:.2f}"
    known = stack.gamma
    bent = seen.bent if known is None else abs(seen.gamma - known) > TOLERANCE
    if known is not None:
        said += f"; the stack states {known:.2f}, which decoding undoes"
    elif bent:
        said += "; decode with gamma='estimate', or linearise projector and camera"
    yield Finding(f"{name}, gamma", "warning" if bent else "ok", said, seen.gamma)


def _order(stack: Stack, fringes: FringeSet, exposure: int, seen: Harmonics, name: str) -> Finding:
    """Least-squares residual, beyond noise and the second harmonic; if large, the exchange of frames that removes it."""
    misfit = _misfit(seen)
    if misfit <= MISFIT:
        said = f"samples differ from a sinusoid by {misfit:.3f} of the modulation, beyond noise and gamma"
        return Finding(name, "ok", said, misfit)
    repairs: list[str] = []
    for i, j in combinations(range(len(fringes.frames)), 2):
        frames = list(fringes.frames)
        frames[i], frames[j] = frames[j], frames[i]
        other = FringeSet(fringes.axis, fringes.period_px, tuple(frames), fringes.shifts_rad)
        if _misfit(harmonics(stack, other, exposure)) < MISFIT:
            repairs.append(f"{i} and {j}")
    hint = "exchanging two frames does not help"
    if repairs:
        hint = f"exchanging steps {' or '.join(repairs)} removes it"
    said = f"samples differ from a sinusoid by {misfit:.2f} of the modulation; {hint}: correct the frames' order or steps"
    return Finding(name, "wrong", said, misfit)


def _misfit(seen: Harmonics) -> float:
    """Residual that neither noise nor the second harmonic explains."""
    explained = seen.noise**2 + seen.second_residual**2
    return float(np.sqrt(max(seen.residual**2 - explained, 0.0)))


def _agreement(stack: Stack, projector: int) -> Iterator[Finding]:
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
        verdict = graded(share, LOST, RANDOM_MISMATCH)
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
        said = (
            "the fringe order is known only up to whole turns, so heights may be off by whole fringes: add a coarser period "
            "or Gray code"
        )
        if stack.projector_size(projector) is None:
            said += ", or give projector_resolution if the periods beat beyond the projector's size"
        yield Finding(f"{axis}s, fringe order", "warning", said)
    if axis in fringe_sets(stack.patterns, projector):
        yield jumps(phase, rec.valid, f"{axis}s, neighbours")
        yield from scales(stack, rec, projector)
    calibration = stack.calibration
    if calibration is not None:
        rig, heights = view_of(calibration, projector).rig, calibration.height_range_mm
        yield from disorder(phase, rec.valid, rig, axis, heights, f"{axis}s, epipolar order")


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
