"""Whether a stack's frames are what its patterns say: order, period, direction, response, saturation, calibration.

Every check tells what it measured and what follows; what a stack cannot tell (three steps of one period fit any order) is
said to be unknown, never passed over. `check` is for other people's captures: a rendered stack passes by construction.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from decode.check_gray import flats, gray_code
from decode.finding import Finding, graded
from decode.gamma import CLEAR, Harmonics, harmonics
from decode.gray import gray_sets
from decode.phase import FringeSet, fringe_sets
from decode.pipeline import reconstruct
from decode.reconstruction import Reconstruction
from decode.validity import Reason
from scenes.errors import DecodeError
from scenes.patterns import Axis
from scenes.stack import Stack

# Two frames of four exchanged leave half the modulation beside any sinusoid, of eight a quarter; a gamma of 2.2 leaves 0.2,
# most of it a second harmonic, which is told apart.
MISFIT = 0.2
# A phase that has nothing to do with the coarser one misses its order by more than a quarter period every other time.
RANDOM_MISMATCH = 0.2
MISMATCH = 0.05
GAMMA = 0.1
SATURATED = 0.01
# Points of a good calibration meet the other axis to a pixel; a wrong one misses by tens.
EPIPOLAR_PX = (2.0, 8.0)
# Share of points outside the working volume that no stray light makes.
AWAY = 0.5
LINEARITY = (0.03, 0.3)


@dataclass(frozen=True)
class Report:
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
                "the frames are not what they are said to be:\n"
                + "\n".join(f"  {f.name}: {f.message}" for f in self.wrong)
            )

    def to_dict(self) -> dict[str, list[dict[str, str | float | None]]]:
        """In JSON's types."""
        return {"findings": [vars(f) for f in self.findings]}


def check(stack: Stack, resolution: tuple[int, int] | None = None, projector: int = 0) -> Report:
    """Look at one projector's frames; `resolution` is that projector's (columns, rows), absent: the calibration's.

    Raises `DecodeError` for patterns that give neither phase nor code.
    """
    if resolution is None and stack.calibration is not None:
        resolution = stack.calibration.projectors[projector].resolution
    found = [*_saturation(stack), *_exposures(stack)]
    for sets in fringe_sets(stack.patterns, projector).values():
        for fringes in sets:
            found += _fringes(stack, fringes)
    codes = gray_sets(stack.patterns, projector)
    for gray in codes.values():
        found += gray_code(stack, gray, resolution)
    if codes:
        found += flats(stack, next(iter(codes.values())))
    found += _agreement(stack, projector)
    return Report(tuple(found))


