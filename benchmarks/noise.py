"""Processor time to half the sensor's noise, against a pass of as many samples in every pixel, and against Mitsuba's `path`.

`bench` is traced until 95 % of its pixels have a phase error below a target (`sampling.phase_error_rad`) instead.

Noise of light paths is the scatter of the finest fringe's linear phase between seeds, over the pixels that `render_noise` counts:
lit, and bright enough to be measured. What it is compared with falls as 1 / sqrt(n), so its time to the same noise is

    t = time of n samples x (noise of n samples / noise reached)^2

for the label that takes longest; a label that got quieter than was asked for counts as asked for.

The targets on `spi` were set on paste as it was then, with a roughness of 0.5. Today's is rougher and mirrors less, so a plain pass
has less noise and there is less to gain. Both are judged.

`path` renders one frame at a time with multijitter, all frames with one seed, as a careful user would.
"""

import time
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

import render
import scenes
from benchmarks.light import Path, seeds
from benchmarks.result import Result, Target, main
from fringebench.experiments.noise_summary import describe, figures
from render.fringe_phasor import finest_fringes
from render.light_noise import sensor_noise
from scenes.shapes.materials import LIBRARY


class Case(NamedTuple):
    """What is traced to which share of the sensor's noise, and what it must win."""

    scene: str
    labels: tuple[str, ...]
    """Those of interest; none: all."""
    goal: float
    """Share of the sensor's noise, or phase error, rad. Grains would take minutes to 0.5; what the ratio is does not depend on
    it."""
    samples: int
    """Of the plain pass and of `path`."""
    statistic: str
    rival: str
    """The one that the target is about."""
    least: float
    """How many times faster it must be."""
    paste_roughness: float | None = None
    """Of `solder-paste`; None: as it is."""


PLAIN, PATH = "a pass of given samples", "path, multijitter"
RMS, P95 = "RMS", "95th percentile"
CASES = (
    Case("spi", ("paste",), 0.5, 16, RMS, PLAIN, 10.0, paste_roughness=0.5),
    Case("spi", (), 0.5, 16, RMS, PLAIN, 4.5, paste_roughness=0.5),
    Case("spi", ("paste",), 0.5, 16, RMS, PLAIN, 10.0),
    Case("spi", (), 0.5, 16, RMS, PLAIN, 4.5),
    Case("solder-grains", ("type-3", "type-4", "type-5"), 2.0, 32, RMS, PLAIN, 2.5),
    Case("bench", (), 2.5e-3, 64, P95, PATH, 60.0),
)
STEPS = 4

Image = NDArray[np.complex128]
Made = TypeVar("Made")


def measure(quick: bool) -> list[Result]:
    """Processor time to the target, of the tracer and of what it is compared with."""
    return [row for case in CASES for row in _case(case, quick)]


