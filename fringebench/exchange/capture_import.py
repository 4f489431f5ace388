"""From a manifest to a checked stack: what `fringebench import` does before it writes."""

from dataclasses import dataclass, replace

import numpy as np

from decode.checks import flicker, stack_check
from decode.codings.rewriting import as_fringes
from decode.phase.gamma import response
from decode.pipeline import camera_view
from fringebench.progress import Steps
from scenes import Stack
from scenes.files.capture import Capture


@dataclass(frozen=True)
class CheckedCapture:
    """A capture as it was read, and what the checks found."""

    stack: Stack
    report: stack_check.CheckReport


def checked(capture: Capture, equalise: bool = False, steps: Steps | None = None) -> CheckedCapture:
    """Read a capture's images, measure their gamma, and check them against the manifest.

    Parameters
    ----------
    capture
        The manifest.
    equalise
        Divide out a source that flickers or drifts between frames.
    steps
        Where progress is shown; None: nowhere.

    Returns
    -------
    CheckedCapture
        The stack, also where the report says that it is wrong.

    Raises
    ------
    FileError
        An image, its size or depth, or the calibration does not fit the manifest.

    Examples
    --------
    >>> checked(Capture.load("capture.toml")).report.wrong  # doctest: +SKIP
    ()
    """
    steps = steps or Steps()
    with steps.step("read images"):
        imported = capture.imported()
    findings = list(imported.findings)
    stack = imported.stack
    pair = any(frame.camera for frame in stack.patterns)
    views = tuple(camera_view(stack, c) for c in (0, 1)) if pair else (stack,)
    if equalise:
        with steps.step("equalise"):
            # Of coarse fringes, whose factors are not seen, this is known only before.
            findings += [f for view in views for f in flicker.orders_in_doubt(view)]
            views = tuple(flicker.equalise(view) for view in views)
    gamma = response(as_fringes(views[0]).stack) if capture.gamma is None else capture.gamma
    views = tuple(replace(view, gamma=gamma) for view in views)
    frames = np.concatenate([view.frames for view in views], axis=1) if pair else views[0].frames
    # Brightness from step to step says nothing where one image gave all four.
    shots = [f.name.replace("single shot", "brightness") for f in imported.findings]
    doubts: dict[str, str] = {}
    for name, view in zip(("first view, ", "second view, ") if pair else ("",), views, strict=True):
        with steps.step(f"{name}check"):
            found = stack_check.check(view, capture.projector_resolution)
        doubts |= found.not_verified
        named = (replace(f, name=f"{name}{f.name}") for f in found.findings)
        findings += [f for f in named if f.name not in shots]
    report = stack_check.CheckReport(tuple(findings), doubts)
    return CheckedCapture(replace(stack, frames=frames, gamma=gamma), report)
