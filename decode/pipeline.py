"""Stack to reconstruction: one projector after the other, the better of them per pixel, and the region asked for."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode import fusion
from decode.device import Device
from decode.geometry import view_of
from decode.kernel import Kernel
from decode.options import Options
from decode.plan import Plan
from decode.reconstruction import AxisPhase, Reconstruction
from decode.validity import Reason
from scenes.errors import DecodeError
from scenes.memory import room_for
from scenes.stack import Stack

# Memory per pixel of what comes out, as measured; frames are read in place.
PIXEL_BYTES = 24


def reconstruct(stack: Stack, **choices: Any) -> Reconstruction:
    """Decode a stack into heights; the keywords are the fields of `Options`.

    Raises `DecodeError`, naming the cause, when a choice is impossible for this stack or no pixel can be decoded, and
    `TooLargeError` for more pixels than memory holds.

    >>> rec = reconstruct(stack, fusion="max-modulation", roi=(0, 100, 0, 200))  # doctest: +SKIP
    >>> rec.height_mm.shape == stack.frames.shape[2:]  # doctest: +SKIP
    True
    """
    options = Options.of(choices)
    _check_size(stack)
    region = options.region(stack.frames.shape[2:])
    projectors = sorted({frame.projector for frame in stack.patterns})
    if options.projector is not None:
        projectors = [options.projector]
    elif len(projectors) > 1 and options.height == "phase":
        raise DecodeError(
            f"phases of projectors {projectors} cannot be compared: choose one with projector="
        )
    device = Device.open(options.backend)
    rule = options.rule().prepare(stack)
    best: Reconstruction | None = None
    for projector in projectors:
        plan = Plan(stack, options, projector)
        if options.height == "reference-plane":
            plan = replace(plan, reference_px=_reference_px(plan))
        columns, rows = stack.resolution
        with room_for(
            PIXEL_BYTES * columns * rows,
            f"decoding {columns} x {rows} pixels",
            "decode strips of the frames, each with a calibration of its own pixels",
        ):
            found = Kernel(plan, device, rule).decode()
        best = found if best is None else _better(best, found)
    assert best is not None  # a stack has at least one frame, so one projector
    if region is not None:
        best = _within(best, region)
    # some pixels first, which settle it nearly always
    if best.reason[::16, ::16].min() != Reason.OK and best.reason.min() != Reason.OK:
        shares = ", ".join(
            f"{name} {share:.1%}" for name, share in best.reason_fractions().items() if name != "ok"
        )
        if (best.reason == Reason.NOT_A_NUMBER).any():
            shares += "; frames hold NaN or infinity, which are no digital numbers"
        least = "automatic" if options.min_modulation_dn is None else options.min_modulation_dn
        raise DecodeError(
            f"no pixel could be decoded ({shares}): check exposure times, min_modulation_dn "
            f"({least}), the patterns' order and the calibration"
        )
    return best


def _check_size(stack: Stack) -> None:
    if stack.calibration is not None:
        camera = view_of(stack.calibration, 0).rig.camera
        if (camera.width, camera.height) != stack.resolution:
            raise DecodeError(
                f"the calibration's camera is {camera.width} x {camera.height} pixels, the frames are "
                f"{stack.resolution[0]} x {stack.resolution[1]}: set calibrated_at and resolution to match"
            )


def _reference_px(plan: Plan) -> NDArray[np.float64] | None:
    """Coordinate (row, col) of the measured reference plane, NaN where it is invalid; None without one."""
    plane, options, shape = plan.options.reference, plan.options, plan.stack.frames.shape[2:]
    if plane is None:
        return None
    if isinstance(plane, Stack):
        kept = ("fusion", "exposure", "saturation", "unwrap", "min_modulation_dn", "backend")
        choices = {name: getattr(options, name) for name in kept}
        plane = reconstruct(
            plane, **choices, height="phase", axis=plan.axis, projector=plan.projector
        )
    if plan.axis not in plane.phases or plane.reason.shape != shape:
        raise DecodeError(
            f"the reference has phases of {list(plane.phases)} and shape {plane.reason.shape}; "
            f"needed: {plan.axis}, {shape}"
        )
    return np.where(plane.valid, plane.phases[plan.axis].coordinate_px, np.nan)


def _better(one: Reconstruction, two: Reconstruction) -> Reconstruction:
    """Per pixel the valid one with the smaller predicted sigma."""
    take = two.valid & (~one.valid | (two.sigma_mm < one.sigma_mm))
    images = (
        "height_mm",
        "sigma_mm",
        "modulation_dn",
        "offset_dn",
        "reason",
        "exposure",
        "projector",
    )
    phases = {
        axis: AxisPhase(
            phase.period_px,
            np.where(take, two.phases[axis].wrapped_rad, phase.wrapped_rad),
            np.where(take, two.phases[axis].order, phase.order),
        )
        for axis, phase in one.phases.items()
        if axis in two.phases and two.phases[axis].period_px == phase.period_px
    }
    merged = {name: np.where(take, getattr(two, name), getattr(one, name)) for name in images}
    return replace(one, phases=phases, **merged)


def _within(rec: Reconstruction, region: NDArray[np.bool_]) -> Reconstruction:
    """The region of interest of a whole decode.

    Orders found by a scan, and shadow, hang on what lies around; and laying a region out takes longer than decoding all.
    """
    out = ~region

    def kept(image: NDArray[Any], outside: float = np.nan) -> NDArray[Any]:
        if not image.flags.writeable:
            return np.where(region, image, np.asarray(outside, image.dtype))
        np.copyto(image, outside, where=out, casting="unsafe")
        return image

    return replace(
        rec,
        height_mm=kept(rec.height_mm),
        sigma_mm=kept(rec.sigma_mm),
        modulation_dn=kept(rec.modulation_dn),
        offset_dn=kept(rec.offset_dn),
        reason=kept(rec.reason, Reason.OUTSIDE_ROI),
        exposure=kept(rec.exposure, fusion.MERGED),
        phases={
            axis: AxisPhase(phase.period_px, kept(phase.wrapped_rad), kept(phase.order, 0))
            for axis, phase in rec.phases.items()
        },
    )
