"""Tracing until the phase is known well enough: the error promised is the error there is, against a long reference."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
import scenes
from render import refine
from scenes.errors import FringebenchWarning, RenderError, SceneError

# Samples of what runs are judged by: on solder, runs to 4e-3 rad stopped after 384 to 1024.
REFERENCE = 24576

# Fringes four times as wide, which so few pixels still see.
TINY = {
    "camera.resolution": [40, 30],
    "patterns.periods_px": [64.0, 256.0, 1024.0],
    "sampling.samples": 16,
}


def phasor(light: render.Transport) -> NDArray[np.complex128]:
    """(row, col) B exp(i phi) of the finest column fringe, the first of the basis after the mean."""
    assert [c.kind for c in light.bases[0].channels[1:3]] == ["cos", "sin"]
    return np.asarray(light.total[0, 1] + 1j * light.total[0, 2], dtype=np.complex128)


def lit(z: NDArray[np.complex128]) -> NDArray[np.bool_]:
    return np.asarray(np.abs(z) >= refine.STRAY * np.median(np.abs(z)[np.abs(z) > 0]))


def true_error(light: render.Transport, reference: NDArray[np.complex128]) -> float:
    """95th percentile of the phase's error over the lit pixels."""
    off = np.abs(np.angle(phasor(light) * reference.conj()))[lit(reference)]
    return float(np.quantile(off, 0.95))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "target"), [("bench", 2e-2), ("solder", 4e-3)])
def test_the_error_promised_is_less_than_the_error_there_is(name: str, target: float) -> None:
    scene = scenes.load(name, {"camera.resolution": [80, 60], "sampling.samples": 16})
    reference = phasor(render.trace(scene, seed=2**31, samples=REFERENCE))
    runs = [render.trace(scene, seed=seed, phase_error_rad=target) for seed in range(5)]
    assert all(run.phase_error and run.phase_error.met for run in runs)
    # The reference's own noise is sqrt(samples / REFERENCE) of the run's: it lifts what is seen by less than 3 %.
    assert max(run.samples for run in runs) < 0.06 * REFERENCE
    assert max(run.phase_error.passes for run in runs if run.phase_error) > refine.STAGE
    errors = np.array([true_error(run, reference) for run in runs])
    over = int((errors > 1.03 * target).sum())
    # Each may miss with probability 0.05: more misses of five than this come in less than one case of a thousand.
    assert stats.binom.sf(over - 1, 5, 0.05) > 1e-3, errors
    # And it is no idle worst case: the estimate is that of the error itself. Over 4800 pixels with light by rare paths a
    # run's percentile scatters by 6 %, the mean of five by 3 %.
    reached = np.array([run.phase_error.reached_rad for run in runs if run.phase_error])
    assert 0.9 < np.mean(reached) / np.mean(errors) < 1.1


def test_passes_share_random_numbers_or_their_mean_is_not_that_of_their_samples() -> None:
    scene = scenes.load("step", TINY)
    light = render.trace(scene, seed=3, phase_error_rad=1.0)
    seeds = [
        int(np.random.SeedSequence(3, spawn_key=(i,)).generate_state(1, np.uint32)[0])
        for i in range(refine.STAGE)
    ]
    assert len(set(seeds)) == refine.STAGE
    passes = [render.trace(scene, seed=seed, samples=16) for seed in seeds]
    for name in ("total", "direct", "ambient"):
        mean = np.mean([getattr(p, name) for p in passes], axis=0, dtype=np.float64)
        # Eight roundings of float32 relative to the value.
        np.testing.assert_allclose(getattr(light, name), mean, rtol=8 * 2.0**-23, atol=1e-12)
    assert light.samples == refine.STAGE * 16
    assert light.seed == 3
    assert light.phase_error is not None
    assert light.phase_error.passes == refine.STAGE


