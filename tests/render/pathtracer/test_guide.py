"""Learnt directions: their density is the one they are drawn with, they bias nothing, and they halve the variance."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
import scenes
from render.pathtracer import one_pass, tile_survey
from render.pathtracer.guide import CELLS, COLUMNS, ENTRIES, ROWS, Guide, direction
from render.plugins.variant import dr, mi, use
from scenes import Scene
from tests.render import rigs

GROOVE = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove(), depth=4)


def guide(table: NDArray[np.float32]) -> Guide:
    """One tile for all, with that (cell,) table."""
    use()
    counts, entries = tile_survey._entries(table[None], table.sum(keepdims=True, dtype=np.float64))
    share, yes = mi.Float(1), mi.Bool(True)
    return Guide(1, 1, share, yes, yes, mi.UInt32(entries.ravel()), mi.UInt32(counts.ravel()))


def test_directions_are_drawn_with_the_density_that_weighs_them() -> None:
    rng = np.random.default_rng(0)
    # A few bright cells, many dim ones, and half without any.
    learnt = guide((rng.random(CELLS) ** 8 * (rng.random(CELLS) < 0.5)).astype(np.float32))
    count = 400_000
    pair = mi.Point2f(*(mi.Float(n.astype(np.float32)) for n in rng.random((2, count))))
    tile, yes = dr.zeros(mi.UInt32, count), dr.full(mi.Bool, True, count)
    way = learnt.sample(tile, pair, yes)
    density = learnt.density(tile, way, yes).numpy()
    x, y, z = np.array(way)

    cell = np.minimum(z * ROWS, ROWS - 1).astype(int) * COLUMNS
    cell += (np.arctan2(y, x) % (2 * np.pi) / (2 * np.pi) * COLUMNS).astype(int) % COLUMNS
    seen = np.bincount(cell, minlength=CELLS)
    expected = learnt.counts.numpy() / ENTRIES * count
    # Directions on a cell's very edge may round into its neighbour: some in 1e5.
    assert np.abs(seen - expected)[expected == 0].max() <= 1e-4 * count
    some = expected > 0
    assert (
        stats.chisquare(seen[some] * (expected.sum() / seen[some].sum()), expected[some]).pvalue
        > 1e-3
    )
    # 1 / density is the solid angle that samples cover; inside a cell they are uniform.
    covered = some.sum() * 2 * np.pi / CELLS
    inverse = 1 / density[density > 0]
    assert inverse.mean() == pytest.approx(covered, abs=5 * inverse.std() / np.sqrt(count))
    for inside in ((z * ROWS) % 1, (np.arctan2(y, x) / (2 * np.pi) * COLUMNS) % 1):
        assert stats.kstest(inside, "uniform").pvalue > 1e-3


def test_direction_of_a_cell_is_found_in_that_cell() -> None:
    use()
    cell = dr.arange(mi.UInt32, CELLS)
    way = direction(cell, mi.Point2f(0.5))
    every = mi.UInt32(np.arange(CELLS))
    entries = mi.UInt32(np.zeros(ENTRIES, np.uint32))
    # Counts that name their cell come back from the direction.
    named = Guide(1, 1, mi.Float(1), mi.Bool(True), mi.Bool(True), entries, every)
    density = named.density(dr.zeros(mi.UInt32, CELLS), way, mi.Bool(True)).numpy()
    np.testing.assert_allclose(density * (2 * np.pi * ENTRIES) / CELLS, np.arange(CELLS), rtol=1e-5)


def test_directions_below_the_surface_are_never_drawn_nor_those_of_lanes_at_rest() -> None:
    learnt = guide(np.ones(CELLS, np.float32))
    way = dr.normalize(mi.Vector3f(0.6, 0.2, mi.Float([0.5, -0.5, 0.5])))
    active = mi.Bool([True, True, False])
    density = learnt.density(dr.zeros(mi.UInt32, 3), way, active).numpy()
    # Uniform over the hemisphere, but for a table of one entry for each cell.
    np.testing.assert_allclose(density, [1 / (2 * np.pi), 0.0, 0.0], rtol=1e-6)


def mean_light(scene: Scene, samples: int, repeats: int, start: int) -> NDArray[np.float64]:
    """(repeat,): the image's mean indirect light, first channel."""
    seeds = np.random.default_rng(start).integers(0, 2**31, repeats)
    surfaces = render.surfaces(scene)
    light = [render.trace(scene, seed=int(i), samples=samples, surfaces=surfaces) for i in seeds]
    return np.array([(t.total[0, 0] - t.direct[0, 0]).mean(dtype=np.float64) for t in light])


@pytest.mark.parametrize("samples", [1, 3])
def test_few_paths_are_unbiased(samples: int) -> None:
    # 128 samples equal `path` (test_against_path); the few are compared with those.
    few, many = mean_light(GROOVE, samples, 48, 1), mean_light(GROOVE, 128, 12, 2)
    assert stats.ttest_ind(few, many, equal_var=False).pvalue > 1e-3
    # Sensitivity: kinds of paths that are never taken cost far more than the 10 % that five standard errors show.
    assert stats.sem(few) < 0.02 * many.mean()


