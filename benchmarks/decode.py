"""Speed of decoding against a straightforward NumPy float32 decoder, OpenCV, and the machine's memory.

Same task for all: eight frames of 5 Mpx, two periods, to phase, modulation, fringe order, calibrated height and a mask
for dark, saturated and mismatched pixels. They take turns, and the median of the paired ratios is given, so that a busy
machine slows all alike. `reconstruct` is the public call, with all it returns; the others' heights are checked, too.

Bandwidth: bytes that must be read (the frames, once) plus bytes written (every image of the result), over time; compared with a copy
on all cores of as many bytes, read and written likewise.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import decode
from benchmarks.result import Result, Target, main
from benchmarks.turns import Copy, take_turns
from decode.height.calibrated_view import CalibratedView
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.rig.calibration import Calibration
from scenes.rig.devices import LookAt, Telecentric
from scenes.rig.projectors import TelecentricProjector

FASTER = Target("ratio", "at least", 8.0)
BANDWIDTH = Target("ratio", "at least", 0.6)
COLUMNS, ROWS = 2448, 2048
FINE, COARSE = 16.0, 96.0
TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]
Answer = tuple[Image, Image, NDArray[np.bool_]]
"""Height, modulation, mask."""


def capture(rows: int = ROWS) -> tuple[Stack, Image]:
    """A telecentric SPI head over a wavy board; frames uint8, and the truth in mm."""
    camera = Telecentric(
        resolution=(COLUMNS, rows), pose=LookAt(origin_mm=(0, 0, 200)), field_width_mm=24.48
    )
    projector = TelecentricProjector(
        resolution=(912, 1140), pose=LookAt(origin_mm=(100, 0, 200)), field_width_mm=40
    )
    calibration = Calibration(camera=camera, projectors=(projector,), height_range_mm=(-1, 3))
    rig = CalibratedView(calibration, 0).rig
    column, row = np.meshgrid(np.arange(COLUMNS) + 0.5, np.arange(rows) + 0.5)
    height = 1.0 + np.sin(column / 150.0) * np.sin(row / 170.0)
    ray = rig.ray(column, row)
    at = rig.coordinate(ray, ray.t_at(height), "column")[0]
    shown = PhaseShift(periods_px=(FINE, COARSE)).frames()
    rng = np.random.default_rng(0)
    frames = np.empty((1, len(shown), rows, COLUMNS), np.uint8)
    for k, frame in enumerate(shown):
        ideal = 120 + 80 * np.cos(2 * np.pi * at / frame.period_px + frame.phase_shift_rad)
        frames[0, k] = np.round(ideal + rng.normal(0, 2, ideal.shape))
    stack = Stack(frames, shown, (1.0,), SimpleSensor(sigma_dn=2.0), calibration)
    return stack, height.astype(np.float32)


def plane_px(stack: Stack) -> tuple[Image, np.float32]:
    """The rig's coefficients: ``u = plane + c h`` for parallel rays, a plane of columns and rows, and one number."""
    assert stack.calibration is not None
    columns, rows = stack.resolution
    rig = CalibratedView(stack.calibration, 0).rig
    corner = rig.ray(np.array([0.5, 1.5, 0.5]), np.array([0.5, 0.5, 1.5]))
    zero = rig.coordinate(corner, corner.t_at(0.0), "column")[0]
    c = np.float32(rig.coordinate(corner, corner.t_at(1.0), "column")[0][0] - zero[0])
    plane = (
        zero[0]
        + (zero[1] - zero[0]) * np.arange(columns)[None, :]
        + (zero[2] - zero[0]) * np.arange(rows)[:, None]
    )
    return plane.astype(np.float32), c


def numpy_decoder(stack: Stack) -> Callable[[], Answer]:
    """The formulas as one would write them; the rig's coefficients are made once, outside the timing."""
    plane, c = plane_px(stack)

    def work() -> Answer:
        i = stack.frames[0].astype(np.float32)
        fine_s, fine_c = i[3] - i[1], i[0] - i[2]
        fine, coarse = np.arctan2(fine_s, fine_c), np.arctan2(i[7] - i[5], i[4] - i[6])
        modulation = np.float32(0.5) * np.sqrt(fine_s * fine_s + fine_c * fine_c)
        return _measured(fine, coarse, modulation, i.max(axis=0), plane, c)

    return work


