"""Whether a stack's frames are what its patterns say: order, period, direction, response, saturation, calibration.

Every check reports what it measured and what follows from it. What a stack cannot show (three steps of one period fit any
order) is reported as unknown, never left out. `check` is for other people's captures: a rendered stack passes by construction.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from decode.checks.agreement_check import agreement
from decode.checks.flicker import flicker_findings
from decode.checks.fringe_check import sinusoid
from decode.checks.gray_check import flats, gray_code
from decode.checks.not_verified import unverified
from decode.checks.space_check import in_space
from decode.codings.rewriting import as_fringes
from decode.order.gray_cells import gray_sets
from decode.phase.n_step import fringe_sets
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError
from scenes.support.finding import Finding, graded

# Share of the pixels that one cause may cost before the capture is worth repeating.
LOST = 0.05
LINEARITY = (0.03, 0.3)


@dataclass(frozen=True)
class CheckReport:
    """All findings about a stack."""

    findings: tuple[Finding, ...]
    not_verified: Mapping[str, str] = field(default_factory=dict)
    """Parts of the manifest that the images cannot verify, and why: another value would give the same images."""

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

    def to_dict(self) -> dict[str, Any]:
        """In JSON's types."""
        findings = [vars(f) for f in self.findings]
        return {"findings": findings, "not_verified": dict(self.not_verified)}


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
            said = "all frames are fitted together: see agreement"
            found.append(Finding(f"{axis} fringes, order", "unknown", said))
            continue
        for fringes in sets:
            found += sinusoid(stack, fringes)
        found += flicker_findings(stack, projector, axis)
    codes = gray_sets(stack.patterns, projector)
    for gray in codes.values():
        found += gray_code(stack, gray, resolution)
    if codes:
        found += flats(stack, next(iter(codes.values())))
    if stack.calibration is not None and stack.calibration.screens:
        said = "the rig has a screen: only what mirrors it shows an order"
        return CheckReport((*found, Finding("agreement", "unknown", said)))
    found += agreement(stack, projector)
    miss = None
    if stack.calibration is not None and any(f.name.endswith("agreement") for f in found):
        finding, miss = in_space(stack, projector)
        found.append(finding)
    return CheckReport(tuple(found), unverified(stack, found, miss, projector))


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
