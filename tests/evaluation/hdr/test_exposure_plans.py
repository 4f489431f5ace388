"""Exposures chosen by a plan: compared with a search of all series on a coarse grid, and with the clusters that were made."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

import render
import scenes
from evaluation.hdr.capture_strategies import CapturePlan
from evaluation.hdr.exposure_plans import clustered, planned
from evaluation.hdr.light_budget import BUDGETS, Reference, Shoot, Shot
from scenes.acquisition.patterns import PhaseShift
from scenes.acquisition.sensor import SimpleSensor
from scenes.files.stack import Stack
from scenes.support.errors import ScoreError

# A phase of which nothing is known is uniform over a turn.
UNKNOWN_RAD = np.pi / np.sqrt(3.0)


def two_surfaces(noise: float = 1.0) -> Shoot:
    """Half of the pixels returns 200 times the light of the others; all phases."""
    rate = np.repeat([0.5, 100.0], 500).reshape(20, 50)
    phase = np.tile(np.linspace(-3.0, 3.0, 50), (20, 1))
    sensor = SimpleSensor(sigma_dn=noise, bits=12)

    def shoot(shot: Shot) -> Stack:
        rng = np.random.default_rng(len(shot.times_ms))
        shown = shot.patterns.frames()
        waves = [rate * (1.0 + np.cos(phase + f.phase_shift_rad)) for f in shown]
        dn = np.multiply.outer(shot.times_ms, waves) + rng.normal(
            0.0, noise, (len(shot.times_ms), len(shown), *rate.shape)
        )
        counts = np.clip(np.rint(dn), 0, sensor.full_scale_dn).astype(np.uint16)
        return Stack(counts, shown, shot.times_ms, sensor)

    return shoot


REFERENCE = Reference(
    PhaseShift(periods_px=(16.0, 128.0)), (2.0, 20.0, 100.0, 200.0), overhead_ms=1.0
)


@pytest.mark.parametrize("plan", [pytest.param(planned, marks=pytest.mark.slow), clustered])
def test_plans_keep_budgets_and_count_their_metering_frames(plan: CapturePlan) -> None:
    for budget in BUDGETS:
        got = plan(two_surfaces(), REFERENCE, budget)
        assert got.frames == got.stack.frames.shape[0] * 8 + 2 * 6
        spent = {
            "equal-time": got.exposure_ms,
            "equal-frames": got.frames,
            "cycle-time": got.cycle_ms,
        }[budget]
        assert spent <= REFERENCE.cost(budget, REFERENCE.shot) * (1.0 + 1e-9)


def test_clusters_are_the_surfaces_and_keep_each_below_saturation() -> None:
    """Peaks of 1 and 200 DN/ms: 0.9 of 4095 DN after 3686 and 18.4 ms; no more than four times 200 ms."""
    times = sorted(set(clustered(two_surfaces(), REFERENCE, "equal-frames").shot.times_ms))
    assert times == pytest.approx([18.4, 800.0], rel=0.03)


def test_plan_has_an_exposure_for_the_bright_and_a_long_one_for_the_dark() -> None:
    times = planned(two_surfaces(), REFERENCE, "equal-time").shot.times_ms
    # The bright half clips from 20 ms; one exposure of less for both would leave the dark half half its modulation.
    assert min(times) < 20.0
    assert max(times) > 40.0


def test_scene_without_fringes_is_refused() -> None:
    dark = replace(REFERENCE, times_ms=(1e-4, 1e-3, 1e-2))
    with pytest.raises(ScoreError, match="no pixel shows a fringe"):
        planned(two_surfaces(), dark, "equal-frames")


@pytest.mark.trust
@pytest.mark.parametrize("name", ["bench", "ink-solder", "solder-grains", "spi"])
def test_planned_series_is_nearly_the_best_of_all_searched(name: str) -> None:
    """Of 298 series of 1 to 3 exposures on a grid of octaves, all of the light known, none is better by more than a ninth
    than the plan, which has seen noisy pictures and paid for them.
    """
    scene = scenes.load(name, {"camera.resolution": [96, 72], "sampling.samples": 16})
    light = render.trace(scene)
    assert isinstance(scene.patterns, PhaseShift)
    times_ms = render.expose(light, noise=False).exposure_ms
    reference = Reference(scene.patterns, times_ms)
    seen = render.through_lens(light).frames()[:, render.truth(scene, light).lit].astype(np.float64)
    sensor = scene.sensor
    per_light = float(sensor.mean_dn(1.0, 1.0) - sensor.mean_dn(0.0, 1.0))
    # The finest fringe and the coarsest, which clips first: phasors (fringe, 2, pixel), and frames (fringe, step, pixel).
    waves = np.array([[1.0, np.cos(a), -np.sin(a)] for a in 2.0 * np.pi * np.arange(4) / 4])
    fringes = np.stack([seen[:4], seen[-4:]])
    phasor = np.einsum("nw,snp->swp", np.linalg.pinv(waves)[1:].T, fringes)
    across = np.stack([0.0 * phasor[:, 0], -phasor[:, 1], phasor[:, 0]], axis=-1)
    across /= (phasor**2).sum(axis=1)[..., None]

    def information(time_ms: float) -> NDArray[np.float64]:
        """Of offset and phasor (fringe, pixel, 3, 3); samples within 3 sigma of clipping have none."""
        dn = sensor.mean_dn(fringes, time_ms)
        noise = sensor.variance_dn2(dn, time_ms)
        weight = (
            (per_light * time_ms) ** 2 / noise * (dn + 3.0 * np.sqrt(noise) < sensor.saturation_dn)
        )
        return np.asarray(np.einsum("snp,na,nb->spab", weight, waves, waves))

    def variance(known: NDArray[np.float64]) -> NDArray[np.float64]:
        """Of the worse of both phases (pixel,), rad^2."""
        scale = np.trace(known, axis1=-2, axis2=-1)[..., None, None] + 1e-9
        inverse = np.linalg.inv(known / scale + 1e-9 * np.eye(3)) / scale
        found = np.einsum("spa,spab,spb->sp", across, inverse, across).max(axis=0)
        return np.asarray(np.minimum(found, UNKNOWN_RAD**2))

    budget_ms = sum(times_ms)
    grid = 4.0 * max(times_ms) / 2.0 ** np.arange(12)
    single = np.stack([information(t) for t in grid])
    # Whatever the exposure, a deep shadow has no phase.
    alone = [variance(known * budget_ms / t) for known, t in zip(single, grid, strict=True)]
    measurable = np.min(alone, axis=0) < 0.3**2
    best = min(
        variance(single[list(k)].sum(axis=0) * budget_ms / grid[list(k)].sum())[measurable].mean()
        for count in (1, 2, 3)
        for k in combinations(range(12), count)
    )

    def shoot(shot: Shot) -> Stack:
        return render.expose(light, exposures=shot.times_ms, patterns=shot.patterns)

    got = planned(shoot, reference, "equal-time")
    assert got.exposure_ms == pytest.approx(budget_ms * len(scene.frames))
    known = np.sum([information(t) for t in got.shot.times_ms], axis=0)
    ratio = np.sqrt(best / variance(known)[measurable].mean())
    print(
        f"{name}: {ratio:.2f} of the best series"
    )  # Shown by `pytest -rP`, as docs/comparing.md says.
    assert ratio > 0.9