def test_learnt_directions_halve_the_variance_of_indirect_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A plate with a cap and a step: most bounces leave for the sky.
    scene = rigs.scene(rigs.pinhole((48, 36)), rigs.pinhole_projector(), depth=2)

    def noise() -> float:
        light = [render.trace(scene, seed=i, samples=256) for i in range(8)]
        later = np.stack([t.total[0, 1] - t.direct[0, 1] for t in light])
        return float(np.median(later.var(axis=0, ddof=1)))

    learnt = noise()
    # As many paths, all drawn by the BSDF.
    monkeypatch.setattr(tile_survey, "WORTH", 0.0)
    monkeypatch.setattr(tile_survey, "SAFETY", 0.0)
    monkeypatch.setattr(tile_survey, "UNAIMED", 0.0)
    plain = noise()
    print(f"variance {plain:.3g} without, {learnt:.3g} with")
    # A table is used where it promises half the variance.
    assert learnt < 0.5 * plain


@pytest.fixture
def learnt(monkeypatch: pytest.MonkeyPatch) -> list[Guide]:
    """The guides of all passes, as they are made."""
    guides: list[Guide] = []

    def kept(*arguments: object) -> Guide:
        guides.append(tile_survey.survey(*arguments))  # type: ignore[arg-type]
        return guides[-1]

    monkeypatch.setattr(one_pass, "survey", kept)
    return guides


def test_uniform_sky_is_sampled_by_the_surface(learnt: list[Guide]) -> None:
    # Noise of the survey itself, taken for that of paths, would make rough metal under a sky 16 times as noisy.
    plate = {
        "label": "plate",
        "shape": {"kind": "plate", "size_mm": (200.0, 200.0)},
        "material": "solder-paste",
    }
    scene = rigs.scene(rigs.pinhole((16, 12)), rigs.pinhole_projector(), objects=[plate], depth=2)
    sky = scene.model_copy(
        update={"ambient": scene.ambient.model_copy(update={"radiance_w_m2_sr": 1.0})}
    )
    render.trace(sky, samples=64)
    assert not learnt[0].aimed.numpy().any()


def test_clear_resin_is_sampled_by_the_surface(learnt: list[Guide]) -> None:
    scene = rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.resin(), depth=4)
    transport = render.trace(scene, samples=576)
    row, column = np.nonzero(transport.label == scene.labels.index("resin") + 1)
    tile = row // learnt[0].tile_px * learnt[0].columns + column // learnt[0].tile_px
    assert not learnt[0].aimed.numpy()[tile].any()
    np.testing.assert_array_equal(learnt[0].share.numpy()[tile], 1)


@pytest.mark.parametrize(
    ("right", "z_mm"), [("black-ink", 0.0), ("white-paint", 1.0)], ids=["darker", "higher"]
)
def test_edge_just_inside_a_tiles_border_is_sampled_densely(
    right: str, z_mm: float, learnt: list[Guide]
) -> None:
    # Missed next to mirrors, and where an edge is parallel to the image's, it would have four times the noise in its pixels.
    edge_mm, side = 0.025, 5

    def plate(label: str, material: str, x_mm: float, z_mm: float) -> rigs.Entries:
        shape = {"kind": "plate", "size_mm": (200.0, 160.0)}
        at = (x_mm, 0.0, z_mm)
        return {"label": label, "material": material, "position_mm": at, "shape": shape}

    objects = [
        plate("left", "white-paint", edge_mm - 100.0, 0.0),
        plate("right", right, edge_mm + 100.0, z_mm),
    ]
    # A pixel is 0.5 mm wide, and a border of tiles is at x = 0.
    camera = rigs.telecentric((100, 75), field_mm=50.0)
    scene = rigs.scene(camera, rigs.telecentric_projector(), objects=objects)
    render.trace(scene, samples=64, depth=1)
    assert learnt[0].tile_px == side
    busy = learnt[0].busy.numpy().reshape(-1, learnt[0].columns)
    assert busy[:, 100 // 2 // side].all()
    # All else is even.
    assert busy[:, : 100 // 2 // side - 1].sum() == busy[:, 100 // 2 // side + 1 :].sum() == 0


def test_phase_of_direct_light_is_as_quiet_for_28_samples_as_for_24() -> None:
    # Where direct light is smooth a quarter of the samples look at it: of 28 samples seven, were they not made even.
    scene = scenes.load("step", {"camera.resolution": [80, 60]})

    def scatter(samples: int) -> float:
        light = [render.trace(scene, seed=i, samples=samples, depth=1).total[0] for i in range(6)]
        finest = np.angle(np.stack([t[-2] + 1j * t[-1] for t in light]))
        return float(np.median(np.abs(np.diff(np.unwrap(finest, axis=0), axis=0))))

    # A place more, or fewer, changes the noise of pairs by a third.
    assert scatter(28) < 1.5 * scatter(24)
