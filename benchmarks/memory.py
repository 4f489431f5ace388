"""Peak resident memory of each stage as a command, compared with a process that only imports.

640 x 480 pixels of `bench`: 36 frames in three exposures.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.process import python
from benchmarks.result import Result, main

SIZES = {True: (320, 240), False: (640, 480)}


def measure(quick: bool) -> list[Result]:
    """Render, expose, decode, evaluate; and run, which holds all of it."""
    size = SIZES[quick]
    small = ("--set", f"camera.resolution=[{size[0]},{size[1]}]", "--set", "sampling.samples=16")
    imports = python("-c", "import fringebench, render; render.variant.use()").peak_mb
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        transport, truth, stack, rec = (
            folder / f"{kind}.exr" for kind in ("transport", "truth", "stack", "reconstruction")
        )
        stages: dict[str, Sequence[str | Path]] = {
            "render": ("bench", "-o", transport, "--truth", truth, *small),
            "expose": (transport, "-o", stack),
            "decode": (stack, "-o", rec),
            "evaluate": (rec, truth),
            "run": ("bench", "-o", folder / "run", *small),
        }
        peaks = {
            stage: python("-m", "fringebench", stage, *words).peak_mb
            for stage, words in stages.items()
        }
    note = f"bench, {size[0]} x {size[1]}, 16 samples, 12 frames, 3 exposures"
    return [
        Result(f"fringebench {stage}", peak, "MB", "imports alone", imports, peak / imports, note=note)
        for stage, peak in peaks.items()
    ]  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main("memory", __doc__, measure))
