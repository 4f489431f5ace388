"""An outside decoder that decodes on request: `python outside_program.py WHAT FRAMES.npy ANSWER.npy`.

Runs in its own environment and knows nothing of the project. WHAT: ``fringes`` (PyPI `fringes`, periods 16, 128 and 1024
px, four steps), ``sinusoids`` or ``gray`` (OpenCV's structured_light: three steps of 16 px; Gray code of 1024 x 768). Writes
one answer, prints a line (a version, or ``missing: ...``), then decodes once for each line it reads and prints wall and
processor seconds.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

SIZE = (1024, 768)


def fringes(frames: Any) -> tuple[str, Callable[[], Any]]:
    """Column coordinate, (row, col)."""
    from importlib.metadata import version

    from fringes import Fringes  # type: ignore[import-not-found,unused-ignore]

    setup = Fringes()
    setup.X, setup.Y, setup.D = *SIZE, 1
    setup.K, setup.l, setup.N = 3, [16.0, 128.0, 1024.0], [4, 4, 4]
    # Its fringes are cos(2 pi (x - x0) / l - 2 pi k / N + p0): with these, the project's own.
    setup.p0, setup.reverse = 0.0, True
    stack = frames[..., None]
    return f"fringes {version('fringes')}", lambda: setup.decode(stack)[2][0, ..., 0]


def sinusoids(frames: Any) -> tuple[str, Callable[[], Any]]:
    """Wrapped phase, (row, col)."""
    import cv2

    params = cv2.structured_light_SinusoidalPattern_Params()  # type: ignore[attr-defined,unused-ignore]
    params.width, params.height = SIZE
    params.nbrOfPeriods = SIZE[0] // 16
    params.shiftValue = 2.0 * np.pi / 3.0
    params.methodId = 1
    params.horizontal = params.setMarkers = False
    pattern = cv2.structured_light_SinusoidalPattern.create(params)  # type: ignore[attr-defined,unused-ignore]
    images = list(frames)
    # It pads to a size that transforms fast, and leaves the padding.
    rows, columns = images[0].shape
    return f"OpenCV {cv2.__version__}", lambda: pattern.computePhaseMap(images)[0][:rows, :columns]


def gray(frames: Any) -> tuple[str, Callable[[], Any]]:
    """Column plus half, (row, col): pixel by pixel, as the module offers for one camera."""
    import cv2

    pattern = cv2.structured_light.GrayCodePattern.create(*SIZE)  # type: ignore[attr-defined,unused-ignore]
    images = list(frames)
    rows, columns = images[0].shape

    def decode() -> Any:
        found = np.full((rows, columns), np.nan)
        for y in range(rows):
            for x in range(columns):
                wrong, at = pattern.getProjPixel(images, x, y)
                if not wrong:
                    found[y, x] = at[0] + 0.5
        return found

    return f"OpenCV {cv2.__version__}", decode


def main(what: str, frames: str, answer: str) -> None:
    """Serve until standard input ends."""
    make = {"fringes": fringes, "sinusoids": sinusoids, "gray": gray}[what]
    # Keep what libraries print out of the answers.
    answers, sys.stdout = sys.stdout, sys.stderr
    try:
        version, decode = make(np.load(frames))
    except (ImportError, AttributeError) as error:
        print(f"missing: {error}", file=answers, flush=True)
        return
    np.save(answer, decode())
    print(version, file=answers, flush=True)
    for _ in sys.stdin:
        wall, processor = time.perf_counter(), time.process_time()
        decode()
        spent = (time.perf_counter() - wall, time.process_time() - processor)
        print(json.dumps(spent), file=answers, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
