"""Decoding compared with PyPI `fringes` and OpenCV's structured_light, on the same 8-bit frames, in turns.

They run in the environment whose python FRINGEBENCH_OUTSIDE_PYTHON names (docs/outside-decoders.md), or in this one where it
has them. All give coordinates or phases, no heights. `fringes` is compiled before it is timed. OpenCV decodes Gray
code of one camera pixel by pixel, called from Python: on a part of the image, so that rates are compared.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import decode
from benchmarks.outside_decoders import VARIABLE
from benchmarks.process import ROOT, ProgramFailedError
from benchmarks.result import Result, Target, main, not_run
from benchmarks.turns import Elsewhere, take_turns
from scenes import GrayCode, PhaseShift, SimpleSensor, Stack, load

FINE_PX = 16.0
TARGET = Target("ratio", "at least", 100.0)
TASKS: dict[str, tuple[str, Any]] = {
    "fringes": ("3 periods x 4 steps", PhaseShift(steps=4, periods_px=(16.0, 128.0, 1024.0))),
    "sinusoids": ("one period x 3 steps", PhaseShift(steps=3, periods_px=(1024.0,))),
    "gray": ("Gray code, both axes", GrayCode(axes=("column", "row"), bits=(10, 10), flat=False)),
}
NAMES = {
    "fringes": "fringes",
    "sinusoids": "OpenCV SinusoidalPattern",
    "gray": "OpenCV GrayCodePattern",
}
# Our decodes per turn. One takes a hundredth of the time of the others, and would start on idle cores and cold caches each
# time, which does not matter to them: rates are compared over similar times.
REPEATS = 20
# Part of the image for decoders that take a microsecond or more per pixel.
PART = (120, 160)


def capture(patterns: Any, size: tuple[int, int]) -> tuple[Stack, NDArray[np.float64]]:
    """A plane seen by bench's camera at that size (columns, rows); the stack, 8 bits, and the projector columns."""
    scene = load("bench", {"camera.resolution": list(size)})
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    at = {
        "column": 30.0 + 900.0 * x / size[0] + 60.0 * y / size[1],
        "row": 30.0 + 700.0 * y / size[1],
    }
    shown = patterns.frames()
    frames = np.empty((1, len(shown), size[1], size[0]), np.uint8)
    rng = np.random.default_rng(0)
    for k, frame in enumerate(shown):
        level = 40.0 + 160.0 * patterns.commanded(frame, at[frame.axis])
        frames[0, k] = np.rint(level + rng.normal(0.0, 1.0, level.shape))
    return Stack(frames, shown, (1.0,), SimpleSensor(sigma_dn=1.0), scene.calibration()), at[
        "column"
    ]


class Guest:
    """A program in another environment that decodes on request."""

    def __init__(self, process: "subprocess.Popen[str]", answer: Path) -> None:
        self._process = process
        self.version = self._line()
        self.answer = None if self.version.startswith("missing") else np.load(answer)

    def __call__(self) -> Elsewhere:
        assert self._process.stdin
        self._process.stdin.write("decode\n")
        self._process.stdin.flush()
        return Elsewhere(*json.loads(self._line()))

    def _line(self) -> str:
        assert self._process.stdout
        line = self._process.stdout.readline().strip()
        if not line:
            raise ProgramFailedError("the outside decoder ended without an answer")
        return line


@contextmanager
def guest(what: str, frames: NDArray[np.uint8]) -> Iterator[Guest]:
    """Start it, and end it."""
    interpreter = os.environ.get(VARIABLE) or sys.executable
    program = ROOT / "benchmarks" / "outside_program.py"
    with tempfile.TemporaryDirectory() as folder:
        given, answer = Path(folder) / "frames.npy", Path(folder) / "answer.npy"
        np.save(given, frames)
        process = subprocess.Popen(
            [interpreter, program, what, given, answer],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        with process:
            try:
                yield Guest(process, answer)
            finally:
                process.kill()


def measure(quick: bool) -> list[Result]:
    """Each outside decoder."""
    return [_row(what, (1280, 960) if quick else (2448, 2048), 3 if quick else 5) for what in TASKS]


def _row(what: str, size: tuple[int, int], rounds: int) -> Result:
    task, patterns = TASKS[what]
    name = f"{task}, compared with {NAMES[what]}"
    stack, truth = capture(patterns, size)
    shown, wanted = stack.frames[0], truth
    if what == "sinusoids":
        # Its filter finds no phase in one wide period; ours needs no unwrapping there. The arithmetic is the same.
        fine, _ = capture(PhaseShift(steps=3, periods_px=(FINE_PX,)), size)
        shown, wanted = fine.frames[0], truth % FINE_PX
    # Gray code pixel by pixel takes seconds: a part is enough.
    part = tuple(slice(n) for n in PART) if what == "gray" else (slice(None), slice(None))
    theirs_px, ours_px = stack.frames[0, 0][part].size, stack.frames[0, 0].size

    def once() -> decode.Reconstruction:
        return decode.reconstruct(stack, height="phase", axis="column")

    def work() -> None:
        for _ in range(REPEATS):
            once()

    with guest(what, np.ascontiguousarray(shown[:, *part])) as other:
        if other.answer is None:
            return not_run(name, f"{other.version}; set {VARIABLE} (docs/outside-decoders.md)")
        ours = np.asarray(once().phases["column"].coordinate_px)
        theirs = other.answer
        if what == "sinusoids":
            theirs = theirs * FINE_PX / (2.0 * np.pi) % FINE_PX
        # Both must have decoded, or the comparison means nothing: to 2 px, twice the noise of one period of 1024.
        for who, found, right in (("ours", ours, truth), (NAMES[what], theirs, wanted[part])):
            off = float(np.nanmedian(np.abs(found - right)))
            assert off < 2.0, f"{who} is {off:.1f} px off"
        turns = take_turns([work, other], rounds)
    return turns.rate(
        name,
        other.version,
        [1e-6 * REPEATS * ours_px, 1e-6 * theirs_px],
        "Mpx/s",
        target=TARGET if what == "fringes" else None,
        note=f"{len(stack.patterns)} frames of {size[0]} x {size[1]}, 8 bits, ours {REPEATS} times a turn"
        + (f", ours of 1024 px, theirs of {FINE_PX:g}" if what == "sinusoids" else "")
        + (f"; OpenCV a part of {PART[1]} x {PART[0]}" if what == "gray" else ""),
    )


if __name__ == "__main__":
    raise SystemExit(main("outside", __doc__, measure))
