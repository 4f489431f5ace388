"""Strategies that choose exposure times for a scene from first pictures of it."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from decode.fusion.merging import MaxModulationOfRepeats
from evaluation.hdr.capture_strategies import PlannedCapture, Strategy, take
from evaluation.hdr.light_budget import LightBudget, Reference, Shoot, Shot
from evaluation.theory.cramer_rao import UNKNOWN_RAD2, FringeLight, phase_bound_rad2
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import Sensor
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError

# Pixels that are planned for, evenly spaced in the order of their peaks, and the least signal to noise of a fringe to count.
PIXELS = 256
BRIGHTEST = 256
FRINGE_SIGMAS = 3.0
# Planned series: exposures, and the ratio of each to the next.
COUNTS = (1, 2, 3, 4)
RATIOS = (2.0, 4.0, 8.0, 16.0)
# Longest exposures that are tried, from the reference's shortest up, and how far beyond its longest.
TOPS_PER_OCTAVE = 1.5
BEYOND = 4.0
# Clusters at most; one more is tried while the last lowered the distances to their centres by this share.
CLUSTERS = 6
IMPROVEMENT = 0.2
# Clusters whose pixels differ by less than this share on average are not split.
ALIKE = 0.1
# The brightest sample that a cluster's exposure may reach, as a share of saturation; all but this percentage keep below.
HEADROOM = 0.9
PERCENT = 1.0


@dataclass(frozen=True, eq=False)
class _FirstLook:
    """What first pictures showed of some pixels."""

    shot: Shot
    """How they were taken."""
    lights: tuple[FringeLight, ...]
    """(pixel,) of the finest and of the coarsest fringe, which has more contrast and clips first."""
    weight: NDArray[np.float64]
    """(pixel,) how many pixels each represents."""
    sensor: Sensor

    @classmethod
    def at(cls, shoot: Shoot, reference: Reference) -> "_FirstLook":
        """Three steps of both fringes at the shortest and the middle exposure; of several projectors each pixel's best."""
        base = reference.patterns
        assert isinstance(base, PhaseShift)
        periods = tuple(sorted({min(base.periods_px), max(base.periods_px)}))
        few = {"steps": 3, "shifts_rad": None, "gray": None, "axes": base.axes[:1]}
        shown = base.model_copy(update={**few, "periods_px": periods})
        shot = Shot(shown, (min(reference.times_ms), reference.middle_ms))
        stack = shoot(shot)
        # (projector, fringe, offset cosine sine and modulation in sigma, row, col)
        seen = np.stack([_fringes(stack, p, shown) for p in range(reference.projectors)])
        best = seen[:, 0, 3].argmax(axis=0)[None, None, None]
        pixels = np.take_along_axis(seen, best, axis=0)[0]
        pixels = pixels[..., pixels[0, 3] > FRINGE_SIGMAS]
        if not pixels.size:
            raise ScoreError(
                "no pixel shows a fringe at the middle exposure: lengthen the exposures"
            )
        order = np.argsort(pixels[-1, 0] + np.hypot(pixels[-1, 1], pixels[-1, 2]))
        # All of the brightest: the few that clip make most of the error.
        even = np.linspace(0, order.size - 1, PIXELS).astype(np.intp)
        places = np.union1d(even, np.arange(max(order.size - BRIGHTEST, 0), order.size))
        weight = np.diff(places, prepend=-1).astype(np.float64)
        lights = tuple(FringeLight(*one[:3, order[places]]) for one in pixels)
        return cls(shot, lights, weight, stack.sensor)

    def error_rad(self, shot: Shot) -> float:
        """Predicted RMS error of the worse of both phases: the coarse one numbers the fine one."""
        frames = shot.patterns.frames()
        period = frames[0].period_px
        shifts = [
            f.phase_shift_rad
            for f in frames
            if (f.kind, f.axis, f.period_px) == ("fringe", frames[0].axis, period)
        ]
        # Without the information of clipped samples: near its limit no estimate has all of it.
        bounds = [
            phase_bound_rad2(light, shifts, shot.times_ms, self.sensor, censored=False)
            for light in self.lights
        ]
        worst = np.minimum(np.max(bounds, axis=0), UNKNOWN_RAD2)
        return float(np.sqrt(np.average(worst, weights=self.weight)))


