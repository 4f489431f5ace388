"""Which parts of a manifest the images cannot verify: another value there would give the same images.

Without a calibration nothing shows where the projector's pixels are, so one factor on all widths of an axis, or one shift of
all its origins, changes nothing that can be seen. With a calibration and both axes, the point that one axis gives must
show the other's coordinate.
"""

from collections.abc import Iterator, Sequence

from decode.checks.space_check import Miss
from decode.order.gray_cells import gray_sets
from decode.phase.n_step import fringe_sets
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.finding import Finding

# Shift of a code alone that the other axis must show, px.
CODE_PX = 10.0


def unverified(
    stack: Stack, findings: Sequence[Finding], miss: Miss | None, projector: int = 0
) -> dict[str, str]:
    """Parts of the manifest that no check could verify.

    Parameters
    ----------
    stack
        The stack that was checked.
    findings
        What the checks found.
    miss
        How the axes miss each other in space; None: not known.
    projector
        Index of the projector.

    Returns
    -------
    dict
        Key of the manifest, such as ``gray.cell_px``, and why.

    Examples
    --------
    >>> unverified(stack, report.findings, None)  # doctest: +SKIP
    {'gray.cell_px': 'columns: cells of any width look the same'}
    """
    why: dict[str, list[str]] = {}
    for key, said in (*_of_axes(stack, miss, projector), *_of_findings(findings)):
        why.setdefault(key, []).append(said)
    if stack.calibration is not None and miss is None:
        why["calibration"] = ["one axis of patterns shows no contradiction to a calibration"]
    return {key: "; ".join(said) for key, said in why.items()}


def _of_axes(stack: Stack, miss: Miss | None, projector: int) -> Iterator[tuple[str, str]]:
    fringes, codes = fringe_sets(stack.patterns, projector), gray_sets(stack.patterns, projector)
    axes: tuple[Axis, ...] = ("column", "row")
    for axis in axes:
        sets, code = fringes.get(axis, ()), codes.get(axis)
        finest = sets[-1].period_px if sets else CODE_PX
        if not (sets or code) or (miss is not None and miss.shows_px(axis) < finest):
            continue
        if code and sets:
            said = f"{axis}s: a code that is whole periods of {finest:g} px off looks the same"
            yield "gray.origin_px", said
        elif code:
            yield "gray.cell_px", f"{axis}s: cells of any width look the same"
            yield "gray.origin_px", f"{axis}s: a code that begins elsewhere looks the same"
        if sets:
            widths = "periods" if not code else "periods and cells"
            yield "fringes.period_px", f"{axis}s: one factor on all {widths} looks the same"
        if sets and not code:
            yield "fringes.origin_px", f"{axis}s: one shift of all fringes looks the same"
            yield "fringes.direction", f"{axis}s: all fringes reversed look like a mirrored image"


def _of_findings(findings: Sequence[Finding]) -> Iterator[tuple[str, str]]:
    names = {f.name: f.verdict for f in findings}
    for name, verdict in names.items():
        subject, _, what = name.rpartition(", ")
        if verdict != "unknown":
            continue
        if what == "brightness":
            yield "brightness of the source", f"{subject}: too few fringes in view to show it"
        elif what == "gamma":
            yield "gamma", f"{subject}: too few fringes in view to show it"
        elif what == "order" and names.get(f"{subject.split()[0]}s, agreement") == "unknown":
            yield "files", f"{subject}: three steps of a single period fit in any order"
