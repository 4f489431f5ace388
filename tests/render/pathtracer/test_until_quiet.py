"""Tracing to a share of the sensor's noise: the noise stated is the scatter between seeds, and nothing is biased."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
import scenes
from render.fringe_phasor import finest_fringes
from render.light_noise import SensorNoise, sensor_noise
from render.pathtracer import block_light, until_quiet
from render.pathtracer.block_light import BlockLight, Blocks
from render.pathtracer.cut_light import cut_to_sensor_noise, judged_pixels
from render.pathtracer.path_budget import (
    AIMED,
    BLOCK_PATHS,
    DIRECT,
    FIRST,
    PATHS_OF_PLACE,
    PILOT_LENS_PLACES,
    PILOT_PLACES,
    Pilot,
    blocks_needed,
    paths_needed,
    smooth_indirect,
)
from scenes.support.errors import RenderError, SceneError
from tests.render import rigs

# Fringes four times as wide, which so few pixels still see.
SMALL = {"camera.resolution": [40, 30], "patterns.periods_px": [64.0, 256.0, 1024.0]}


def phasor(light: render.Transport) -> NDArray[np.complex128]:
    """(row, col) B exp(i phi) of the finest column fringe, the first of the basis after the mean."""
    assert [c.kind for c in light.bases[0].channels[1:3]] == ["cos", "sin"]
    return np.asarray(light.total[0, 1] + 1j * light.total[0, 2], dtype=np.complex128)


def bright_groove(depth: int, period_px: float = 16.0) -> scenes.Scene:
    """A groove whose fringes the sensor measures: ten times the light of the rig's exposure."""
    groove = rigs.scene(
        rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove(), depth=depth
    )
    return scenes.parse(
        scenes.dumps(groove), {"exposures.times_ms": [10.0], "patterns.periods_px": [period_px]}
    )


# Some seeds miss the target on the few pixels of solder; what is stated must be right all the same.
@pytest.mark.filterwarnings("ignore:noise of light paths")
@pytest.mark.slow
def test_stated_noise_is_the_scatter_between_seeds() -> None:
    # Noise is that of the light in front of the lens.
    scene = scenes.load("bench", SMALL | {"sensor.psf": "none"})
    traced = [render.trace(scene, seed=seed, render_noise=1.0) for seed in range(16)]
    z = np.stack([phasor(light) for light in traced])
    noise = [light.render_noise_rad for light in traced]
    stated = np.mean([image**2 for image in noise if image is not None], axis=0)
    mean = z.mean(axis=0)
    seen = np.var((z * mean.conj()).imag / np.abs(mean) ** 2, axis=0, ddof=1)
    # Of a pixel at a shadow's border few places may all be dark: then nothing is stated.
    lit = (np.abs(mean) >= 0.1 * np.median(np.abs(mean))) & np.isfinite(stated)
    # The noisiest pixels, whose law has the longest tails, are left out of both alike: by what was stated.
    quiet = lit & (stated < np.quantile(stated[lit], 0.98))
    # Of 16 seeds a pixel's variance is known to sqrt(2 / 15) = 37 % by a normal law, by twice that with tails; noise is
    # spread over hundreds of pixels: 5 %.
    assert np.sqrt(seen[quiet].mean() / stated[quiet].mean()) == pytest.approx(1.0, abs=0.15)


def test_mean_light_is_that_of_the_plain_pass() -> None:
    scene = bright_groove(4)

    def mean(light: render.Transport) -> float:
        return float((light.total[0, 0] - light.direct[0, 0]).mean(dtype=np.float64))

    plain = [mean(render.trace(scene, seed=100 + seed, samples=128)) for seed in range(12)]
    quiet = [mean(render.trace(scene, seed=seed, render_noise=1.0)) for seed in range(24)]
    assert stats.ttest_ind(quiet, plain, equal_var=False).pvalue > 1e-3
    # Teeth: a bias of 5 % would be seen.
    assert stats.sem(quiet) < 0.01 * np.mean(plain)


def test_paths_that_end_by_chance_lose_no_light() -> None:
    groove = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove())

    def mean(depth: int, seed: int) -> float:
        light = render.trace(groove, seed=seed, samples=64, depth=depth)
        return float((light.total[0, 0] - light.direct[0, 0]).mean(dtype=np.float64))

    # At 8 vertices nothing ends by chance; what is cut there is below 1e-3 of the light.
    cut, whole = ([mean(depth, seed) for seed in range(20)] for depth in (8, 64))
    assert stats.ttest_ind(cut, whole, equal_var=False).pvalue > 1e-3
    assert stats.sem(whole) < 0.01 * np.mean(cut)


