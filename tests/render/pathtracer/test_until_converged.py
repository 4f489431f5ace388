"""Tracing until the phase is known well enough: the error promised is the error there is, against a long reference."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
import scenes
from render.pathtracer import until_converged
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.support.errors import FringebenchWarning, RenderError, SceneError
from tests.render import rigs

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
    return np.asarray(np.abs(z) >= STRAY_FRACTION * np.median(np.abs(z)[np.abs(z) > 0]))


def true_error(light: render.Transport, reference: NDArray[np.complex128]) -> float:
    """95th percentile of the phase's error over the lit pixels."""
    off = np.abs(np.angle(phasor(light) * reference.conj()))[lit(reference)]
    return float(np.quantile(off, 0.95))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "target"), [pytest.param("bench", 1e-2, marks=pytest.mark.trust), ("solder", 4e-3)]
)
def test_reached_error_bounds_the_true_error(name: str, target: float) -> None:
    scene = scenes.load(name, {"camera.resolution": [80, 60], "sampling.samples": 16})
    reference = phasor(render.trace(scene, seed=2**31, samples=REFERENCE))
    runs = [render.trace(scene, seed=seed, phase_error_rad=target) for seed in range(5)]
    assert all(run.phase_error and run.phase_error.met for run in runs)
    # The reference's own noise is sqrt(samples / REFERENCE) of the run's: it lifts what is seen by less than 3 %.
    assert max(run.samples for run in runs) < 0.06 * REFERENCE
    assert max(run.phase_error.passes for run in runs if run.phase_error) > until_converged.STAGE
    errors = np.array([true_error(run, reference) for run in runs])
    over = int((errors > 1.03 * target).sum())
    # Each may miss with probability 0.05: more misses of five than this come in less than one case of a thousand.
    assert stats.binom.sf(over - 1, 5, 0.05) > 1e-3, errors
    # Nor is it a loose bound: the estimate is that of the error itself. Over 4800 pixels with light by rare paths a
    # run's percentile scatters by 6 %, the mean of five by 3 %.
    reached = np.array([run.phase_error.reached_rad for run in runs if run.phase_error])
    assert 0.9 < np.mean(reached) / np.mean(errors) < 1.1


def test_light_is_the_mean_of_independent_passes() -> None:
    scene = scenes.load("step", TINY)
    light = render.trace(scene, seed=3, phase_error_rad=1.0)
    seeds = [
        int(np.random.SeedSequence(3, spawn_key=(i,)).generate_state(1, np.uint32)[0])
        for i in range(until_converged.STAGE)
    ]
    assert len(set(seeds)) == until_converged.STAGE
    passes = [render.trace(scene, seed=seed, samples=16) for seed in seeds]
    for name in ("total", "direct", "ambient"):
        mean = np.mean([getattr(p, name) for p in passes], axis=0, dtype=np.float64)
        # Eight roundings of float32 relative to the value.
        np.testing.assert_allclose(getattr(light, name), mean, rtol=8 * 2.0**-23, atol=1e-12)
    assert light.samples == until_converged.STAGE * 16
    assert light.seed == 3
    assert light.phase_error is not None
    assert light.phase_error.passes == until_converged.STAGE


def test_stated_noise_is_the_scatter_between_seeds() -> None:
    # A groove, in which nearly all pixels see as much indirect light.
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove(), depth=4)
    lights = [render.trace(scene, seed=seed, samples=8, phase_error_rad=1.0) for seed in range(16)]
    z = np.stack([phasor(light) for light in lights])
    noise = [image for light in lights if (image := light.render_noise_rad) is not None]
    mean = z.mean(axis=0)
    shows = lit(mean)
    stated = np.mean(np.square(noise)[:, shows])
    seen = np.var(np.angle(z * mean.conj()), axis=0, ddof=1)[shows].mean()
    # Eight passes of 16 seeds, measured in one pixel of eight: thousands of squares, known to a few per cent even with long tails.
    assert np.sqrt(stated / seen) == pytest.approx(1.0, abs=0.15)