def opencv_decoder(stack: Stack) -> Callable[[], Answer]:
    """The same with OpenCV's differences, angles and magnitudes, which read the counts as they are."""
    plane, c = plane_px(stack)

    def difference(one: Any, two: Any) -> Any:
        return cv2.subtract(one, two, dtype=cv2.CV_32F)

    def work() -> Answer:
        i = stack.frames[0]
        twice, fine = cv2.cartToPolar(difference(i[0], i[2]), difference(i[3], i[1]))
        coarse = cv2.phase(difference(i[4], i[6]), difference(i[7], i[5]))
        top = i[0]
        for frame in i[1:]:
            top = cv2.max(top, frame)
        return _measured(fine, coarse, np.float32(0.5) * twice, top, plane, c)

    return work


def _measured(
    fine: Any, coarse: Any, modulation: Any, top: Any, plane: Image, c: np.float32
) -> Answer:
    """Orders, heights and mask from the phases of both periods (each to within whole turns)."""
    order = np.round((plane + c) / np.float32(COARSE) - coarse / TURN)
    turns = (order + coarse / TURN) * np.float32(COARSE / FINE) - fine / TURN
    fringe = np.round(turns)
    height = ((fringe + fine / TURN) * np.float32(FINE) - plane) / c
    good = (modulation > 20) & (top < 255) & (np.abs(turns - fringe) < 0.25)
    return height, modulation, good


def written_bytes(rec: decode.Reconstruction) -> int:
    """Bytes of every image of a result; one that is a single number costs nothing."""
    images: list[NDArray[Any]] = [
        rec.height_mm,
        rec.sigma_mm,
        rec.modulation_dn,
        rec.offset_dn,
        rec.reason,
        rec.exposure,
    ]
    for phase in rec.phases.values():
        images += [phase.wrapped_rad, phase.order]
    return sum(image.nbytes for image in images if any(image.strides))


def measure(quick: bool) -> list[Result]:
    """Frames of 8, 16 and 32 bits."""
    stack, truth = capture(ROWS // 4 if quick else ROWS)
    return [
        row
        for kind in (np.uint8, np.uint16, np.float32)
        for row in _rows(
            replace(stack, frames=stack.frames.astype(kind)), truth, 5 if quick else 15
        )
    ]


def _rows(stack: Stack, truth: Image, rounds: int) -> list[Result]:
    ours = decode.reconstruct(stack)
    theirs, opencv = numpy_decoder(stack), opencv_decoder(stack)
    answers = {
        "ours": (ours.height_mm, ours.valid),
        "NumPy": theirs()[::2],
        "OpenCV": opencv()[::2],
    }
    for name, (found, mask) in answers.items():
        # A tenth of a period: all must have decoded every pixel, or the comparison means nothing.
        wrong = float(np.mean(~mask | (np.abs(found - truth) > 0.1)))
        assert wrong < 1e-4, f"{name} decoded {wrong:.2%} of the pixels wrongly"
    moved = stack.frames.nbytes + written_bytes(ours)
    copy = Copy(moved // 2)
    turns = take_turns([lambda: decode.reconstruct(stack), theirs, opencv, copy], rounds)
    kind = str(stack.frames.dtype)
    columns, rows = stack.resolution
    note = f"8 frames of {columns} x {rows}, {moved / 1e6:.0f} MB read and written"
    judged = kind != "uint16"
    return [
        turns.compared(kind, "NumPy, float32", target=FASTER if judged else None, note=note),
        turns.compared(kind, "OpenCV's functions", theirs=2, note=note),
        turns.rate(
            f"{kind}, bandwidth",
            "copy on all cores",
            [1e-9 * moved, 0.0, 0.0, copy.moved_gb],
            "GB/s",
            theirs=3,
            target=BANDWIDTH if judged else None,
            note=note,
        ),
    ]


if __name__ == "__main__":
    raise SystemExit(main("decode", __doc__, measure))
