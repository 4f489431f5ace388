"""The fast pass against Mitsuba's `path` over every shipped scene and random ones: in every pixel, and in the mean.

Both are unbiased estimates of one integral. Variances are measured from repeats with seeds drawn at random, never modelled.

Heavy tails: a rare bright path (paint that finds a metal's highlight by chance) that neither of a pixel's repeats caught
leaves its variance too small, so Welch's test cries wolf. Three things keep that away, and a fourth shows it. A repeat is a
mean of 512 paths, so that a pixel rests on 12 thousand, and what is rarer than that adds less than its own float32
rounding. Metals here are rough (GGX 0.15 and more), which bounds a path's throughput, or perfect mirrors, which are sampled
exactly. Nothing is clamped, pooled or left out, which would hide just what is looked for. And the judge is held against
itself: were tails too heavy for Welch, its halves would disagree.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy import stats

import scenes
from scenes import Scene
from scenes.scene import Ambient, Sampling
from tests.trust import chance
from tests.trust.judged import SAMPLES, Judged
from tests.trust.random_scenes import random_scene

pytestmark = pytest.mark.trust

SMALL = {"camera.resolution": [32, 24]}
RANDOM = 10
CASES = [*scenes.shipped(), *(f"random-{i}" for i in range(RANDOM))]
# Half a million triangles of grains, whose smooth normals are most of a trace.
FEWER = {"solder-grains": 256}

# Direct light apart from the rest, here in full depth against `path` of depth 1.
DIRECT = ("bench", "solder", "interreflection", "random-0", "random-1")

Judge = Callable[[str], Judged]


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> Judge:
    """Each case, rendered once."""

    def scene(case: str) -> Scene:
        if not case.startswith("random-"):
            return scenes.load(case, SMALL)
        return random_scene(chance.generator(case), tmp_path_factory.mktemp(case))

    return cache(lambda case: Judged.of(case, scene(case), FEWER.get(case, SAMPLES)))


@pytest.mark.parametrize("case", CASES)
def test_a_pixel_of_the_fast_pass_is_not_what_path_gives(
    case: str, judge: Judge, record_property: Callable[[str, str], None]
) -> None:
    """Wrong: a footprint, lens, BSDF, shadow, bounce, or the weight of a learnt direction."""
    deviations = judge(case).deviations()
    worst = chance.family(chance.two_sided(deviations))
    record_property(
        "figure",
        f"{deviations.size} pixels, largest {np.abs(deviations).max():.2f} sigma (p {worst:.2g})",
    )
    assert worst > chance.ALPHA / len(CASES)


@pytest.mark.parametrize("case", CASES)
def test_a_frame_of_the_fast_pass_is_brighter_or_darker_than_paths(case: str, judge: Judge) -> None:
    """Wrong: the brightness of a frame, or of one channel that only some frames have."""
    assert chance.family(judge(case).frame_p_values()) > chance.ALPHA / len(CASES)


@pytest.mark.parametrize("case", DIRECT)
def test_direct_light_is_not_paths_first_surface(case: str, judge: Judge) -> None:
    """Wrong: light of later surfaces counted as direct, or direct light of other places in the pixel."""
    scene = judge(case).scene.model_copy(update={"ambient": Ambient()})
    shallow = scene.model_copy(update={"sampling": Sampling(depth=1)})
    found = Judged.of(f"direct {case}", scene, FEWER.get(case, SAMPLES), shallow)
    p = [chance.family(found.pixel_p_values()), chance.family(found.frame_p_values())]
    assert chance.family(p) > chance.ALPHA / len(DIRECT)


def common_bias(found: list[tuple[float, float, float]]) -> tuple[float, float, float, float]:
    """Over scenes: weighted mean bias, its standard error, its p-value, and that of the chi-square of all scenes."""
    bias, error = np.array([f[0] for f in found]), np.array([f[1] for f in found])
    error = np.hypot(error, chance.ROUNDING)
    weight = error**-2
    mean, spread = float((weight * bias).sum() / weight.sum()), float(weight.sum() ** -0.5)
    z = chance.deviates([f[2] for f in found], bias)
    return (
        mean,
        spread,
        float(chance.two_sided(mean / spread)),
        float(stats.chi2.sf((z**2).sum(), len(z))),
    )


def test_scenes_together_are_brighter_or_darker_than_paths(
    judge: Judge, record_property: Callable[[str, str], None]
) -> None:
    """Wrong: something small that all scenes share, or large in one; or a measured variance that is not the true one."""
    found = [judge(case).bias() for case in CASES]
    bias, error, same, any_ = common_bias(found)
    record_property(
        "figure",
        f"bias {bias:+.1e}, standard error {error:.1e} (p {same:.2g}), chi-square p {any_:.2g}; "
        f"smallest bias found {chance.smallest_found(error):.1e} in all, "
        f"{min(chance.smallest_found(e) for _, e, _ in found):.1e} to "
        f"{max(chance.smallest_found(e) for _, e, _ in found):.1e} in one scene",
    )
    assert same > chance.ALPHA
    assert any_ > chance.ALPHA


def test_the_judge_does_not_agree_with_itself(
    judge: Judge, record_property: Callable[[str, str], None]
) -> None:
    """Wrong: the test. Tails are too heavy for so few repeats, or Mitsuba's seeds are not independent."""
    worst = [chance.family(judge(case).halves().pixel_p_values()) for case in CASES]
    record_property("figure", f"least p of {len(CASES)} scenes {min(worst):.2g}")
    assert chance.family(worst) > chance.ALPHA


def test_a_planted_bias_of_a_two_thousandth_is_missed(judge: Judge) -> None:
    """Wrong: the test has no teeth."""
    dim = [judge(case).scaled(1.0005).bias() for case in CASES]
    assert common_bias(dim)[2] < chance.ALPHA
    # Ten times as much shows in most scenes alone.
    bright = [judge(case).scaled(1.005).bias()[2] < chance.ALPHA for case in CASES]
    assert np.mean(bright) > 0.5


@pytest.mark.parametrize(
    ("case", "depth"), [("bench", 2), ("interreflection", 2), ("translucent", 5)]
)
def test_planted_bounces_too_few_are_missed(case: str, depth: int, judge: Judge) -> None:
    """Wrong: the test has no teeth."""
    found = judge(case)
    short = found.traced_as(found.scene, case, depth=depth)
    assert min(chance.family(short.pixel_p_values()), short.bias()[2]) < chance.ALPHA / len(CASES)


@pytest.mark.parametrize("case", ["step", "mirror"])
def test_a_planted_shift_of_a_twentieth_of_a_pixel_is_missed(case: str, judge: Judge) -> None:
    """Wrong: the test has no teeth."""
    # Of these 32 columns; the shipped intrinsics are for 640.
    moved = scenes.load(case, SMALL | {"camera.cx_px": 320.0 + 0.05 * 640 / 32})
    shifted = judge(case).traced_as(moved, case)
    assert chance.family(shifted.pixel_p_values()) < chance.ALPHA / len(CASES)
