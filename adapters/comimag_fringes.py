"""PyPI `fringes` (C. Kludt) as an outside decoder: phase shifting with temporal unwrapping.

    python comimag_fringes.py MANIFEST OUTPUT.npz [EXPOSURE]

Needs `pip install fringes`, in an environment of its own (it brings opencv-contrib-python). Reads a folder that
`fringebench export` wrote and knows nothing else of the project. For each axis with fringes the output holds

- ``<axis>_px``: projector coordinate; ``<axis>_seconds``: time of a second decode, compiled;
- ``phase_<axis>_<period>_rad``: wrapped phase of each set; ``modulation_<axis>_<period>_dn``.

`fringes` shows ``cos(2 pi (x - x0) / l - 2 pi k / N + p0)`` with p0 = pi by default; with p0 = 0, reversed shifts and x our
continuous coordinate these are the project's own fringes.
"""

import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from fringes import Fringes


def main(manifest: Path, output: Path, exposure: int) -> None:
    """Decode one exposure of an exported stack, axis by axis."""
    tree = tomllib.loads(manifest.read_text("utf-8"))
    times = len(tree["exposures_ms"])
    count = len(tree["files"]) // times
    names = tree["files"][exposure * count : (exposure + 1) * count]
    sets: dict[str, list[tuple[float, int, int]]] = {}
    at = 0
    for shown in tree["frames"]:
        if shown["kind"] == "fringes":
            if (
                "shifts_deg" in shown
                or shown.get("first_phase_deg")
                or shown.get("direction", 1) != 1
            ):
                raise SystemExit("fringes reads equal steps that begin at 0")
            sets.setdefault(shown["axis"], []).append((shown["period_px"], shown["steps"], at))
            at += shown["steps"]
        elif shown["kind"] == "gray":
            at += shown["bits"] * (1 if shown.get("inverse") == "none" else 2)
        else:
            at += shown.get("count", 1)
    if not sets:
        raise SystemExit("nothing here for fringes: no phase-shifted fringes")
    found: dict[str, Any] = {}
    for axis, shown_sets in sets.items():
        used = [names[start + k] for _, steps, start in shown_sets for k in range(steps)]
        frames = np.stack(
            [cv2.imread(str(manifest.parent / name), cv2.IMREAD_UNCHANGED) for name in used]
        )
        found |= decode(axis, shown_sets, frames[..., None], tree["projector_resolution"])
    np.savez(output, **found)


def decode(axis: str, sets: list[tuple[float, int, int]], frames: Any, size: list[int]) -> Any:
    """One axis' frames (frame, row, col, 1)."""
    # `fringes` counts along its own X; rows are given to it as columns of a turned screen.
    across, along = size if axis == "column" else size[::-1]
    setup = Fringes()
    setup.X, setup.Y, setup.D = across, along, 1
    setup.K = len(sets)
    setup.l = [period for period, _, _ in sets]
    setup.N = [steps for _, steps, _ in sets]
    setup.p0, setup.reverse = 0.0, True
    if not np.allclose(np.ravel(setup.l), [period for period, _, _ in sets]):
        raise SystemExit(f"fringes cannot show periods {[s[0] for s in sets]}: it took {setup.l}")
    _, modulation, position, phase, *_ = setup.decode(frames, verbose=True)
    start = time.perf_counter()
    setup.decode(frames)
    found = {f"{axis}_px": position[0, ..., 0], f"{axis}_seconds": time.perf_counter() - start}
    for k, (period, _, _) in enumerate(sets):
        found[f"phase_{axis}_{period:g}_rad"] = phase.reshape(-1, *frames.shape[1:3])[k]
        found[f"modulation_{axis}_{period:g}_dn"] = modulation.reshape(-1, *frames.shape[1:3])[k]
    return found


if __name__ == "__main__":
    if len(sys.argv) not in (3, 4):
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) == 4 else 0)
