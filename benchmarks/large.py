"""Twelve frames of 2048 x 2048 pixels, 16 samples, three surface vertices, against one frame by `path`; and memory.

Memory is that of a process that does nothing but the pass; `path`'s of one that does nothing but one frame.
"""

import sys

from benchmarks.light import Path, scene, seeds, tracing
from benchmarks.process import python
from benchmarks.result import Result, Target, main
from benchmarks.trace import compared_with_path

SAMPLES = 16
TIME = Target("ratio", "at most", 3.0)
MEMORY = Target("value", "at most", 2.0)


def measure(quick: bool) -> list[Result]:
    """Time compared with `path`, and memory."""
    side, rounds = (512, 2) if quick else (2048, 3)
    shown = scene(size=(side, side), samples=SAMPLES)
    note = f"bench, {side} x {side}, {SAMPLES} samples, depth 3"
    rows = compared_with_path(shown, 3, rounds, TIME, note)
    ours, theirs = (
        python("-m", "benchmarks.large", "--in-process", what, str(side)).peak_mb / 1000
        for what in ("pass", "path")
    )
    rows.append(
        Result(
            "pass, peak resident memory", ours, "GB", "path, one frame", theirs, ours / theirs, target=MEMORY, note=note
        )
    )  # fmt: skip
    return rows


def in_process(what: str, side: int) -> None:
    """Run one pass, or one frame."""
    shown = scene(size=(side, side), samples=SAMPLES)
    if what == "pass":
        tracing(shown, seeds(3))()
    else:
        Path(shown, "independent").render(0, SAMPLES, 1)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--in-process"]:
        in_process(sys.argv[2], int(sys.argv[3]))
        sys.exit()
    raise SystemExit(main("large", __doc__, measure))