def _fringes(stack: Stack, projector: int, patterns: PhaseShift) -> NDArray[np.float64]:
    """Of a projector's fringes (fringe, offset cosine sine and modulation in sigma, row, col), each pixel's from its
    longest unsaturated exposure.
    """
    sensor, mine = stack.sensor, [f.projector == projector for f in stack.patterns]
    dn = stack.frames[:, mine].astype(np.float64)
    longer = (dn[1] < stack.saturation_dn).all(axis=0)
    used = np.where(longer, dn[1], dn[0]) - sensor.black_level_dn
    slope = np.where(longer, *(_dn_per_light(sensor, t) for t in stack.exposure_ms[::-1]))
    noise = np.sqrt(sensor.variance_dn2(used.mean(axis=0), stack.exposure_ms[1]) * 2.0 / 3.0)
    found = []
    for period in patterns.periods_px:
        light = FringeLight.of(used / slope, patterns.frames(), patterns.axes[0], period)
        clear = np.hypot(light.cosine, light.sine) * slope / noise
        found.append([light.offset, light.cosine, light.sine, clear])
    return np.asarray(found)


def _dn_per_light(sensor: Sensor, time_ms: float) -> float:
    return float(sensor.mean_dn(1.0, time_ms) - sensor.mean_dn(0.0, time_ms))


def planned(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """The series of exposures with the least predicted error: root mean square over pixels of the bound on the phase.

    Series of 1 to 4 exposures in a constant ratio are tried, each repeated as the budget allows; pictures before them are
    counted. Under ``equal-frames``, where time is free, no exposure is longer than the reference's longest.
    """
    look = _FirstLook.at(shoot, reference)
    longest = max(reference.times_ms) * (1.0 if budget == "equal-frames" else BEYOND)
    octaves = np.log2(longest / min(reference.times_ms))
    tops = longest * 2.0 ** -np.arange(0.0, octaves + 0.5 / TOPS_PER_OCTAVE, 1.0 / TOPS_PER_OCTAVE)
    best: tuple[float, Shot] | None = None
    tried: set[tuple[float, ...]] = set()
    refused: ScoreError | None = None
    for top, count, ratio in product(tops, COUNTS, RATIOS):
        if count == 1 and ratio != RATIOS[0]:
            continue
        times = tuple(float(top / ratio**k) for k in range(count))
        try:
            shot = reference.filled(budget, Shot(reference.patterns, times), look.shot)
        except ScoreError as error:
            refused = refused or error
            continue
        # Series too long for the budget are shortened, often to one and the same.
        key = tuple(np.round(np.log(shot.times_ms), 6))
        if key in tried:
            continue
        tried.add(key)
        error_rad = look.error_rad(shot)
        if best is None or error_rad < best[0]:
            best = error_rad, shot
    if best is None:
        assert refused is not None
        raise refused
    return take(shoot, reference, best[1], look.shot)


def clustered(shoot: Shoot, reference: Reference, budget: LightBudget) -> PlannedCapture:
    """One exposure for each cluster of pixels that need about the same: k-means of the logarithm of the time that each
    needs.

    Clusters are added while the last one shortened the distances to their centres by a fifth and the budget has room. The published method takes a
    cluster's shortest time, here the first percentile. Pixels that need more than four times the longest exposure count as
    needing that.
    """
    look = _FirstLook.at(shoot, reference)
    sensor = look.sensor
    peaks = [light.offset + np.hypot(light.cosine, light.sine) for light in look.lights]
    peak = np.max(peaks, axis=0) * _dn_per_light(sensor, 1.0)
    room = HEADROOM * (sensor.saturation_dn - sensor.black_level_dn)
    need = np.log(np.minimum(room / peak, BEYOND * max(reference.times_ms)))
    distance, members = np.abs(need - need.mean()).sum(), [np.zeros(need.size, np.int32)]
    while len(members) < CLUSTERS and distance > ALIKE * need.size:
        centres, found = kmeans2(need, len(members) + 1, minit="++", rng=np.random.default_rng(0))
        shorter = np.abs(need - centres[found]).sum()
        if shorter > (1.0 - IMPROVEMENT) * distance:
            break
        distance = shorter
        members.append(found)
    refused: ScoreError | None = None
    for member in reversed(members):
        times = [np.exp(np.percentile(need[member == k], PERCENT)) for k in np.unique(member)]
        series = tuple(max(float(t), reference.min_exposure_ms) for t in sorted(times))
        try:
            shot = reference.filled(budget, Shot(reference.patterns, series), look.shot)
        except ScoreError as error:
            refused = error
            continue
        return take(shoot, reference, shot, look.shot)
    assert refused is not None
    raise refused


PLANNED = (
    Strategy("planned", planned, "censored-ml", "Wu et al. 2021"),
    Strategy("clustered", clustered, MaxModulationOfRepeats(), "Sensors 2025, 25, 4786"),
)
