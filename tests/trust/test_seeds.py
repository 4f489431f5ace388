"""Random numbers that must be independent: those of exposures, frames, pixels, seeds, samples.

A correlation of n independent pairs scatters about 0 by 1 / sqrt(n), for any law of the pairs, once they are scaled to
unit variance; among many, the largest is judged as the largest.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from scenes import Scene
from scenes.acquisition.sensor import Emva, SimpleSensor
from tests.render import rigs
from tests.trust import chance

pytestmark = pytest.mark.trust

Floats = NDArray[np.float64]
Figure = Callable[[str, str], None]
SIZE = (160, 120)
TIMES_MS = (4.0, 4.0, 8.0)
SEEDS = 6


def noise_of(sensor: Emva | SimpleSensor) -> Floats:
    """Noise in standard deviations of pictures of paint, (seed, exposure, frame, pixel); neighbouring seeds."""
    scene = rigs.scene(
        rigs.telecentric(SIZE), rigs.telecentric_projector(), objects=rigs.plane(), depth=1
    )
    light = render.trace(scene, samples=4)
    how: dict[str, Any] = {"sensor": sensor, "exposures": list(TIMES_MS)}
    mean = render.expose(light, noise=False, **how).frames.astype(np.float64)
    sigma = np.sqrt(sensor.variance_dn2(mean))
    first = chance.seeds(1, "noise", sensor.kind)[0]
    taken = [render.expose(light, seed=first + i, **how).frames for i in range(SEEDS)]
    noise = (np.array(taken, np.float64) - mean) / sigma
    return noise.reshape(*noise.shape[:3], -1)


SENSORS = [Emva(bits=0, full_well_e=1e9), SimpleSensor(bits=0)]


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s.kind)
def test_images_share_no_noise(sensor: Emva | SimpleSensor, record_property: Figure) -> None:
    """A failure points to two frames, exposures or seeds that draw from one stream, or that share the size of their noise."""
    images = noise_of(sensor).reshape(-1, SIZE[0] * SIZE[1])
    upper = np.triu_indices(len(images), 1)
    pixels = images.shape[1]
    for what, values in (("noise", images), ("its square", images**2)):
        table = np.asarray(np.corrcoef(values))[upper]
        z = np.abs(table).max() * np.sqrt(pixels)
        p = chance.family(np.append(np.ones(len(table) - 1), chance.two_sided(z)))
        record_property(
            "figure", f"{what}: largest of {len(table)} correlations {z:.2f} sigma, p {p:.2g}"
        )
        assert p > chance.ALPHA / 4


@pytest.mark.parametrize("sensor", SENSORS, ids=lambda s: s.kind)
def test_pixels_share_no_noise(sensor: Emva | SimpleSensor, record_property: Figure) -> None:
    """A failure points to a stream that repeats itself, or two streams that overlap. At every lag in pixel order, within an image and
    between one and the next frame, exposure and seed.
    """
    noise = noise_of(sensor)
    noise = (noise - noise.mean(axis=-1, keepdims=True)) / noise.std(axis=-1, keepdims=True)
    waves = np.fft.rfft(noise)
    pairs = {
        "pixels of an image": (waves, waves),
        "frames": (waves[:, :, :-1], waves[:, :, 1:]),
        "exposures": (waves[:, :-1], waves[:, 1:]),
        "seeds": (waves[:-1], waves[1:]),
    }
    n = noise.shape[-1]
    for what, (one, two) in pairs.items():
        lags = np.fft.irfft(one * two.conj(), n).reshape(-1, n) / np.sqrt(n)
        if one is two:
            # Lag 0 is the variance, and half of the others is the other half again.
            lags = lags[:, 1 : n // 2]
        p = chance.family(chance.two_sided(lags))
        record_property(
            "figure",
            f"{what}: largest of {lags.size} lags {np.abs(lags).max():.2f} sigma, p {p:.2g}",
        )
        assert p > chance.ALPHA / 8


def test_fixed_pattern_and_noise_are_independent() -> None:
    """A failure points to fixed pattern and noise of one seed drawing the same numbers."""
    scene = rigs.scene(
        rigs.telecentric(SIZE), rigs.telecentric_projector(), objects=rigs.plane(), depth=1
    )
    light = render.trace(scene, samples=4)
    seed = chance.seeds(1, "chip")[0]
    sensor = Emva(bits=0, prnu=0.02, dsnu_e=10.0, full_well_e=1e9)
    many = [
        render.expose(light, seed=seed + i, sensor=sensor, exposures=[4.0], chip_seed=seed).frames[
            0
        ]
        for i in range(SEEDS)
    ]
    stack = np.array(many, np.float64)
    # Other seeds' images share only the chip's part with the first image's noise around their mean.
    pattern = stack[1:].mean(axis=0) - stack[1:].mean(axis=(0, 2, 3))[:, None, None]
    clean = render.expose(light, sensor=sensor, exposures=[4.0], noise=False).frames[0]
    pattern = stack[1:].mean(axis=0) - clean
    noise = stack[0] - stack[1:].mean(axis=0)
    # Both contain the mean of the others, with opposite signs: its noise, known from their scatter, is added back.
    share = stack[1:].var(axis=0, ddof=1) / (SEEDS - 1)
    product = pattern * noise + share
    p = [float(stats.ttest_1samp(frame.ravel(), 0.0).pvalue) for frame in product]
    assert chance.family(p) > chance.ALPHA


# ---- light


TRACES = 48
SAMPLES = 16
LIT = {
    "groove": rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove(), depth=4),
    "board": rigs.scene(
        rigs.pinhole(lens={"aperture_mm": 10.0, "focus_mm": 190.0}),
        rigs.pinhole_projector(lens={"aperture_mm": 10.0, "focus_mm": 195.0}),
        ambient=3.0,
    ),
}


def light_of(scene: Scene, seed: int, samples: int = SAMPLES) -> Floats:
    """Channels of all light, (channel, row, col), and the ambient one."""
    found = render.trace(scene, seed=seed, samples=samples)
    return np.concatenate([found.total[0], found.ambient[None]]).astype(np.float64)


class Errors:
    """Errors of a scene's light, in standard deviations of a pixel.

    Two references, of seeds of their own: an error in one of them would otherwise be in both factors of a product.
    """

    def __init__(self, name: str) -> None:
        self.scene, self.name = LIT[name], name
        many = [
            np.stack([light_of(self.scene, s) for s in chance.seeds(TRACES, "reference", name, i)])
            for i in (0, 1)
        ]
        self.means = [m.mean(axis=0) for m in many]
        self.sigma = np.sqrt((many[0].var(axis=0, ddof=1) + many[1].var(axis=0, ddof=1)) / 2.0)
        # Where light has no noise but rounding there is nothing to correlate.
        self.noisy = self.sigma > 1e-4 * np.abs(self.means[0]).max()

    def of(self, seed: int, reference: int, samples: int = SAMPLES) -> Floats:
        """(channel, row, col); 0 where there is no noise."""
        off = light_of(self.scene, seed, samples) - self.means[reference]
        return np.where(self.noisy, off / np.where(self.noisy, self.sigma, 1.0), 0.0)


@pytest.fixture(scope="module", params=list(LIT))
def errors(request: pytest.FixtureRequest) -> Errors:
    return Errors(request.param)


def judged(products: list[Floats], record_property: Figure, what: str) -> None:
    """No correlation: mean products over the image, one for each independent repeat, have mean 0 (Student's t)."""
    table = np.array([p.mean(axis=(-2, -1)) for p in products])
    table = table.reshape(len(table), -1)
    table = table[:, table.std(axis=0) > 0]
    p = np.asarray(stats.ttest_1samp(table, 0.0, axis=0).pvalue)
    worst = int(np.argmin(p))
    record_property(
        "figure",
        f"{what}: {table[:, worst].mean():+.1e}, standard error {stats.sem(table[:, worst]):.1e} "
        f"(worst of {p.size}), p {chance.family(p):.2g}",
    )
    assert chance.family(p) > chance.ALPHA / 8


def test_light_of_neighbouring_seeds_is_independent(
    errors: Errors, record_property: Figure
) -> None:
    """A failure points to similar seeds with similar streams: data sets of seeds 0, 1, 2 would repeat themselves."""
    starts = chance.seeds(TRACES, "pairs", errors.name)
    next_ = [errors.of(s, 0) * errors.of(s + 1, 1) for s in starts]
    judged(next_, record_property, "seeds i, i + 1")
    bits = [errors.of(s, 0) * errors.of(s ^ (1 << k % 31), 1) for k, s in enumerate(starts)]
    judged(bits, record_property, "seeds one bit apart")


def test_light_of_neighbouring_pixels_is_independent(
    errors: Errors, record_property: Figure
) -> None:
    """A failure points to pixels that share paths or directions: noise has blotches, and averaging n pixels gains less than sqrt n."""
    starts = chance.seeds(TRACES, "pixels", errors.name)
    pairs = [(errors.of(s, 0), errors.of(s, 1)) for s in starts]
    # One trace, compared with both references.
    for rows, columns in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (0, 5)):
        products = [
            a[:, : a.shape[1] - rows, : a.shape[2] - columns] * b[:, rows:, columns:]
            for a, b in pairs
        ]
        judged(products, record_property, f"pixels {rows} rows, {columns} columns apart")


def test_light_of_other_sample_counts_and_seeds_is_independent(
    errors: Errors, record_property: Figure
) -> None:
    """A failure points to n samples of one seed and 2n of another sharing numbers. Those of one seed do share: see the figure."""
    starts = chance.seeds(TRACES, "samples", errors.name)
    judged(
        [
            errors.of(s, 0) * errors.of(t, 1, 2 * SAMPLES)
            for s, t in pairwise([*starts, starts[0] + 1])
        ],
        record_property,
        "n and 2n samples of other seeds",
    )
    same = np.array(
        [
            [(a * b).sum(), (a * a).sum(), (b * b).sum()]
            for a, b in ((errors.of(s, 0), errors.of(s, 1, 2 * SAMPLES)) for s in starts[:16])
        ]
    ).sum(axis=0)
    nested = same[0] / np.sqrt(same[1] * same[2])
    record_property("figure", f"n and 2n samples of one seed: correlation {nested:+.3f}")
