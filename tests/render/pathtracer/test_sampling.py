"""Random numbers: each uniform, pairs stratified, pixels' places in opposite pairs."""

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from render.pathtracer import sampling
from render.plugins.variant import dr, mi, use


def points(streams: int, samples: int, dimension: int = 3, seed: int = 0) -> NDArray[np.float32]:
    """(stream, sample, 2)."""
    use()
    index = dr.arange(mi.UInt32, streams * samples)
    key = sampling.stream(seed, index // samples)
    drawn = sampling.point(key, mi.UInt32(dimension), index % samples)
    return np.array(drawn).T.reshape(streams, samples, 2)


def test_sixteen_samples_of_a_stream_fill_every_elementary_rectangle_once() -> None:
    drawn = points(200, 16)
    for columns in (1, 2, 4, 8, 16):
        cell = np.floor(drawn * (columns, 16 // columns)).astype(int)
        where = cell[..., 0] * (16 // columns) + cell[..., 1]
        np.testing.assert_array_equal(np.sort(where, axis=1), np.tile(np.arange(16), (200, 1)))


def test_single_sample_is_uniform_over_streams() -> None:
    drawn = points(40_000, 1)[:, 0]
    assert drawn.min() >= 0
    assert drawn.max() < 1
    for axis in range(2):
        assert stats.kstest(drawn[:, axis], "uniform").pvalue > 1e-3


def test_dimensions_seeds_and_streams_are_uncorrelated() -> None:
    base = points(20_000, 4).reshape(-1, 2)
    others = [
        points(20_000, 4, dimension=4).reshape(-1, 2),
        points(20_000, 4, seed=1).reshape(-1, 2),
        np.roll(points(20_000, 4), 1, axis=0).reshape(-1, 2),
    ]
    bound = 4 / np.sqrt(len(base))
    assert abs(np.asarray(np.corrcoef(base.T))[0, 1]) < bound
    for other in others:
        table = np.asarray(np.corrcoef(base.T, other.T))[:2, 2:]
        assert np.abs(table).max() < bound


def test_places_in_a_pixel_lie_in_pairs_opposite_about_its_centre() -> None:
    use()
    index = dr.arange(mi.UInt32, 64)
    place = np.array(sampling.pixel_point(sampling.stream(7, mi.UInt32(11)), index)).T
    assert ((place >= 0) & (place < 1)).all()
    np.testing.assert_allclose(place[0::2] + place[1::2], 1, atol=2e-7)
    # The next pair is as near to the border as this one is to the centre.
    np.testing.assert_allclose(
        np.abs(place[0::4] - 0.5) + np.abs(place[2::4] - 0.5), 0.5, atol=2e-7
    )
    assert len(np.unique(place[0::2], axis=0)) == 32


def joint(streams: int, samples: int, pairs: int = 3) -> NDArray[np.float64]:
    """Samples of all dimensions of one sequence, (stream, sample, dimension)."""
    use()
    index = dr.arange(mi.UInt32, streams * samples)
    key = sampling.stream(3, index // samples)
    drawn = [np.array(sampling.joint_point(key, p, index % samples)).T for p in range(pairs)]
    return np.concatenate(drawn, axis=1).reshape(streams, samples, 2 * pairs).astype(np.float64)


def test_joint_samples_come_opposite_in_all_dimensions_at_once() -> None:
    drawn = joint(50, 64)
    assert ((drawn >= 0) & (drawn < 1)).all()
    np.testing.assert_allclose(drawn[:, 0::2] + drawn[:, 1::2], 1, atol=2e-7)


def test_single_joint_sample_is_uniform_and_dimensions_are_independent() -> None:
    # A pixel's first sample and one in the middle of its sequence.
    for number in (0, 37):
        drawn = joint(40_000, number + 1)[:, number]
        for axis in range(drawn.shape[1]):
            assert stats.kstest(drawn[:, axis], "uniform").pvalue > 1e-4
        off = np.corrcoef(drawn.T) - np.eye(drawn.shape[1])
        assert np.abs(off).max() < 4.5 / np.sqrt(len(drawn))


def test_joint_samples_are_even_in_each_dimension_and_in_the_sum_of_two() -> None:
    drawn = joint(200, 128)[:, 0::2]
    # Of 64 distinct points, any dimension has one in each of 64 strata.
    cells = np.sort(np.floor(drawn * 64).astype(int), axis=1)
    np.testing.assert_array_equal(cells, np.tile(np.arange(64)[:, None], (200, 1, 6)))
    # A fringe's phase is a sum of a place in the pixel and one in the pupil. In a random order of the latter, combinations are
    # random; 64 even ones have a tenth of their variance or less (the more samples, the less: as N^-3 instead of N^-1).
    order = np.random.default_rng(5).permuted(np.tile(np.arange(64), (200, 1)), axis=1)
    pixel, pupil = drawn[..., 0], drawn[..., 2]
    apart = np.take_along_axis(pupil, order, axis=1)
    variances = [
        np.cos(2 * np.pi * (0.4 * pixel + 1.2 * u)).mean(axis=1).var() for u in (pupil, apart)
    ]
    assert variances[0] < 0.1 * variances[1]
