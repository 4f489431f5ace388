"""Export of a stack as numbered PNG files and a manifest that describes them.

The manifest is the one `fringebench import` reads (`scenes.files.capture.Capture`), so an exported folder is also an
example for real captures; it holds the complete rig and the noise model of the sensor.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from fringebench.output_folder import locked, prepare
from scenes import Calibration, Frame, Stack
from scenes.acquisition.frames import UNIFORM
from scenes.files.capture import Capture
from scenes.files.capture_frames import FlatFrame, Fringes, GrayFrames, Images, ModulatedFringes
from scenes.rig.devices import Extrinsics, Pinhole
from scenes.support.atomic_file import replacing
from scenes.support.errors import FileError

MANIFEST = "manifest.toml"
HEADER = """\
# Frames of a structured-light capture, written by `fringebench export`. Lengths in mm, times in ms, numbers in DN.
#
# files: all images at exposures_ms[0], in the order of [[frames]], then all at exposures_ms[1], and so on.
# [[frames]] of kind "fringes" is N = steps images; image k = 0 ... N - 1 shows
#     I_k = A + B cos(2 pi (u - origin_px) / period_px + (first_phase_deg + direction 360 k / N) pi / 180)
# (with shifts_deg: shifts_deg[k] in place of direction 360 k / N), where u is the projector column (axis = "column") or row.
# If the coarsest period is narrower than the projector's image, its order is that whose height is in rig.height_range_mm.
# Coordinates are continuous, (column, row), with pixel centres at integer + 0.5, in the camera and in the projector:
# element [i, j] of an image is at (j + 0.5, i + 0.5). A sample of saturation_dn or more is clipped; dark_dn is no light.
#
# [rig] holds for images of the given resolution = [columns, rows]. A world point X is at x = R X + t_mm in the frame of a
# device (x right, y down, z forward). A pinhole images it at (fx_px x' + cx_px, fy_px y' + cy_px), where (x', y') are
# (x / z, y / z) distorted by OpenCV's model with distortion = [k1, k2, p1, p2, k3]. A telecentric device images it at
# (s x + columns / 2, s y + rows / 2) with s = columns / field_width_mm. The height of a point is its world z.