def _saturation(stack: Stack) -> Iterator[Finding]:
    shortest = int(np.argmin(stack.exposure_ms))
    share = float((stack.frames[shortest].max(axis=0) >= stack.saturation_dn).mean())
    yield Finding(
        "saturation",
        "warning" if share > SATURATED else "ok",
        f"{share:.2%} of the pixels reach {stack.saturation_dn:g} DN in the shortest exposure"
        + ("; expose less" if share > SATURATED else ""),
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
    exposure = _clearest(stack, fringes)
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
        yield Finding(f"{name}, gamma", "unknown", "too few fringes in view to tell harmonics")
        return
    bent = abs(seen.gamma - 1.0) > GAMMA
    yield Finding(
        f"{name}, gamma",
        "warning" if bent else "ok",
        f"second harmonic {seen.second:+.3f} of the first, as of gamma {seen.gamma:.2f}"
        + ("; decode with gamma='estimate', or linearise projector and camera" if bent else ""),
        seen.gamma,
    )


def _order(stack: Stack, fringes: FringeSet, exposure: int, seen: Harmonics, name: str) -> Finding:
    """Least-squares residual, beyond noise and the second harmonic; if large, the exchange of frames that mends it."""
    misfit = _misfit(seen)
    if misfit <= MISFIT:
        said = f"samples lie {misfit:.3f} of the modulation off a sinusoid beyond noise and gamma"
        return Finding(name, "ok", said, misfit)
    mended: list[str] = []
    for i, j in combinations(range(len(fringes.frames)), 2):
        frames = list(fringes.frames)
        frames[i], frames[j] = frames[j], frames[i]
        other = FringeSet(fringes.axis, fringes.period_px, tuple(frames), fringes.shifts_rad)
        if _misfit(harmonics(stack, other, exposure)) < MISFIT:
            mended.append(f"{i} and {j}")
    hint = "no exchange of two frames mends it"
    if mended:
        hint = f"exchanging steps {' or '.join(mended)} mends it"
    said = f"samples lie {misfit:.2f} of the modulation off a sinusoid; {hint}: correct the frames' order or steps"
    return Finding(name, "wrong", said, misfit)


def _misfit(seen: Harmonics) -> float:
    """Residual that neither noise nor the second harmonic explains."""
    explained = seen.noise**2 + seen.second_residual**2
    return float(np.sqrt(max(seen.residual**2 - explained, 0.0)))


def _clearest(stack: Stack, fringes: FringeSet) -> int:
    """The exposure in which most pixels are modulated and unsaturated."""

    def count(exposure: int) -> int:
        frames = stack.frames[exposure][list(fringes.frames)][:, ::4, ::4]
        low, high = frames.min(axis=0), frames.max(axis=0).astype(np.float64)
        return int(((high < stack.saturation_dn) & (high - low > CLEAR)).sum())

    return max(range(len(stack.exposure_ms)), key=count)


def _agreement(stack: Stack, projector: int) -> Iterator[Finding]:
    """Decode each axis, and see whether its periods and its code tell the same; then the axes against each other."""
    decoded: dict[Axis, Reconstruction] = {}
    for axis in dict.fromkeys(f.axis for f in stack.patterns if f.kind in ("fringe", "gray")):
        sources = {f.period_px for f in stack.patterns if f.kind == "fringe" and f.axis == axis}
        coded = any(f.kind == "gray" and f.axis == axis for f in stack.patterns)
        name = f"{axis}s, agreement"
        try:
            rec = reconstruct(stack, height="phase", axis=axis, projector=projector)
        except DecodeError as error:
            yield Finding(name, "wrong", str(error))
            continue
        decoded[axis] = rec
        if len(sources) + coded < 2:
            yield Finding(
                name, "unknown", "one period, or a code alone: nothing to hold its order against"
            )
            continue
        seen = (rec.reason == Reason.OK) | (rec.reason == Reason.ORDER_MISMATCH)
        share = float((rec.reason[seen] == Reason.ORDER_MISMATCH).mean())
        verdict = graded(share, MISMATCH, RANDOM_MISMATCH)
        said = f"{share:.2%} of the lit pixels have periods{' and Gray code' if coded else ''} that disagree"
        if verdict == "wrong":
            said += ": a period, the direction of shift, the first phase or the order of frames is not as stated"
        yield Finding(name, verdict, said, share)
    if stack.calibration is not None and len(decoded) == 2:
        yield _epipolar(stack, projector)


def _epipolar(stack: Stack, projector: int) -> Finding:
    """The point that one axis gives must show the other axis' coordinate, whatever the surface."""
    assert stack.calibration is not None
    name = "calibration"
    try:
        rec = reconstruct(stack, projector=projector)
    except DecodeError as error:
        return Finding(name, "wrong", f"no height comes out of it: {error}")
    other: Axis = "row" if rec.axis == "column" else "column"
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
    valid = rec.valid[at]
    if valid.sum() < 100:
        return Finding(name, "unknown", "too few points to compare rows and columns")
    camera = stack.calibration.camera.projection()
    origin, direction = camera.rays(camera.pixel_centres()[at][valid])
    along = (rec.height_mm[at][valid] - origin[:, 2]) / direction[:, 2]
    light = stack.calibration.projectors[projector].projection()
    seen = light.project(origin + along[:, None] * direction)[0]
    pixels = seen[:, 0 if other == "column" else 1]
    miss = np.abs(pixels - rec.phases[other].coordinate_px[at][valid])
    middle = float(np.nanmedian(miss))
    verdict = graded(middle, *EPIPOLAR_PX)
    said = f"points from the {rec.axis}s miss their {other} by {middle:.2f} projector px (median)"
    if verdict != "ok":
        said += ": the calibration is not this rig's, or an axis is mirrored"
    return Finding(name, verdict, said, middle)
