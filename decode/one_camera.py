"""Decoding of one camera's stack: one projector after the other, one height of all of them, and the region asked for."""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decode.codings.rewriting import as_fringes
from decode.device import Device
from decode.fused.kernel import Kernel
from decode.fused.plan import Planner
from decode.fusion.interface import MERGED
from decode.options import Options
from decode.reason import Reason
from decode.reconstruction import AxisPhase, Reconstruction
from decode.several_projectors import Heights, better, of_all
from decode.validity.error_causes import across_projectors, by_cause
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError, FringebenchWarning
from scenes.support.memory import room_for

# Memory per pixel of what comes out of one projector, as measured; frames are read in place. Of several, each makes as much
# again where it is merged with those before it.
PIXEL_BYTES = 24
# Valid pixels that may lie on surfaces which lose much modulation, before the whole stack is in doubt.
FEW = 0.05


def decode_fringes(stack: Stack, options: Options) -> Reconstruction:
    """Heights or phases from one camera's frames of fringes and Gray code; `DecodeError` if no pixel has any."""
    found = decode_pixels(stack, options)
    require_some(found, options)
    return found


def decode_pixels(stack: Stack, options: Options) -> Reconstruction:
    """As `decode_fringes`, perhaps without a valid pixel."""
    _check_size(stack)
    plain = as_fringes(stack, options.saturation == "reject")
    stack = plain.stack
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
    each: list[Heights] = []
    lost = 0.0
    for projector in projectors:
        planner = Planner(stack, options, projector)
        reference = _reference_px(planner) if options.height == "reference-plane" else None
        columns, rows = stack.resolution
        with room_for(
            PIXEL_BYTES * (1 if best is None else 2) * columns * rows,
            f"decoding {columns} x {rows} pixels",
            "decode strips of the frames, each with a calibration of its own pixels",
        ):
            found, signs = Kernel(planner.plan(reference), device, rule).decode()
        factor = plain.sigma_factor.get((projector, found.axis))
        if factor is not None:
            merged = found.exposure >= len(factor)
            own = np.take_along_axis(factor, np.where(merged, 0, found.exposure)[None], axis=0)[0]
            own = np.where(merged, factor.mean(axis=0), own)
            found = replace(found, sigma_mm=found.sigma_mm * own)
        if signs is not None:
            found, share = by_cause(found, signs)
            lost = max(lost, share)
        each.append(Heights.of(found))
        best = found if best is None else better(best, found)
    assert best is not None  # A stack has at least one frame, so one projector.
    if len(each) > 1:
        best = of_all(best, each)
        if best.cause_sigma_mm:
            best = across_projectors(best)
    if lost > FEW:
        warnings.warn(
            f"fine fringes lose more than a quarter of their modulation on {lost:.0%} of the valid pixels: light spreads inside "
            "the surface or between surfaces (with two periods it may also be defocus); heights there may be wrong by more "
            "than total_sigma_mm",
            FringebenchWarning,
            stacklevel=2,
        )
    if region is not None:
        best = _within(best, region)
    return best


def require_some(best: Reconstruction, options: Options) -> None:
    """`DecodeError` that names the reasons if no pixel is valid."""
    # Some pixels first: nearly always one of them is valid. Heights up to whole turns are an answer, and are named so.
    if not (
        (best.reason[::16, ::16] == Reason.OK).any()
        or np.isin(best.reason, (Reason.OK, Reason.ORDER_UNKNOWN)).any()
    ):
        shares = ", ".join(
            f"{name} {share:.1%}" for name, share in best.reason_fractions().items() if name != "ok"
        )
        if (best.reason == Reason.NOT_A_NUMBER).any():
            shares += "; frames hold NaN or infinity, which are no digital numbers"
        minimum = "automatic" if options.min_modulation_dn is None else options.min_modulation_dn
        raise DecodeError(
            f"no pixel could be decoded ({shares}): check exposure times, min_modulation_dn "
            f"({minimum}), the patterns' order and the calibration"
        )


def _check_size(stack: Stack) -> None:
    if stack.calibration is not None:
        camera = stack.calibration.camera.projection()
        camera.require_shape(stack.frames.shape[2:], "the frames", DecodeError)


def _reference_px(plan: Planner) -> NDArray[np.float64] | None:
    """Coordinate (row, col) of the measured reference plane, NaN where it is invalid; None without one."""
    plane, options, shape = plan.options.reference, plan.options, plan.stack.frames.shape[2:]
    if plane is None:
        return None
    if isinstance(plane, Stack):
        choices = Options(
            fusion=options.fusion,
            exposure=options.exposure,
            saturation=options.saturation,
            unwrap=options.unwrap,
            min_modulation_dn=options.min_modulation_dn,
            backend=options.backend,
            height="phase",
            axis=plan.axis,
            projector=plan.projector,
        )
        plane = decode_fringes(plane, choices)
    if plan.axis not in plane.phases or plane.reason.shape != shape:
        raise DecodeError(
            f"the reference has phases of {list(plane.phases)} and shape {plane.reason.shape}; "
            f"needed: {plan.axis}, {shape}"
        )
    return np.where(plane.valid, plane.phases[plan.axis].coordinate_px, np.nan)


def _within(rec: Reconstruction, region: NDArray[np.bool_]) -> Reconstruction:
    """The region of interest of a whole decode.

    Orders found by a scan, and shadow, depend on the surroundings; and gathering a region takes longer than decoding everything.
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
        cause_sigma_mm={cause: kept(sigma) for cause, sigma in rec.cause_sigma_mm.items()},
        modulation_dn=kept(rec.modulation_dn),
        offset_dn=kept(rec.offset_dn),
        reason=kept(rec.reason, Reason.OUTSIDE_ROI),
        exposure=kept(rec.exposure, MERGED),
        phases={
            axis: AxisPhase(phase.period_px, kept(phase.wrapped_rad), kept(phase.order, 0))
            for axis, phase in rec.phases.items()
        },
    )
