"""How long Mitsuba's `path`, one render a frame, takes to the phase error that one pass for all frames has.

Phase of the finest fringes, from their four frames, against a long run of the pass with another seed; two errors, both of
lit pixels:

- the 95th percentile of |phase - reference|;
- the scatter (RMS) on flat, lit surfaces about a local quadratic, 9 x 9 pixels, which needs no reference.

The median would flatter: at few samples most pixels have caught no indirect light yet. `path` renders at two numbers of
samples, which shows how its error falls; its time to the pass's error is then

    t = 12 frames x time of one x (error of path / error of the pass)^2

since error falls as 1 / sqrt(n); the measured exponent is in the notes. A careful user renders all frames with one
seed: they then share their noise, and part of it leaves the phase. Also shown: a seed of its own for each frame.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

import render
import scenes
from benchmarks.light import Path, scene, seeds, tracing
from benchmarks.result import Result, Target, main
from benchmarks.turns import Turns, take_turns

TARGETS = {"multijitter": 60.0, "independent": 100.0}
STEPS = 4
WINDOW = 9
# Float32 holds a point 300 mm away to 3e-5 mm.
LEVEL_MM = 1e-3
# The reference has so many times the samples: it adds 1.5 % to errors that fall as 1 / sqrt(n).
LONGER = 32
# The second number of samples of `path`.
MORE = 4
P95, SCATTER = "95th percentile", "scatter on flats"
ERRORS = (P95, SCATTER)

Image = NDArray[np.float64]


class Judge:
    """Measures the error of fringes' frames on one scene."""

    def __init__(self, scene: scenes.Scene, reference: Image) -> None:
        """`reference`: phase (row, col)."""
        truth = render.truth(scene)
        self.reference = reference
        self.lit = truth.lit & np.isfinite(truth.column_px)
        period = scene.patterns.frames()[0].period_px
        self.ideal = 2.0 * np.pi * np.nan_to_num(truth.column_px.astype(np.float64)) / period
        self.flat = self.lit & level(truth)

    def errors(self, frames: Image) -> dict[str, float]:
        """In rad, of the finest fringes' four frames (frame, row, col)."""
        found = phase(frames)
        far = np.abs(wrap(found - self.reference))[self.lit]
        rest = scatter(wrap(found - self.ideal))[self.flat]
        return {P95: float(np.percentile(far, 95)), SCATTER: float(np.sqrt(np.mean(rest**2)))}


def phase(frames: Image) -> Image:
    """Wrapped phase of four steps."""
    return np.asarray(np.arctan2(frames[3] - frames[1], frames[0] - frames[2]), np.float64)


def wrap(angle: Image) -> Image:
    """To [-pi, pi)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi, np.float64)


def scatter(values: Image) -> Image:
    """Each pixel's distance from the quadratic fitted to the window about it, as large on average as its own error.

    The fit follows the pixel in part: of white noise 1 - h of the variance is left, h the pixel's own weight in it.
    """
    at = np.arange(WINDOW) - WINDOW // 2
    y, x = (grid.ravel() for grid in np.meshgrid(at, at, indexing="ij"))
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1).astype(np.float64)
    weights = np.linalg.pinv(terms)[0].reshape(WINDOW, WINDOW)
    rest = values - ndimage.correlate(values, weights, mode="nearest")
    return np.asarray(rest / np.sqrt(1.0 - weights[WINDOW // 2, WINDOW // 2]), np.float64)


def level(truth: scenes.Truth) -> NDArray[np.bool_]:
    """Pixels whose window is all one label, lit and level."""
    height = np.nan_to_num(truth.height_mm.astype(np.float64), nan=np.inf)
    one = np.ones(truth.label.shape, bool)
    for plane, most in ((truth.label.astype(np.float64), 0.0), (height, LEVEL_MM)):
        high, low = ndimage.maximum_filter(plane, WINDOW), ndimage.minimum_filter(plane, WINDOW)
        one &= high <= low + most
    lit = np.asarray(ndimage.minimum_filter(truth.lit, WINDOW), np.bool_)
    return np.asarray(one & lit & np.isfinite(height), np.bool_)


def measure(quick: bool) -> list[Result]:
    """The time `path` needs to the pass's errors, with each sampler, frames sharing a seed or not."""
    size, samples, rounds = ((160, 120), 16, 3) if quick else ((640, 480), 64, 5)
    shown = scene(size=size, samples=samples)
    draw = seeds(7)
    long = render.trace(shown, seed=draw(), samples=samples * LONGER)
    judge = Judge(shown, phase(long.frames()[:STEPS].astype(np.float64)))
    passes = [
        judge.errors(render.trace(shown, seed=draw()).frames()[:STEPS].astype(np.float64))
        for _ in range(3)
    ]
    ours = {name: float(np.median([one[name] for one in passes])) for name in ERRORS}
    rows: list[Result] = []
    for sampler, least in TARGETS.items():
        path = Path(shown, sampler, STEPS)
        turns = take_turns([tracing(shown, draw), path.one_frame(samples, draw)], rounds)
        for seeding in ("one seed", "a seed each"):
            theirs = [
                judge.errors(_frames(path, n, draw, seeding == "one seed"))
                for n in (samples, MORE * samples)
            ]
            rows += [
                _row(shown, turns, (sampler, seeding, name), ours[name], [one[name] for one in theirs], least)
                for name in ERRORS
            ]  # fmt: skip
    return rows


def _frames(path: Path, samples: int, draw: Callable[[], int], shared: bool) -> Image:
    """The finest fringes' frames."""
    first = draw()
    taken = [path.render(k, samples, first if shared else draw()) for k in range(STEPS)]
    return np.stack(taken).astype(np.float64)


def _row(
    shown: scenes.Scene,
    turns: Turns,
    what: tuple[str, str, str],
    ours: float,
    theirs: list[float],
    least: float,
) -> Result:
    """The pass and `path`, its time scaled to the pass's error."""
    sampler, seeding, name = what
    samples, frames = shown.sampling.samples, len(shown.patterns.frames())
    longer = frames * (theirs[0] / ours) ** 2
    exponent = np.log(theirs[0] / theirs[1]) / np.log(MORE)
    scaled = Turns(turns.wall_s * (1.0, longer), turns.processor_s * (1.0, longer))
    columns, rows = shown.camera.resolution
    return scaled.compared(
        f"{sampler}, {seeding}: {name}",
        f"path, {frames} frames to the same error",
        unit="s",
        target=Target("ratio", "at least", least),
        note=f"bench, {columns} x {rows}, {samples} samples: pass {1e3 * ours:.2f} mrad; path {1e3 * theirs[0]:.2f}, with "
        f"{MORE * samples} samples {1e3 * theirs[1]:.2f} (falls as n^-{exponent:.2f})",
    )


if __name__ == "__main__":
    raise SystemExit(main("quality", __doc__, measure))
