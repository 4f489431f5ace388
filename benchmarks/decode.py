"""Speed of decoding against a straightforward NumPy float32 decoder: run `python -m benchmarks.decode`.

Same task for both: eight frames of 5 Mpx, two periods, to phase, modulation, fringe order, calibrated height and a mask
for dark, saturated and mismatched pixels. They take turns, and the median of the paired ratios is given, so that a busy
machine slows both alike. `reconstruct` is the public call, with all it returns; NumPy's heights are checked against it.
Besides: the time to copy the same bytes once, and OpenCV's `phase` for the two arctangents alone.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

import decode
from decode.geometry import View
from scenes.calibration import Calibration
from scenes.emission import TelecentricProjector
from scenes.patterns import PhaseShift
from scenes.rig import LookAt, Telecentric
from scenes.sensor import SimpleSensor
from scenes.stack import Stack

TARGET = 8.0
COLUMNS, ROWS = 2448, 2048
FINE, COARSE = 16.0, 96.0
TURN = np.float32(2 * np.pi)
Image = NDArray[np.float32]


def capture() -> tuple[Stack, Image]:
    """A telecentric SPI head over a wavy board; frames uint8, and the truth in mm."""
    camera = Telecentric(
        resolution=(COLUMNS, ROWS), pose=LookAt(origin_mm=(0, 0, 200)), field_width_mm=24.48
    )
    projector = TelecentricProjector(
        resolution=(912, 1140), pose=LookAt(origin_mm=(100, 0, 200)), field_width_mm=40
    )
    calibration = Calibration(camera=camera, projectors=(projector,), height_range_mm=(-1, 3))
    rig = View(calibration, 0).rig
    column, row = np.meshgrid(np.arange(COLUMNS) + 0.5, np.arange(ROWS) + 0.5)
    height = 1.0 + np.sin(column / 150.0) * np.sin(row / 170.0)
    ray = rig.ray(column, row)
    at = rig.coordinate(ray, ray.t_at(height), "column")[0]
    shown = PhaseShift(periods_px=(FINE, COARSE)).frames()
    rng = np.random.default_rng(0)
    frames = np.empty((1, len(shown), ROWS, COLUMNS), np.uint8)
    for k, frame in enumerate(shown):
        ideal = 120 + 80 * np.cos(2 * np.pi * at / frame.period_px + frame.phase_shift_rad)
        frames[0, k] = np.round(ideal + rng.normal(0, 2, ideal.shape))
    stack = Stack(frames, shown, (1.0,), SimpleSensor(sigma_dn=2.0), calibration)
    return stack, height.astype(np.float32)


def numpy_decoder(stack: Stack) -> Callable[[Stack], tuple[Image, Image, NDArray[np.bool_]]]:
    """The formulas as one would write them; the rig's per-pixel coefficients are made once, outside the timing.

    ``u = a + c h`` for parallel rays: a per column and row, c one number.
    """
    assert stack.calibration is not None
    rig = View(stack.calibration, 0).rig
    corner = rig.ray(np.array([0.5, 1.5, 0.5]), np.array([0.5, 0.5, 1.5]))
    zero = rig.coordinate(corner, corner.t_at(0.0), "column")[0]
    c = float(rig.coordinate(corner, corner.t_at(1.0), "column")[0][0] - zero[0])
    plane = (
        zero[0]
        + (zero[1] - zero[0]) * np.arange(COLUMNS)[None, :]
        + (zero[2] - zero[0]) * np.arange(ROWS)[:, None]
    ).astype(np.float32)
    middle = plane + np.float32(c)

    def work(one: Stack) -> tuple[Image, Image, NDArray[np.bool_]]:
        i = one.frames[0].astype(np.float32)
        fine_s, fine_c = i[3] - i[1], i[0] - i[2]
        coarse_s, coarse_c = i[7] - i[5], i[4] - i[6]
        fine = np.arctan2(fine_s, fine_c)
        coarse = np.arctan2(coarse_s, coarse_c)
        modulation = np.float32(0.5) * np.sqrt(fine_s * fine_s + fine_c * fine_c)
        order = np.round(middle / np.float32(COARSE) - coarse / TURN)
        turns = (order + coarse / TURN) * np.float32(COARSE / FINE) - fine / TURN
        fringe = np.round(turns)
        height = ((fringe + fine / TURN) * np.float32(FINE) - plane) / np.float32(c)
        good = (modulation > 20) & (i.max(axis=0) < 255) & (np.abs(turns - fringe) < 0.25)
        return height, modulation, good

    return work


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def cpu_seconds(work: Callable[[], object], runs: int = 5) -> float:
    """Least CPU time of a few runs, all threads together."""

    def once() -> float:
        start = time.process_time()
        work()
        return time.process_time() - start

    return min(once() for _ in range(runs))


def compare(stack: Stack, truth: Image, pairs: int) -> float:
    """Print one line for a type of frames; the median of the paired ratios."""
    baseline = numpy_decoder(stack)
    rec, (height, _, good) = decode.reconstruct(stack), baseline(stack)
    for name, found, mask in (("ours", rec.height_mm, rec.valid), ("NumPy", height, good)):
        # a tenth of a period: both must have decoded every pixel, or the comparison means nothing
        wrong = float(np.mean(~mask | (np.abs(found - truth) > 0.1)))
        if wrong > 1e-4:
            raise SystemExit(f"{name} decoded {wrong:.2%} of the pixels wrongly")
    # CPU time of all threads is what a busy machine leaves comparable
    cpu = [
        cpu_seconds(work) for work in (lambda: decode.reconstruct(stack), lambda: baseline(stack))
    ]
    bgr = stack.frames[0].astype(np.float32)
    sine, cosine = bgr[3] - bgr[1], bgr[0] - bgr[2]
    angle, copied = np.empty_like(sine), np.empty_like(stack.frames)
    runs = []
    for _ in range(pairs):
        runs.append(
            (
                seconds(lambda: decode.reconstruct(stack)),
                seconds(lambda: baseline(stack)),
                seconds(lambda: np.copyto(copied, stack.frames)),
                seconds(lambda: [cv2.phase(cosine, sine, angle) for _ in range(2)]),
            )
        )
    ours, theirs, copy, opencv = (
        1e3 * statistics.median(times) for times in zip(*runs, strict=True)
    )
    ratio = statistics.median(b / a for a, b, _, _ in runs)
    bandwidth = 2 * stack.frames.nbytes / copy / 1e6
    print(
        f"{stack.frames.dtype!s:8} reconstruct {ours:6.1f} ms  NumPy {theirs:6.1f} ms: {ratio:4.1f} x  "
        f"(CPU {1e3 * cpu[0]:.0f} and {1e3 * cpu[1]:.0f} ms: {cpu[1] / cpu[0]:.1f} x)  |  "
        f"copy of the frames {copy:5.1f} ms ({bandwidth:.0f} GB/s): {ours / copy:3.1f} copies  |  "
        f"two cv2.phase {opencv:5.1f} ms"
    )
    return ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=9)
    pairs = parser.parse_args().pairs
    stack, truth = capture()
    ratios = {
        kind: compare(replace(stack, frames=stack.frames.astype(kind)), truth, pairs)
        for kind in (np.uint8, np.uint16, np.float32)
    }
    print(f"target: {TARGET:g} x for uint8")
    return 0 if ratios[np.uint8] >= TARGET else 1


if __name__ == "__main__":
    raise SystemExit(main())
