"""Light traced until its phase error is small enough: the stopping rule must not bias the light."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from evaluation.theory.cramer_rao import FringeLight
from scenes import Scene
from tests.render import rigs
from tests.trust import chance

pytestmark = pytest.mark.trust

TARGET_RAD = 0.02
REPEATS = 48
# `phase_error_rad` promises that its bound holds with this risk.
RISK = 0.05


@pytest.fixture(scope="module")
def scene() -> Scene:
    return rigs.scene(rigs.pinhole(), rigs.pinhole_projector(), objects=rigs.groove(), depth=4)


def phase_of(scene: Scene, frames: NDArray[np.floating]) -> NDArray[np.float64]:
    return FringeLight.of(frames, scene.patterns.frames(), "column", 16.0).phase_rad


def test_light_traced_to_a_phase_error_is_unbiased_and_within_its_bound(
    scene: Scene, record_property: Callable[[str, str], None]
) -> None:
    """A failure points to a stopping rule that favours some light, or an underestimated error."""
    fixed = np.stack(
        [render.trace(scene, seed=s, samples=1024).frames() for s in chance.seeds(24, "fixed")]
    )
    stopped = [
        render.trace(scene, seed=s, samples=8, phase_error_rad=TARGET_RAD)
        for s in chance.seeds(REPEATS, "stopped")
    ]
    frames = np.stack([light.frames() for light in stopped]).astype(np.float64)
    true = phase_of(scene, fixed.mean(axis=0, dtype=np.float64))

    a, b = (x.mean(axis=(2, 3), dtype=np.float64) for x in (frames, fixed))
    p = stats.ttest_ind(a, b, equal_var=False, axis=0).pvalue
    error = np.hypot(stats.sem(a, axis=0), stats.sem(b, axis=0)) / b.mean(axis=0)

    off = [np.abs(np.angle(np.exp(1j * (phase_of(scene, f) - true)))) for f in frames]
    worst = np.array([np.quantile(o, 0.95) for o in off])
    bounds = np.array(
        [light.phase_error.bound_rad for light in stopped if light.phase_error], np.float64
    )
    over = int((worst > bounds).sum())
    record_property(
        "figure",
        f"bias {(a.mean(axis=0) / b.mean(axis=0) - 1).round(6).tolist()}, standard errors {error.round(6).tolist()}; "
        f"{over} of {REPEATS} over their bound, errors {worst.min():.4f} to {worst.max():.4f} rad of {TARGET_RAD}",
    )
    assert chance.family(p) > chance.ALPHA
    assert stats.binom.sf(over - 1, REPEATS, RISK) > chance.ALPHA
    # Nor is the error overestimated by much: it is at least half of the allowed one.
    assert np.median(worst) > TARGET_RAD / 2.0
