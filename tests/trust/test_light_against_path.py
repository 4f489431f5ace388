"""The fast pass against Mitsuba's `path` over every shipped scene and random ones: in every pixel, and in the mean.

Both are unbiased estimates of one integral. Variances are measured from repeats with seeds drawn at random, never modelled.

Heavy tails: if no repeat of a pixel contains a rare bright path (paint that hits a metal's highlight by chance), its
measured variance is too small and Welch's test gives a false alarm. Three measures prevent that, and a fourth would show it.
A repeat is a mean of 512 paths, so that a pixel has 12 thousand, and rarer paths add less than float32 rounding. Metals here
are rough (GGX 0.15 and more), which bounds a path's throughput, or perfect mirrors, which are sampled exactly. Nothing is
clamped, pooled or left out, which would hide faults. And `path` is compared with itself: with tails too heavy for Welch's
test its two halves would differ.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path

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
def test_every_pixel_equals_path(
    case: str, judge: Judge, record_property: Callable[[str, str], None], tmp_path: Path
) -> None:
    """A failure points to a footprint, lens, BSDF, shadow, bounce, or the weight of a learnt direction."""
    deviations = judge(case).deviations()
    worst = chance.family(chance.two_sided(deviations))
    record_property(
        "figure",
        f"{deviations.size} pixels, largest {np.abs(deviations).max():.2f} sigma (p {worst:.2g})",
    )
    if worst <= chance.ALPHA / len(CASES):
        judge(case).save(tmp_path)
        pytest.fail(
            f"pixels differ, p {worst:.1e}: see the images, references and z maps in {tmp_path}"
        )


@pytest.mark.parametrize("case", CASES)
def test_every_frame_is_as_bright_as_path(case: str, judge: Judge) -> None:
    """A failure points to the brightness of a frame, or of one channel that only some frames have."""
    assert chance.family(judge(case).frame_p_values()) > chance.ALPHA / len(CASES)


@pytest.mark.parametrize("case", DIRECT)
def test_direct_light_equals_path_of_depth_one(case: str, judge: Judge) -> None:
    """A failure points to light of later surfaces counted as direct, or direct light of other places in the pixel."""
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


def test_scenes_together_are_as_bright_as_path(
    judge: Judge, record_property: Callable[[str, str], None]
) -> None:
    """A failure points to a small fault common to all scenes, a large one in one scene, or a wrong measured variance."""
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


def test_path_agrees_with_itself(judge: Judge, record_property: Callable[[str, str], None]) -> None:
    """A failure points to this test: tails are too heavy for so few repeats, or Mitsuba's seeds are not independent."""
    worst = [chance.family(judge(case).halves().pixel_p_values()) for case in CASES]
    record_property("figure", f"least p of {len(CASES)} scenes {min(worst):.2g}")
    assert chance.family(worst) > chance.ALPHA


def test_planted_bias_of_a_two_thousandth_is_detected(judge: Judge) -> None:
    """Checks that the test detects a planted fault."""
    dim = [judge(case).scaled(1.0005).bias() for case in CASES]
    assert common_bias(dim)[2] < chance.ALPHA
    # Ten times as much shows in most scenes alone.
    bright = [judge(case).scaled(1.005).bias()[2] < chance.ALPHA for case in CASES]
    assert np.mean(bright) > 0.5


@pytest.mark.parametrize(
    ("case", "depth"), [("bench", 2), ("interreflection", 2), ("translucent", 5)]
)
def test_planted_missing_bounces_are_detected(case: str, depth: int, judge: Judge) -> None:
    """Checks that the test detects a planted fault."""
    found = judge(case)
    short = found.traced_as(found.scene, case, depth=depth)
    assert min(chance.family(short.pixel_p_values()), short.bias()[2]) < chance.ALPHA / len(CASES)


@pytest.mark.parametrize("case", ["step", "mirror"])
def test_planted_shift_of_a_twentieth_of_a_pixel_is_detected(case: str, judge: Judge) -> None:
    """Checks that the test detects a planted fault."""
    # Of these 32 columns; the shipped intrinsics are for 640.
    moved = scenes.load(case, SMALL | {"camera.cx_px": 320.0 + 0.05 * 640 / 32})
    shifted = judge(case).traced_as(moved, case)
    assert chance.family(shifted.pixel_p_values()) < chance.ALPHA / len(CASES)
