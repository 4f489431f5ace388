"""Speed of fused decoding against the machine's memory: run `python -m benchmarks.fusion`.

Four exposures of twelve float32 frames (three periods, four steps) of 5 Mpx, from counts to phase, order, modulation,
sigma and reason, in one kernel. Each rule takes turns with a plain copy of the same 1 GB. Bandwidth counts every byte read
and every byte of result written; the copy's, every byte read and written. The ratio is the median of the pairs'. On a busy
machine it punishes whoever needs two cores at once, so the target is judged by CPU time: decoding's shared evenly by the
cores, the copy's as it is.
"""

import argparse
import os
import statistics
import time
from collections.abc import Callable

import numpy as np

import decode
from benchmarks.decode import cpu_seconds
from scenes.patterns import PhaseShift
from scenes.sensor import Emva
from scenes.stack import Stack

TARGET = 0.5
COLUMNS, ROWS = 2448, 2048
C_PX_PER_MM, HEIGHTS_MM = 4.0, (0.0, 180.0)
TIMES_MS = (0.25, 1.0, 4.0, 16.0)
RULES = ("max-modulation", "phasor-sum", "inverse-variance", "masked-least-squares", "censored-ml")
# What the target is asked of: rules without an inner loop. The likelihood's takes what clipping there is to resolve.
JUDGED = RULES[:-1]


def capture(clipped: float) -> Stack:
    """Fringes over a scene of which a fraction clips in the two longer exposures, in blocks as parts of a board are."""
    rng = np.random.default_rng(0)
    shown = PhaseShift(periods_px=(16.0, 128.0, 1024.0)).frames()
    sensor = Emva()
    column = np.arange(COLUMNS) + 0.5
    at = column + C_PX_PER_MM * 90.0 * (1.0 + np.sin(column / 300.0))
    blocks = rng.random((ROWS // 64, COLUMNS // 51 + 1)) < clipped
    bright = np.where(np.kron(blocks, np.ones((64, 51)))[:ROWS, :COLUMNS], 800.0, 90.0)
    bright = bright.astype(np.float32)
    frames = np.empty((len(TIMES_MS), len(shown), ROWS, COLUMNS), np.float32)
    for e, time_ms in enumerate(TIMES_MS):
        for k, f in enumerate(shown):
            wave = 1.0 + 0.9 * np.cos(2.0 * np.pi * at / f.period_px + f.phase_shift_rad)
            frames[e, k] = bright * (time_ms * wave).astype(np.float32) + sensor.black_level_dn
            noise = rng.standard_normal(COLUMNS, dtype=np.float32)
            frames[e, k] += np.sqrt(0.38 * frames[e, k]) * noise
    np.clip(np.rint(frames, out=frames), 0.0, 4054.0, out=frames)
    return Stack(frames, shown, TIMES_MS, sensor)


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def measure(stack: Stack, rule: str, pairs: int) -> float:
    """Print a rule's line; the ratio of bandwidths by CPU time."""

    def work() -> decode.Reconstruction:
        return decode.reconstruct(
            stack, fusion=rule, c_px_per_mm=C_PX_PER_MM, height_range_mm=HEIGHTS_MM
        )

    rec = work()
    images = (rec.height_mm, rec.sigma_mm, rec.modulation_dn, rec.offset_dn, rec.reason)
    written = sum(i.nbytes for i in images) + rec.exposure.nbytes
    written += rec.wrapped_rad.nbytes + rec.fringe_order.nbytes
    moved = stack.frames.nbytes + written
    copied = np.empty_like(stack.frames)
    runs = [(seconds(work), seconds(lambda: np.copyto(copied, stack.frames))) for _ in range(pairs)]
    ours, copy = (statistics.median(times) for times in zip(*runs, strict=True))
    ratio = statistics.median((moved / a) / (2 * stack.frames.nbytes / b) for a, b in runs)
    cores = os.cpu_count() or 1
    alone = (moved / (cpu_seconds(work) / cores)) / (
        2 * stack.frames.nbytes / cpu_seconds(lambda: np.copyto(copied, stack.frames))
    )
    print(
        f"{rule:22s} {1e3 * ours:6.0f} ms, {moved / ours / 1e9:5.1f} GB/s   copy {1e3 * copy:6.0f} ms, "
        f"{2 * stack.frames.nbytes / copy / 1e9:5.1f} GB/s   ratio {ratio:.2f}, "
        f"by CPU time {alone:.2f}   valid {rec.valid.mean():.1%}"
    )
    return alone


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--clipped", type=float, default=0.1, help="fraction of the image, 0 to 1")
    given = parser.parse_args()
    stack = capture(given.clipped)
    ratios = {rule: measure(stack, rule, given.pairs) for rule in RULES}
    print(f"target: {TARGET:g} of the copy's bandwidth for {', '.join(JUDGED)}")
    return 0 if min(ratios[rule] for rule in JUDGED) >= TARGET else 1


if __name__ == "__main__":
    raise SystemExit(main())