def test_every_label_reaches_the_share_asked_for() -> None:
    shares: list[float] = []
    light = render.trace(scenes.load("step", SMALL), render_noise=0.2, progress=shares.append)
    # What was planned does not suffice here, so that all three rounds are counted.
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert light.render_noise is not None
    assert light.render_noise.met
    assert set(light.render_noise.reached) == {"base", "step"}
    assert all(ratio is not None and ratio <= 0.21 for ratio in light.render_noise.reached.values())


def test_cut_light_is_the_mean_turn_of_phase_and_not_its_noise() -> None:
    # 800 pixels, 4 blocks each: what is cut turns phases by 0.1 rad in the left half; its noise of 0.3 rad is everywhere.
    shape, number = (20, 40), 4
    rng = np.random.default_rng(1)
    left = np.arange(40) < 20
    every = np.ones(shape, np.bool_)
    z = np.exp(1j * rng.uniform(0.0, 6.0, 800))
    turn = np.repeat((left * np.full(shape, 0.1)).ravel(), number) + rng.normal(0.0, 0.3, 3200)
    none = np.empty(0, np.float32)
    quick, deep = (
        BlockLight(
            none, none, none, (np.repeat(z, number) * factor).astype(np.complex64)[None, None, None]
        )
        for factor in (np.ones(3200), 1.0 + 1j * turn)
    )
    count = np.full(800, number, np.uint32)
    own = z.reshape(shape)
    label = np.where(left, 1, 2) * np.ones(shape, np.uint16)
    none_at_all = np.zeros(shape)
    pilot = Pilot(
        label.astype(np.uint16), every, every, every, own[None], own[None], np.ones((1, *shape)), None, (none_at_all[None], none_at_all[None]),
        np.full(shape, 0.2), np.zeros((2, 1, *shape)), np.zeros((2, 1, *shape)),
    )  # fmt: skip
    sensor = SensorNoise(pilot.sensor_mm, pilot.mm_per_rad, (0,))
    blocks = Blocks(count, count, count, count, count)
    found = cut_to_sensor_noise(quick, deep, blocks, judged_pixels(pilot), pilot, sensor)
    # A product of two blocks has a noise of 0.3^2, of which there are 6 in each of 400 pixels: 0.002 of 0.01.
    assert found[1] == pytest.approx(0.1 / 0.2, rel=0.3)
    assert found[2] < 0.25


def test_stated_cut_light_is_that_of_a_deeper_trace() -> None:
    scene = bright_groove(3, 256.0)
    made = render.surfaces(scene)

    def finest(seed: int, depth: int) -> NDArray[np.complex128]:
        light = render.trace(scene, seed=seed, samples=2048, depth=depth, surfaces=made)
        fringe = finest_fringes(light.scene.patterns, light.bases)[0]
        cosine, sine = fringe.phasor(light.total[0, : len(light.bases[0].channels)], 0)
        return np.asarray(cosine + 1j * sine)

    shallow, deep = (np.stack([finest(100 * s + n, n) for s in range(24)]) for n in (3, 12))
    mean = shallow.mean(axis=0)
    turn = (((deep - shallow) * mean.conj()).imag / np.abs(mean) ** 2).reshape(6, 4, *mean.shape)
    # Products of different seeds of four have no noise of their own on average.
    squares = (turn.sum(axis=1) ** 2 - (turn**2).sum(axis=1)) / 12.0
    light = render.trace(scene, seed=1, samples=256, surfaces=made)
    truth = render.truth(scene, light)
    sensor = sensor_noise(light, truth.lit_by)
    assert sensor is not None
    seen = {}
    for label in truth.labels:
        at = truth.region(label) & np.isfinite(sensor.height_mm)
        if not at.any():
            continue
        power = np.mean((sensor.height_mm / sensor.mm_per_rad[0])[at] ** 2)
        groups = squares[:, at].mean(axis=1) / power
        seen[label] = groups.mean(), stats.sem(groups)
    stated = [
        render.trace(scene, seed=s, render_noise=4.0, surfaces=made).render_noise for s in range(8)
    ]
    for label, (expected, error) in seen.items():
        found = [one.cut[label] ** 2 for one in stated if one is not None]
        off = np.mean(found) - expected
        # Four standard errors of both, which are below a fifth: nothing, or twice what is cut, would be seen.
        both = np.hypot(stats.sem(found), error)
        assert abs(off) < 4.0 * both
        assert both < 0.2 * expected


