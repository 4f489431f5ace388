"""Vertices in pairs: a fellow is half a fringe away and has one fellow, pairs bias nothing, and most indirect light cancels."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import render
from render.pathtracer import tile_survey
from render.plugins.lens import optics
from render.plugins.projector_light import Light
from render.plugins.variant import mi, use
from scenes import Scene
from scenes.acquisition.pattern_basis import basis
from scenes.rig.projectors import Screen
from tests.render import rigs

PROJECTORS = {
    "distorted": rigs.pinhole_projector(distortion=rigs.DISTORTION),
    "telecentric": rigs.telecentric_projector(),
}
CROSSED = {"periods_px": (8.0, 32.0), "axes": ("column", "row")}


@pytest.mark.parametrize("kind", PROJECTORS)
def test_fellow_is_half_a_fringe_away_and_has_one_fellow(kind: str) -> None:
    use()
    shown = rigs.scene(rigs.pinhole(), PROJECTORS[kind], patterns=CROSSED)
    device = shown.projectors[0]
    assert not isinstance(device, Screen)
    light = Light(device, optics(device), basis(shown.patterns, device, device.resolution).channels)
    rng = np.random.default_rng(0)
    point = mi.Point3f(*(mi.Float(x.astype(np.float32)) for x in rng.uniform(-15, 15, (3, 1000))))

    def fellow(at: Any) -> Any:
        """Any point of its beam, whose points all have one pixel."""
        return light.fellow(at)(mi.Float(180.0))

    away = fellow(point)
    pixels = [np.array(light.connect(p, None)[2]) for p in (point, away, fellow(away))]
    off = [np.abs(p - pixels[0]) for p in pixels[1:]]
    # float32 holds a point 200 mm away to 2e-5 mm, 4e-5 pixels, and a few points so near half a fringe's end that they cross it.
    assert np.quantile(off[1], 0.99) < 1e-3
    # Half of 8 pixels; distortion changes widths by up to 3 x 0.12 r^2, and r is below 0.2.
    bent = 4.0 * 0.36 * 0.2**2 if kind == "distorted" else 1e-3
    assert np.quantile(np.abs(off[0] - 4.0), 0.99) < bent


def indirect(scene: Scene, repeats: int, start: int) -> NDArray[np.float64]:
    """(repeat, channel, row, col)"""
    seeds = np.random.default_rng(start).integers(0, 2**31, repeats)
    surfaces = render.surfaces(scene)
    light = [render.trace(scene, seed=int(i), samples=64, surfaces=surfaces) for i in seeds]
    return np.array([t.total[0] - t.direct[0] for t in light], np.float64)


@pytest.mark.parametrize(
    ("kind", "material"), [("distorted", "solder"), ("telecentric", "white-paint")]
)
def test_pairs_bias_nothing_and_cancel_fringes(
    kind: str, material: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    objects = [part | {"material": material} for part in rigs.groove()]
    scene = rigs.scene(rigs.pinhole(), PROJECTORS[kind], objects=objects, depth=4, patterns=CROSSED)
    monkeypatch.setattr(tile_survey, "FAR", 0.0)
    pairs = indirect(scene, 16, 1)
    # Single vertices equal `path` (test_against_path).
    monkeypatch.setattr(tile_survey, "FAR", 1.0)
    single = indirect(scene, 16, 2)
    means = [light.mean(axis=(2, 3)) for light in (pairs, single)]
    found = stats.ttest_ind(*means, equal_var=False).pvalue
    assert found.min() * found.size > 1e-3
    # Sensitivity: of white light, the first channel, five standard errors are 2 %.
    assert stats.sem(means[1])[0] < 0.004 * means[1].mean(axis=0)[0]
    noise = [np.median(light.var(axis=0, ddof=1), axis=(1, 2)) for light in (pairs, single)]
    print("variance with pairs over without:", np.round(noise[0] / noise[1], 3))
    # The channels after the first are the cosine and sine of the finest fringe.
    assert (noise[0] < 0.5 * noise[1])[1:3].all()
