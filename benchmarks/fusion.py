"""Speed of fused decoding against the machine's memory.

Four exposures of twelve float32 frames (three periods, four steps) of 5 Mpx, from counts to phase, order, modulation,
sigma and reason, in one kernel. Each rule takes turns with a copy on all cores. Bandwidth counts every byte of frames, once,
and every byte of result written; the copy's, every byte read and written.
"""

import numpy as np

import decode
from benchmarks.decode import written_bytes
from benchmarks.result import Result, Target, main
from benchmarks.turns import Copy, take_turns
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import Emva
from scenes.files.stack import Stack

TARGET = Target("ratio", "at least", 0.5)
# A plane of this size in float32 is a multiple of 128 KiB, as a camera's may be: all 48 then meet in the same set of 16 lines
# of the second-level cache. With 64 bytes between planes `single` takes a fifth less time, the rules below 2 to 11 %.
COLUMNS, ROWS = 2448, 2048
C_PX_PER_MM, HEIGHTS_MM = 4.0, (0.0, 180.0)
TIMES_MS = (0.25, 1.0, 4.0, 16.0)
RULES = ("max-modulation", "phasor-sum", "inverse-variance", "masked-least-squares", "censored-ml")
# What the target is asked of: rules without an inner loop. The likelihood's takes what clipping there is to resolve.
JUDGED = RULES[:-1]
CLIPPED = 0.1


def capture(clipped: float, rows: int) -> Stack:
    """Fringes over a scene of which a fraction clips in the two longer exposures, in blocks as parts of a board are."""
    rng = np.random.default_rng(0)
    shown = PhaseShift(periods_px=(16.0, 128.0, 1024.0)).frames()
    sensor = Emva()
    column = np.arange(COLUMNS) + 0.5
    at = column + C_PX_PER_MM * 90.0 * (1.0 + np.sin(column / 300.0))
    blocks = rng.random((rows // 64, COLUMNS // 51 + 1)) < clipped
    bright = np.where(np.kron(blocks, np.ones((64, 51)))[:rows, :COLUMNS], 800.0, 90.0)
    bright = bright.astype(np.float32)
    frames = np.empty((len(TIMES_MS), len(shown), rows, COLUMNS), np.float32)
    for e, time_ms in enumerate(TIMES_MS):
        for k, f in enumerate(shown):
            wave = 1.0 + 0.9 * np.cos(2.0 * np.pi * at / f.period_px + f.phase_shift_rad)
            frames[e, k] = bright * (time_ms * wave).astype(np.float32) + sensor.black_level_dn
            noise = rng.standard_normal(COLUMNS, dtype=np.float32)
            frames[e, k] += np.sqrt(0.38 * frames[e, k]) * noise
    np.clip(np.rint(frames, out=frames), 0.0, 4054.0, out=frames)
    return Stack(frames, shown, TIMES_MS, sensor)


def measure(quick: bool) -> list[Result]:
    """Every rule's bandwidth."""
    stack = capture(CLIPPED, ROWS // 4 if quick else ROWS)
    return [_row(stack, rule, 3 if quick else 5) for rule in RULES]


def _row(stack: Stack, rule: str, rounds: int) -> Result:
    def work() -> decode.Reconstruction:
        return decode.reconstruct(
            stack, fusion=rule, c_px_per_mm=C_PX_PER_MM, height_range_mm=HEIGHTS_MM
        )

    rec = work()
    moved = stack.frames.nbytes + written_bytes(rec)
    copy = Copy(moved // 2)
    turns = take_turns([work, copy], rounds)
    return turns.rate(
        rule,
        "copy on all cores",
        [1e-9 * moved, copy.moved_gb],
        "GB/s",
        target=TARGET if rule in JUDGED else None,
        note=f"4 exposures x 12 frames of {COLUMNS} x {stack.resolution[1]} float32, {CLIPPED:.0%} clip in the longer "
        f"ones, {moved / 1e6:.0f} MB read and written",
    )


if __name__ == "__main__":
    raise SystemExit(main("fusion", __doc__, measure))