def test_file_keeps_the_light_cut_by_depth_and_none_is_cut_at_depth_64(tmp_path: Path) -> None:
    shallow, whole = (
        render.trace(scenes.load("step", {**SMALL, "sampling.depth": depth}), render_noise=2.0)
        for depth in (2, 64)
    )
    assert shallow.render_noise is not None
    assert whole.render_noise is not None
    assert set(shallow.render_noise.cut) == {"base", "step"}
    assert whole.render_noise.cut == {}
    shallow.write(tmp_path / "transport.exr")
    kept = render.Transport.read(tmp_path / "transport.exr").render_noise
    assert kept == shallow.render_noise


def test_labels_not_asked_for_get_few_paths() -> None:
    # With blur, noise of the solder next to it would come into the base.
    scene = scenes.load("solder", {**SMALL, "sampling.render_noise": 0.3, "sensor.psf": "none"})
    every = render.trace(scene)
    only = scene.sampling.model_copy(update={"labels": ("base",)})
    one = render.trace(scene.model_copy(update={"sampling": only}))
    assert every.render_noise is not None
    assert one.render_noise is not None
    assert set(one.render_noise.reached) == {"base"}
    assert one.render_noise.paths < every.render_noise.paths


def test_projectors_that_take_turns_behind_a_lens_cost_no_more_paths_than_one() -> None:
    """Which of two measures a pixel of the groove alternates; the lens blurs the light of each alone."""
    sides = [rigs.pinhole_projector(x_mm=x) for x in (-80.0, 80.0)]
    sensor = scenes.load("step").sensor
    paths = []
    for projectors in (sides[:1], sides):
        scene = rigs.scene(rigs.pinhole((40, 30)), *projectors, objects=rigs.groove())
        scene = scene.model_copy(update={"sensor": sensor})
        traced = [render.trace(scene, seed=seed, render_noise=1.0).render_noise for seed in (0, 1)]
        paths.append(sum(noise.paths for noise in traced if noise is not None))
    # Of three seeds each was within 4 % of the mean of either; were the phases of both blurred together, it would be 1.3.
    assert paths[1] < 1.15 * paths[0]