"""


def export(stack: Stack, folder: str | Path, projector: int | None = None) -> Path:
    """Write ``e00_f000.png ...`` (8 or 16 bit) and ``manifest.toml`` into `folder`; the manifest's path is returned.

    The manifest is written last, so a folder with a manifest is complete. `projector` selects the frames of one projector
    if there are several. Raises `FileError` for a stack of real numbers, several projectors, or a folder that cannot be written.
    """
    out = Path(folder)
    if stack.frames.dtype not in (np.uint8, np.uint16):
        raise FileError(
            f"frames are {stack.frames.dtype}, which PNG files cannot hold: use a sensor with bits from 1 to 16"
        )
    if stack.calibration is not None:
        stack.calibration.require_projectors("an exported capture")
    if any(frame.camera for frame in stack.patterns):
        raise FileError(
            "the stack has frames of a second camera: a manifest is written for one camera's; give the stack itself"
        )
    chosen = _chosen(stack, projector)
    index = projector or 0
    with locked(prepare(out)):
        return _export(stack, out, chosen, index)


def _export(stack: Stack, out: Path, chosen: list[int], projector: int) -> Path:
    patterns = [replace(stack.patterns[i], projector=0) for i in chosen]
    names = []
    for e in range(len(stack.exposure_ms)):
        for f, frame in enumerate(chosen):
            names.append(f"e{e:02d}_f{f:03d}.png")
            done, data = cv2.imencode(".png", stack.frames[e, frame])
            if not done:
                raise FileError(f"cannot write '{out / names[-1]}': PNG encoding failed")
            with replacing(out / names[-1]) as temporary:
                temporary.write_bytes(data.tobytes())
                # The old manifest would describe a mixture of files.
                (out / MANIFEST).unlink(missing_ok=True)
    bits = 8 if stack.frames.dtype == np.uint8 else max(9, stack.sensor.bits)
    manifest: dict[str, Any] = {
        "files": names,
        "exposures_ms": list(stack.exposure_ms),
        "bits": bits,
        "dark_dn": stack.sensor.black_level_dn,
        "frames": [shown.model_dump(exclude_none=True) for shown in _shown(patterns)],
        "sensor": stack.sensor.model_dump(exclude_none=True),
    }
    if np.isfinite(stack.saturation_dn):
        manifest["saturation_dn"] = stack.saturation_dn
    if stack.gamma is not None:
        manifest["gamma"] = stack.gamma
    if stack.calibration is not None:
        light = stack.calibration.projectors[projector]
        manifest["projector_resolution"] = list(light.resolution)
        manifest["rig"] = _rig(stack.calibration, projector)
    # Refuse to write a manifest that cannot be read back.
    Capture.model_validate(manifest)
    with replacing(out / MANIFEST) as temporary:
        temporary.write_text(HEADER + tomli_w.dumps(manifest), "utf-8")
    return out / MANIFEST


def _chosen(stack: Stack, projector: int | None) -> list[int]:
    known = sorted({frame.projector for frame in stack.patterns})
    if projector is None and len(known) > 1:
        raise FileError(
            f"the stack has frames of projectors {known}, a manifest holds those of one: choose it with --projector"
        )
    wanted = known[0] if projector is None else projector
    if wanted not in known:
        raise FileError(f"the stack has no frames of projector {wanted}: it has {known}")
    return [i for i, frame in enumerate(stack.patterns) if frame.projector == wanted]


def _rig(calibration: Calibration, projector: int) -> dict[str, Any]:
    """The calibration with every pose as R and t, and intrinsics at the resolution of the images."""

    def device(model: Any) -> Any:
        at = model.projection()
        # Adding 0.0 turns -0.0 into 0.0.
        pose = Extrinsics.model_validate(
            {"R": (at.R + 0.0).tolist(), "t_mm": (at.t + 0.0).tolist()}
        )
        changes: dict[str, Any] = {"pose": pose}
        if isinstance(model, Pinhole):
            changes |= {"fx_px": at.fx, "fy_px": at.fy, "cx_px": at.cx, "cy_px": at.cy}
            changes["calibrated_at"] = None
        return model.model_copy(update=changes)

    plain = Calibration(
        camera=device(calibration.camera),
        projectors=(device(calibration.projectors[projector]),),
        height_range_mm=calibration.height_range_mm,
    )
    dumped: dict[str, Any] = plain.model_dump(mode="json", exclude_none=True)
    return dumped


def _shown(patterns: list[Frame]) -> Iterator[Images]:
    """The frames as a manifest describes them."""

    def same(frame: Frame) -> tuple[Any, ...]:
        return frame.kind, frame.axis, frame.period_px, frame.steps, frame.carrier_px

    for (kind, *_), group in groupby(patterns, same):
        frames = list(group)
        first = frames[0]
        if kind in UNIFORM:
            yield from (FlatFrame.model_validate({"kind": kind}) for _ in frames)
        elif kind == "gray":
            yield _gray(frames)
        elif kind == "modulated":
            yield _modulated(frames)
        elif kind != "fringe":
            raise FileError(
                f"a manifest is not written for {kind} frames: export fringes, fringes on a carrier and Gray code, or give the "
                "stack itself"
            )
        elif len(frames) != first.steps:
            raise FileError(
                f"{len(frames)} frames of {first.steps} steps of the {first.axis} fringe of {first.period_px:g} px are "
                "consecutive: export complete fringe sets"
            )
        else:
            yield _fringes(frames)


def _fringes(frames: list[Frame]) -> Fringes:
    first = frames[0]
    plain = {"axis": first.axis, "period_px": first.period_px, "steps": first.steps}
    even = Fringes.model_validate(plain)
    shifts = [frame.phase_shift_rad for frame in frames]
    if np.allclose([frame.phase_shift_rad for frame in even.frames()], shifts, rtol=0, atol=1e-12):
        return even
    return Fringes.model_validate({**plain, "shifts_deg": [float(np.rad2deg(s)) for s in shifts]})


def _modulated(frames: list[Frame]) -> ModulatedFringes:
    first = frames[0]
    shown = ModulatedFringes(
        axis=first.axis,
        period_px=first.period_px,
        steps=first.steps,
        carrier_px=first.carrier_px,
        carrier_steps=len(frames) // first.steps,
    )
    if shown.frames() != frames:
        raise FileError(
            f"the {first.axis} fringes of {first.period_px:g} px on a carrier are in an order that a manifest cannot describe"
        )
    return shown


def _gray(frames: list[Frame]) -> GrayFrames:
    first = frames[0]
    for inverse in ("none", "after-each", "after-all"):
        for order in ("coarse-first", "fine-first"):
            gray = GrayFrames.model_validate(
                {
                    "axis": first.axis,
                    "bits": first.steps,
                    "cell_px": first.period_px,
                    "origin_px": -first.phase_shift_rad * first.period_px / (2.0 * np.pi) + 0.0,
                    "code": "plain" if first.plain else "reflected",
                    "inverse": inverse,
                    "order": order,
                }
            )
            # The origin's rounding aside.
            if [replace(f, phase_shift_rad=first.phase_shift_rad) for f in gray.frames()] == frames:
                return gray
    raise FileError(
        f"the {first.axis} Gray code frames are in an order that a manifest cannot describe"
    )