def test_the_same_seed_gives_other_light_or_another_seed_the_same() -> None:
    scene = scenes.load("step", {**TINY, "sampling.phase_error_rad": 0.05})
    once, again, other = (render.trace(scene, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(once.total, again.total)
    assert once.phase_error == again.phase_error
    assert not np.array_equal(once.total, other.total)


def test_samples_given_outright_do_not_win_over_the_scenes_phase_error() -> None:
    scene = scenes.load("step", {**TINY, "sampling.phase_error_rad": 0.05})
    assert render.trace(scene, samples=2).phase_error is None
    given = render.trace(scene, samples=2, phase_error_rad=0.5).phase_error
    assert given is not None
    assert given.target_rad == 0.5


def test_an_unreached_target_is_silent() -> None:
    scene = scenes.load("step", {**TINY, "sampling.most_samples": 200})
    with pytest.warns(FringebenchWarning, match=r"phase error .* after 128 samples .* 1e-05 were"):
        light = render.trace(scene, phase_error_rad=1e-5)
    assert light.phase_error is not None
    assert not light.phase_error.met
    assert light.phase_error.reached_rad is not None
    assert light.phase_error.reached_rad > 1e-5


def test_darkness_passes_for_a_phase_that_is_known() -> None:
    # The plate faces up; a projector below it lights nothing that the camera sees.
    scene = scenes.load("step", {**TINY, "projectors.0.pose.origin_mm": [-150.0, 0.0, -260.0]})
    with pytest.warns(FringebenchWarning, match="no pixel shows a fringe"):
        light = render.trace(scene, phase_error_rad=1e-2)
    assert light.phase_error is not None
    assert not light.phase_error.met
    assert light.phase_error.reached_rad is None


def test_light_without_noise_is_traced_on_and_on() -> None:
    # Direct light at points: every pass is the same to the last bit.
    light = render.trace(scenes.load("step", TINY), depth=1, footprint=0.0, phase_error_rad=1e-6)
    assert light.phase_error is not None
    assert light.phase_error.met
    assert light.phase_error.passes == refine.STAGE


@pytest.mark.parametrize(
    ("overrides", "target", "said"),
    [
        ({}, 0.0, "phase_error_rad = 0.0"),
        ({}, float("nan"), "phase_error_rad = nan"),
        ({"sampling.most_samples": 100}, 1e-2, "lower sampling.samples to 12"),
        ({"patterns": {"kind": "gray-code", "bits": [10]}}, 1e-2, "gray-code patterns have no"),
    ],
)
def test_what_cannot_be_asked_for_is_accepted(
    overrides: dict[str, object], target: float, said: str
) -> None:
    with pytest.raises(RenderError, match=said):
        render.trace(scenes.load("step", {**TINY, **overrides}), phase_error_rad=target)


def test_a_scene_may_ask_for_what_no_trace_allows() -> None:
    with pytest.raises(SceneError, match="phase_error_rad"):
        scenes.load("step", {"sampling.phase_error_rad": 0.0})


@pytest.mark.parametrize(
    "changes",
    [
        {"projectors.0.gamma": 2.2, "projectors.0.bits": 8},
        {"patterns.axes": ["column", "row"], "patterns.steps": 5},
    ],
    ids=["tables of a bent projector", "two axes"],
)
def test_other_bases_have_no_phase_error(changes: dict[str, object]) -> None:
    scene = scenes.load("step", {**TINY, **changes})
    light = render.trace(scene, phase_error_rad=0.05)
    assert light.phase_error is not None
    assert light.phase_error.met
    assert light.phase_error.pixels > 0.9 * 40 * 30


def test_the_percentile_or_its_bound_is_not_that_of_the_errors() -> None:
    # Errors of pixels whose sigmas differ ten thousand fold, seven halvings each: the truth by numbers of their own.
    rng = np.random.default_rng(5)
    sigma = rng.lognormal(-6.0, 2.0, 4000)
    truth = float(np.quantile(np.abs(rng.standard_normal((500, 4000)) * sigma), 0.95))
    found = [
        refine.percentile(np.abs(rng.standard_normal((7, 4000)) * sigma), 0.05) for _ in range(200)
    ]
    sizes, bounds = np.array(found).T
    assert abs(sizes.mean() / truth - 1.0) < 4.0 * sizes.std() / sizes.mean() / np.sqrt(200) + 1e-3
    # The bound fails in at most one case of twenty.
    assert stats.binom.sf((bounds < truth).sum() - 1, 200, 0.05) > 1e-3
    assert bounds.mean() < 1.2 * truth


def test_a_handful_of_pixels_is_enough_to_be_sure() -> None:
    errors = np.abs(np.random.default_rng(1).standard_normal((7, 12)))
    assert refine.percentile(errors, 0.025)[1] > np.quantile(errors, 0.95)


def test_a_file_forgets_what_was_reached(tmp_path: Path) -> None:
    light = render.trace(scenes.load("step", TINY), phase_error_rad=0.5)
    light.write(tmp_path / "transport.exr")
    again = render.Transport.read(tmp_path / "transport.exr")
    assert again.phase_error == light.phase_error
    assert again.samples == light.samples


def test_progress_turns_back_or_tells_no_pass() -> None:
    shares: list[float] = []
    told: list[str] = []

    class Bar:
        def __call__(self, share: float) -> None:
            shares.append(share)

        def detail(self, text: str) -> None:
            told.append(text)

    light = render.trace(scenes.load("step", TINY), phase_error_rad=3e-3, progress=Bar())
    assert light.phase_error is not None
    assert len(told) == light.phase_error.passes > refine.STAGE
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert told[0] == "pass 1, 0 of about 128 samples"