def test_same_seed_gives_the_same_bits_however_lanes_are_cut(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = scenes.load("step", SMALL)
    once = render.trace(scene, seed=3, render_noise=1.0)
    monkeypatch.setattr(block_light, "FIRST_CHUNK_PATHS", 700)
    again, other = (render.trace(scene, seed=seed, render_noise=1.0) for seed in (3, 4))
    np.testing.assert_array_equal(once.total, again.total)
    assert once.noise_rad is not None
    assert again.noise_rad is not None
    np.testing.assert_array_equal(once.noise_rad, again.noise_rad)
    assert (once.total != other.total).mean() > 0.5


def test_block_whose_ray_meets_an_edge_is_the_same_in_any_chunk(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = scenes.load("bench", {"camera.resolution": [320, 240]})
    seen: list[BlockLight] = []

    def pilot(*args: Any, **keys: Any) -> None:
        seen.append(block_light.trace_blocks(*args, **keys))
        raise KeyboardInterrupt

    monkeypatch.setattr(until_quiet, "trace_blocks", pilot)
    monkeypatch.setattr(block_light, "CHUNK_S", 1e-3)
    monkeypatch.setattr("time.process_time", lambda: 0.0)
    for paths in (1 << 20, 77_777):
        monkeypatch.setattr(block_light, "FIRST_CHUNK_PATHS", paths)
        with pytest.raises(KeyboardInterrupt):
            render.trace(scene, seed=0)
    np.testing.assert_array_equal(seen[0].phasor, seen[1].phasor)


@pytest.mark.parametrize("shares", [(1.0,), (0.7, 0.3)])
def test_paths_meet_the_target_with_minimum_work_when_variances_are_known(
    shares: tuple[float, ...],
) -> None:
    # Half the pixels are ten times as dark: their phase is ten times as noisy, and so are the sensor's samples.
    shape = (20, 40)
    modulation = np.where(np.arange(40) < 20, 1.0, 0.1) * np.ones(shape)
    every = np.ones(shape, np.bool_)
    images = (len(shares), *shape)
    light = np.full(images, 0.5)
    phasor = np.broadcast_to(modulation.astype(np.complex128), images)
    # Heights are means over projectors by these shares.
    mm_per_rad = np.reshape(shares, (-1, 1, 1)) * np.ones(images)
    pilot = Pilot(
        np.ones(shape, np.uint16),
        every,
        every,
        every,
        phasor,
        phasor,
        mm_per_rad,
        None,
        (light, light),
        0.01 / modulation,
        np.full((2, *images), 0.5),
        np.zeros((2, *images)),
    )
    targets = {1: 1.0 / AIMED}
    paths = paths_needed(pilot, targets, np.ones(shape), 1 << 20, errors=0.0)
    assert paths[0, 30] / paths[0, 10] == pytest.approx(10.0, rel=1e-6)
    noise = (mm_per_rad**2 * 0.5 / modulation**2 / paths).sum()
    variance = noise / (pilot.sensor_mm**2).sum()
    assert 0.98 < variance <= 1.0
    # What dark pixels have too many of already, bright ones need not have: most of the dark ones' noise is gone.
    have = np.where(modulation < 1.0, 4.0 * paths, 1.0)
    fewer = paths_needed(pilot, targets, have, 1 << 20, errors=0.0)
    assert (fewer >= have).all()
    assert (fewer[:, :20] < paths[:, :20]).all()
    blocks = blocks_needed(pilot, targets, 1 << 20, indirect=True, lens=False)
    first = (blocks.number * blocks.paths).reshape(shape)
    # A share FIRST of what is needed if direct light has its part, known to 1 %, and up to two blocks more.
    least = FIRST / (1.0 - DIRECT) * paths[0, 30]
    assert 0.99 * least <= first[0, 30] <= 1.01 * least + 2 * BLOCK_PATHS
    assert (blocks.places % 2 == 0).all()
    # The places' own light has no noise here: pairs of them only so that no more paths begin at one than may.
    assert (blocks.paths <= PATHS_OF_PLACE * blocks.places).all()
    assert (blocks.paths > PATHS_OF_PLACE * (blocks.places.astype(int) - 2)).all()
    assert PILOT_PLACES % 2 == 0


def test_places_go_to_edges_whose_direct_light_matters() -> None:
    """Behind a lens, places come in fours; an edge that matters a billion times less than another gets none of them."""
    shape = (1, 20, 40)
    one = np.ones(shape)
    scatter = np.zeros((2, *shape))
    scatter[..., 10], scatter[..., 30] = 0.5, 0.5e-9
    every = np.ones(shape[1:], np.bool_)
    phasor = one.astype(np.complex128)
    pilot = Pilot(
        np.ones(shape[1:], np.uint16),
        every,
        every,
        every,
        phasor,
        phasor,
        one,
        np.ones((1, 1)),
        (0.0 * one, 0.0 * one),
        0.01 * one[0],
        0.0 * scatter,
        scatter,
    )
    blocks = blocks_needed(pilot, {1: 1.0}, 1 << 20, indirect=False, lens=False)
    places = blocks.places.reshape(shape[1:])
    assert (places[:, 10] > 4).all()
    assert (places[:, 10] % 4 == 0).all()
    assert (np.delete(places, 10, axis=1) == 2).all()
    # Where direct light is noisy all over, as many as the pilot had at least, and powers of two.
    behind = blocks_needed(pilot, {1: 1.0}, 1 << 20, indirect=False, lens=True).places
    behind = behind.reshape(shape[1:])
    assert (np.delete(behind, 10, axis=1) == PILOT_LENS_PLACES).all()
    assert (behind[:, 10] >= PILOT_LENS_PLACES).all()
    assert (np.log2(behind) % 1 == 0).all()


# The few pixels of some labels may miss so small a target.
@pytest.mark.filterwarnings("ignore:noise of light paths")
@pytest.mark.parametrize("name", ["step", "bench"])
def test_direct_light_alone_gets_more_paths_at_edges_only(name: str) -> None:
    """Behind a lens the noise of neighbours' edges reaches a label; its own even pixels cannot lower it."""
    scene = scenes.load(name, SMALL | {"camera.resolution": [80, 60], "sampling.depth": 1})
    light = render.trace(scene, render_noise=0.05)
    assert light.render_noise is not None
    # Four paths are the fewest. Edges are a tenth of the pixels here, and few of them need more than some tens.
    assert light.render_noise.paths < 2 * 4 * light.label.size


def test_file_keeps_noise_and_what_was_reached(tmp_path: Path) -> None:
    scene = scenes.load("step", {**SMALL, "patterns.axes": ["column", "row"]})
    light = render.trace(scene, render_noise=2.0)
    light.write(tmp_path / "transport.exr")
    again = render.Transport.read(tmp_path / "transport.exr")
    assert again.render_noise == light.render_noise
    assert light.noise_rad is not None
    assert light.noise_rad.shape == (2, 1, 30, 40)
    assert light.amplitude_noise is not None
    np.testing.assert_array_equal(again.noise_rad, light.noise_rad)
    np.testing.assert_array_equal(again.amplitude_noise, light.amplitude_noise)
    np.testing.assert_array_equal(again.noise_correlation, light.noise_correlation)
    truth = render.truth(scene, again)
    truth.write(tmp_path / "truth.exr")
    kept = scenes.Truth.read(tmp_path / "truth.exr").render_noise_mm
    np.testing.assert_array_equal(kept, truth.render_noise_mm)


@pytest.mark.parametrize(
    ("overrides", "arguments", "said"),
    [
        ({}, {"render_noise": 0.5, "samples": 4}, "give one of the two"),
        ({"patterns": {"kind": "gray-code", "bits": [10]}}, {"render_noise": 0.5}, "no fringes"),
        ({"sampling.labels": ["stepp"]}, {"render_noise": 0.5}, "no label 'stepp'"),
    ],
)
def test_impossible_requests_are_named(
    overrides: dict[str, object], arguments: dict[str, float], said: str
) -> None:
    with pytest.raises(RenderError, match=said):
        render.trace(scenes.load("step", {**SMALL, **overrides}), **arguments)  # type: ignore[arg-type]


def test_share_outside_zero_to_one_is_refused() -> None:
    with pytest.raises(SceneError, match="render_noise"):
        scenes.load("step", {"sampling.render_noise": 0.0})


def test_override_of_the_stopping_rule_replaces_the_scenes() -> None:
    scene = scenes.load("step", {"sampling.render_noise": 0.5})
    text = scenes.dumps(scene)
    assert scenes.parse(text).sampling.render_noise == 0.5
    assert scenes.parse(text, {"sampling.samples": 8}).sampling.render_noise is None
    assert scenes.parse(text, {"sampling.phase_error_rad": 0.1}).sampling.render_noise is None


def test_blocks_of_later_stages_have_random_numbers_of_their_own() -> None:
    entry, number = np.arange(3), np.array([4, 5, 7], np.uint32)
    first = np.array([0, 10, 30], np.uint32)
    blocks = Blocks(entry.astype(np.uint32), number, number, number, first)
    more = blocks.more(entry, number)
    np.testing.assert_array_equal(more.first, first + number)
    halves = blocks.halved()
    np.testing.assert_array_equal(halves.first[::2], first)
    # No pixel has as many blocks as the numbers of its halves are apart.
    assert (halves.first[1::2] - first >= 1 << 24).all()


def test_paths_are_those_of_all_blocks() -> None:
    pixel, number, paths = np.array([[0, 1], [4, 6], [64, 16]], np.uint32)
    blocks = Blocks(pixel, number, paths // 8, paths, np.zeros_like(pixel))
    assert blocks.total_paths == blocks.halved().total_paths == 4 * 64 + 6 * 16


def test_indirect_light_is_averaged_within_its_label() -> None:
    """So where each label is evenly lit its light stays, up to its border; a pixel alone in its label has no neighbours."""
    label = np.ones((30, 40), np.uint16)
    label[:, 23:], label[5, 7:9], label[9, 11] = 2, 3, 4
    lit = np.array([0.0, 4.0, 7.0, 2.0, 5.0])[label]
    found, others = smooth_indirect(lit, label)
    np.testing.assert_allclose(found, lit, rtol=1e-9)
    np.testing.assert_allclose(others, np.where(label == 4, 0.0, lit), rtol=1e-9, atol=1e-9)
