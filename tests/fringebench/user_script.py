"""A script of 30 lines as a user writes it; `test_user_types.py` has it checked by mypy and pyright."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import fringebench as fb


def heights(stack: fb.Stack) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A decoder of one's own."""
    rec = fb.reconstruct(stack, fusion="single", saturation="ignore", min_modulation_dn=5.0)
    return rec.height_mm, rec.valid


def main(folder: Path) -> None:
    """Render, decode, score, compare."""
    scene: fb.Scene = fb.load("bench", {"camera.resolution": [160, 120]})
    transport = fb.trace(scene, seed=0)
    stack: fb.Stack = fb.expose(transport, seed=1)
    truth: fb.Truth = fb.render.truth(scene, transport)
    rec = fb.decode.reconstruct(stack, fusion="max-modulation")
    rms: float | None = fb.score(rec, truth).regions["solder"].rms_mm
    rows, columns = rec.height_mm.shape
    print(rms, rows, columns, stack.exposure_ms[0], fb.__version__)
    result = fb.run(scene, folder)
    print(result.score.regions["base"].bias_mm, result.folder / "report.html")
    gate = fb.regress(heights, seeds=range(3))
    print(gate.passed, fb.compare(scene, ["single"]).entries[0].name)
    print(fb.budget(scene).absent, fb.dataset(scene, folder, 2).made, fb.Dataset(folder)[0].stack)


if __name__ == "__main__":
    main(Path("out"))