def _case(case: Case, quick: bool) -> list[Result]:
    size = scenes.load(case.scene).camera.resolution
    goal = case.goal * (4.0 if quick else 1.0)
    key = "render_noise" if case.statistic == RMS else "phase_error_rad"
    # Noise is compared in front of the lens, so it must be planned there.
    changes: dict[str, object] = {f"sampling.{key}": goal, "sensor.psf": "none"}
    if quick:
        changes["camera.resolution"] = [n // 4 for n in size]
    if case.labels:
        changes["sampling.labels"] = list(case.labels)
    if case.paste_roughness is not None:
        changes["materials.solder-paste"] = LIBRARY["solder-paste"].model_dump() | {
            "roughness": case.paste_roughness
        }
    scene = scenes.load(case.scene, changes)
    surfaces = render.surfaces(scene)
    draw = seeds(11)
    # Kernels are made before the clock starts.
    render.trace(scene, seed=draw(), samples=1, surfaces=surfaces)
    if case.statistic == RMS:
        render.trace(scene, seed=draw(), render_noise=50.0, surfaces=surfaces)
    else:
        render.trace(scene, seed=draw(), samples=2, phase_error_rad=1.0, surfaces=surfaces)
    ours, reached = _timed(lambda: render.trace(scene, seed=draw(), surfaces=surfaces))
    plain, light = _timed(
        lambda: render.trace(scene, seed=draw(), samples=case.samples, surfaces=surfaces), 6
    )
    own = [_phasor(t) for t in reached]
    regions = _regions(reached[0], case, goal)
    noises = [max(_noise(own, at, case.statistic), asked) for at, asked in regions]
    path = Path(scene, "multijitter", STEPS)
    path_s, shown = _timed(lambda: _frames(path, case.samples, draw()))
    rivals = (
        (PLAIN, plain, [_phasor(t) for t in light]),
        (PATH, path_s * len(scene.patterns.frames()) / STEPS, shown),
    )
    what = f"{case.scene}: {', '.join(case.labels) or 'all labels'}"
    if case.paste_roughness is not None:
        what += f", paste of roughness {case.paste_roughness:g}"
    said = describe(figures(reached[0]) or {})
    rows = []
    for rival, seconds, pair in rivals:
        theirs = [_noise(pair, at, case.statistic) for at, _ in regions]
        noise, their = max(zip(noises, theirs, strict=True), key=lambda each: each[1] / each[0])
        longer = seconds * (their / noise) ** 2
        rows.append(
            Result(
                f"{what}, against {rival}",
                ours,
                "s of processor",
                baseline=f"{rival}, to the same noise",
                baseline_value=longer,
                ratio=longer / ours,
                reads="x faster",
                target=Target("ratio", "at least", case.least) if rival == case.rival else None,
                note=f"{scene.camera.resolution[0]} x {scene.camera.resolution[1]}: {1e3 * noise:.2f} mrad "
                f"({case.statistic}); {said}; {rival}, {case.samples} samples: {1e3 * their:.2f} mrad "
                f"in {seconds:.1f} s",
            )
        )
    return rows


def _timed(make: Callable[[], Made], count: int = 2) -> tuple[float, list[Made]]:
    """Processor seconds of one, and `count` of them."""
    start = time.process_time()
    made = [make() for _ in range(count)]
    return (time.process_time() - start) / count, made


def _phasor(light: render.Transport) -> Image:
    """(row, col) of the first projector's finest fringe."""
    fringe = finest_fringes(light.scene.patterns, light.bases)[0]
    cosine, sine = fringe.phasor(light.total[0, : len(light.bases[0].channels)], 0)
    return np.asarray(cosine + 1j * sine)


def _frames(path: Path, samples: int, seed: int) -> Image:
    frames = [path.render(k, samples, seed).astype(np.float64) for k in range(STEPS)]
    return np.asarray((frames[0] - frames[2] + 1j * (frames[3] - frames[1])) / 2.0, np.complex128)


def _regions(
    light: render.Transport, case: Case, goal: float
) -> list[tuple[NDArray[np.bool_], float]]:
    """Pixels (row, col) whose noise is compared, and what was asked for there in rad: those of each label, or all."""
    truth = render.truth(light.scene, light)
    sensor = sensor_noise(light, truth.lit_by)
    assert sensor is not None
    counted = np.isfinite(sensor.height_mm)
    # The scenes have one projector.
    phase_rad = np.divide(
        sensor.height_mm, sensor.mm_per_rad[0], out=np.zeros(counted.shape), where=counted
    )
    if case.statistic == P95:
        return [(counted, 0.0)]
    labels = [counted & truth.region(label) for label in case.labels or light.labels]
    return [(at, goal * float(np.sqrt(np.mean(phase_rad[at] ** 2)))) for at in labels if at.any()]


def _noise(several: list[Image], judged: NDArray[np.bool_], statistic: str) -> float:
    """Noise of one's phase from the scatter of several, rad."""
    own = np.stack([image[judged] for image in several])
    mean = own.mean(axis=0)
    off = ((own - mean) * mean.conj()).imag / np.abs(mean) ** 2
    # A mean that holds the one compared with it is too near.
    off *= np.sqrt(len(own) / (len(own) - 1))
    if statistic == P95:
        return float(np.percentile(np.abs(off), 95.0))
    return float(np.sqrt(np.mean(off**2)))


if __name__ == "__main__":
    raise SystemExit(main("noise", __doc__, measure))