def test_light_depends_on_the_seed_alone() -> None:
    scene = scenes.load("step", {**TINY, "sampling.phase_error_rad": 0.05})
    once, again, other = (render.trace(scene, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(once.total, again.total)
    assert once.phase_error == again.phase_error
    assert not np.array_equal(once.total, other.total)


def test_samples_given_in_the_call_win_over_the_scenes_phase_error() -> None:
    scene = scenes.load("step", {**TINY, "sampling.phase_error_rad": 0.05})
    assert render.trace(scene, samples=2).phase_error is None
    given = render.trace(scene, samples=2, phase_error_rad=0.5).phase_error
    assert given is not None
    assert given.target_rad == 0.5


def test_unreached_target_is_a_warning() -> None:
    scene = scenes.load("step", {**TINY, "sampling.most_samples": 200})
    with pytest.warns(FringebenchWarning, match=r"phase error .* after 128 samples .* 1e-05 were"):
        light = render.trace(scene, phase_error_rad=1e-5)
    assert light.phase_error is not None
    assert not light.phase_error.met
    assert light.phase_error.reached_rad is not None
    assert light.phase_error.reached_rad > 1e-5


def test_view_without_fringes_reaches_no_phase_error() -> None:
    # The plate faces up; a projector below it lights nothing that the camera sees.
    scene = scenes.load("step", {**TINY, "projectors.0.pose.origin_mm": [-150.0, 0.0, -260.0]})
    with pytest.warns(FringebenchWarning, match="no pixel shows a fringe"):
        light = render.trace(scene, phase_error_rad=1e-2)
    assert light.phase_error is not None
    assert not light.phase_error.met
    assert light.phase_error.reached_rad is None
    assert light.phase_error.pixels == 0


def test_light_without_noise_ends_after_the_first_stage() -> None:
    # Direct light at points: every pass is the same to the last bit.
    light = render.trace(scenes.load("step", TINY), depth=1, footprint=0.0, phase_error_rad=1e-6)
    assert light.phase_error is not None
    assert light.phase_error.met
    assert light.phase_error.passes == until_converged.STAGE


@pytest.mark.parametrize(
    ("overrides", "target", "said"),
    [
        ({}, 0.0, "phase_error_rad = 0.0"),
        ({}, float("nan"), "phase_error_rad = nan"),
        ({"sampling.most_samples": 100}, 1e-2, "lower sampling.samples to 12"),
        ({"patterns": {"kind": "gray-code", "bits": [10]}}, 1e-2, "gray-code patterns have no"),
    ],
)
def test_impossible_requests_are_refused(
    overrides: dict[str, object], target: float, said: str
) -> None:
    with pytest.raises(RenderError, match=said):
        render.trace(scenes.load("step", {**TINY, **overrides}), phase_error_rad=target)


def test_scene_with_an_impossible_target_is_refused() -> None:
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
def test_nonlinear_projectors_and_two_axes_have_a_phase_error(changes: dict[str, object]) -> None:
    scene = scenes.load("step", {**TINY, **changes})
    light = render.trace(scene, phase_error_rad=0.05)
    assert light.phase_error is not None
    assert light.phase_error.met
    assert light.phase_error.pixels > 0.9 * 40 * 30


def test_percentile_and_its_bound_are_those_of_the_errors() -> None:
    # Errors of pixels whose sigmas differ ten thousand fold, seven halvings each: the truth by numbers of their own.
    rng = np.random.default_rng(5)
    sigma = rng.lognormal(-6.0, 2.0, 4000)
    truth = float(np.quantile(np.abs(rng.standard_normal((500, 4000)) * sigma), 0.95))
    found = [
        until_converged.percentile(np.abs(rng.standard_normal((7, 4000)) * sigma), 0.05)
        for _ in range(200)
    ]
    sizes, bounds = np.array(found).T
    assert abs(sizes.mean() / truth - 1.0) < 4.0 * sizes.std() / sizes.mean() / np.sqrt(200) + 1e-3
    # The bound fails in at most one case of twenty.
    assert stats.binom.sf((bounds < truth).sum() - 1, 200, 0.05) > 1e-3
    assert bounds.mean() < 1.2 * truth


def test_few_pixels_have_a_bound_above_their_largest_error() -> None:
    errors = np.abs(np.random.default_rng(1).standard_normal((7, 12)))
    assert until_converged.percentile(errors, 0.025)[1] > np.quantile(errors, 0.95)


def test_file_keeps_the_phase_error_reached(tmp_path: Path) -> None:
    light = render.trace(scenes.load("step", TINY), phase_error_rad=0.5)
    light.write(tmp_path / "transport.exr")
    again = render.Transport.read(tmp_path / "transport.exr")
    assert again.phase_error == light.phase_error
    assert again.samples == light.samples


def test_progress_never_falls_and_reports_each_pass() -> None:
    shares: list[float] = []
    details: list[str] = []

    class Bar:
        def __call__(self, share: float) -> None:
            shares.append(share)

        def detail(self, text: str) -> None:
            details.append(text)

    light = render.trace(scenes.load("step", TINY), phase_error_rad=3e-3, progress=Bar())
    assert light.phase_error is not None
    assert len(details) == light.phase_error.passes > until_converged.STAGE
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert details[0] == "pass 1, 0 of about 128 samples"
    # Noise falls with the root of the samples, so no forecast is far beyond what it takes.
    forecasts = [int(text.split()[-2]) for text in details]
    assert light.samples <= max(forecasts) <= 2 * light.samples


def test_samples_are_rounded_up_to_an_even_number() -> None:
    assert [until_converged._even(n) for n in (0.1, 1.0, 2.0, 2.1, 7.0, 8.0)] == [2, 2, 2, 4, 8, 8]
