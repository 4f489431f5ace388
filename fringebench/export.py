"""A stack as image files any program reads: numbered PNGs and a manifest that says what each one shows.

The manifest is the one `fringebench import` reads (`scenes.capture.Capture`), so a folder written here is also an example of
what real captures need; it carries the rig and the sensor's noise model in full.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from fringebench.alone import alone
from fringebench.run import prepare
from scenes import Calibration, Frame, Stack
from scenes.capture import Capture, Fringes, GrayFrames, Uniform
from scenes.errors import FileError
from scenes.replace_file import replacing
from scenes.rig import Extrinsics

MANIFEST = "manifest.toml"
HEADER = """\
# Frames of a structured-light capture, written by `fringebench export`.
#
# Files are in the order shown: all frames at the first exposure time, then all at the next. A fringe frame k of N shows
#   I_k = A + B cos(2 pi (u - origin_px) / period_px + first_phase_deg + direction 360 deg k / N)   (or + shifts_deg[k])
# with u the projector's continuous column (or row): a pixel's centre is at integer + 0.5, in the camera too.
# A sample of saturation_dn or more is clipped; dark_dn is the digital number of no light.
# [rig]: x_device = R X_world + t_mm, device frames x right, y down, z forward, as in OpenCV; a pinhole sees
# (fx_px x / z + cx_px, fy_px y / z + cy_px) after Brown's distortion (k1, k2, p1, p2, k3), a telecentric device
# (x, y) / (field_width_mm / columns) from the image's middle. Heights asked for are world z in mm.

"""


def export(stack: Stack, folder: str | Path, projector: int | None = None) -> Path:
    """Write ``e00_f000.png ...`` (8 or 16 bit) and ``manifest.toml`` into `folder`; the manifest's path is returned.

    The manifest is written last, so a folder with one is whole. `projector` picks the frames of one projector where there
    are several. Raises `FileError` for a stack of real numbers, several projectors, or a folder that cannot be written.
    """
    out = Path(folder)
    if stack.frames.dtype not in (np.uint8, np.uint16):
        raise FileError(
            f"frames are {stack.frames.dtype}, which PNG files cannot hold: use a sensor with bits from 1 to 16"
        )
    chosen = _chosen(stack, projector)
    index = projector or 0
    with alone(prepare(out)):
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
            with replacing(out / names[-1]) as beside:
                beside.write_bytes(data.tobytes())
                # It would describe a mixture while the files are replaced.
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
    if stack.calibration is not None:
        light = stack.calibration.projectors[projector]
        manifest["projector_resolution"] = list(light.resolution)
        manifest["rig"] = _rig(stack.calibration, projector)
    # What cannot be read back is not worth writing.
    Capture.model_validate(manifest)
    with replacing(out / MANIFEST) as beside:
        beside.write_text(HEADER + tomli_w.dumps(manifest), "utf-8")
    return out / MANIFEST


def _chosen(stack: Stack, projector: int | None) -> list[int]:
    known = sorted({frame.projector for frame in stack.patterns})
    if projector is None and len(known) > 1:
        raise FileError(
            f"the stack has frames of projectors {known}, a manifest holds one: choose it with --projector"
        )
    wanted = known[0] if projector is None else projector
    if wanted not in known:
        raise FileError(f"the stack has no frames of projector {wanted}: it has {known}")
    return [i for i, frame in enumerate(stack.patterns) if frame.projector == wanted]


def _rig(calibration: Calibration, projector: int) -> dict[str, Any]:
    """The calibration with every pose as R and t, the form every program takes."""

    def device(model: Any) -> Any:
        rotation, translation = model.pose.matrix()
        pose = Extrinsics.model_validate({"R": rotation.tolist(), "t_mm": translation.tolist()})
        return model.model_copy(update={"pose": pose})

    plain = Calibration(
        camera=device(calibration.camera),
        projectors=(device(calibration.projectors[projector]),),
        height_range_mm=calibration.height_range_mm,
    )
    dumped: dict[str, Any] = plain.model_dump(mode="json", exclude_none=True)
    return dumped


def _shown(patterns: list[Frame]) -> Iterator[Fringes | GrayFrames | Uniform]:
    """The frames as a manifest describes them."""

    def same(frame: Frame) -> tuple[Any, ...]:
        return frame.kind, frame.axis, frame.period_px, frame.steps

    for (kind, *_), group in groupby(patterns, same):
        frames = list(group)
        first = frames[0]
        if kind in ("white", "black"):
            yield from (Uniform.model_validate({"kind": kind}) for _ in frames)
        elif kind == "gray":
            yield _gray(frames)
        elif len(frames) != first.steps:
            raise FileError(
                f"{len(frames)} frames of {first.steps} steps of the {first.axis} fringe of {first.period_px:g} px stand "
                "together: export whole fringe sets"
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


def _gray(frames: list[Frame]) -> GrayFrames:
    first = frames[0]
    for inverse in ("none", "after-each", "after-all"):
        for order in ("coarse-first", "fine-first"):
            gray = GrayFrames.model_validate(
                {
                    "axis": first.axis,
                    "bits": first.steps,
                    "cell_px": first.period_px,
                    "inverse": inverse,
                    "order": order,
                }
            )
            if gray.frames() == frames:
                return gray
    raise FileError(
        f"the {first.axis} Gray code's frames are in an order that a manifest has no name for"
    )
