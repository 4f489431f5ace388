import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import norm

import scenes
from scenes.shapes.grains import Grains, Powder, pack
from scenes.support.errors import SceneError

BLOCK = {"size_mm": (0.5, 0.4), "height_mm": 0.12, "bed_mm": 0.1}


@pytest.mark.parametrize(
    ("kind", "low", "high", "largest"),
    [(3, 25, 45, 50), (4, 20, 38, 40), (5, 15, 25, 30), (6, 5, 15, 20), (7, 2, 11, 15)],
)
def test_powder_meets_its_type(kind: int, low: float, high: float, largest: float) -> None:
    """J-STD-005A table 3-2, by mass: 80 % or more in the range, less than 1 % above, none over the largest."""
    diameters = Powder.of_type(kind).diameters_um(200_000, np.random.default_rng(1))
    mass = diameters**3 / (diameters**3).sum()
    assert mass[(diameters >= low) & (diameters <= high)].sum() > 0.9
    assert mass[diameters > high].sum() < 0.01
    # Log-normal by mass with 5 % below and 0.5 % above, then cut at the largest. Masses of 200 000 grains count as those of a
    # quarter as many equal ones or more, so 5 % has a standard error of 0.1 %, and 0.5 % of 0.03 %.
    below, above = norm.ppf(0.05), norm.ppf(0.995)
    spread = np.log(high / low) / (above - below)
    kept = norm.cdf(below + np.log(largest / low) / spread)
    assert mass[diameters < low].sum() == pytest.approx(0.05 / kept, abs=4e-3)
    assert mass[diameters > high].sum() == pytest.approx((kept - 0.995) / kept, abs=1.2e-3)
    assert diameters.max() <= largest


def test_grains_touch_but_do_not_overlap_and_fill_what_was_asked() -> None:
    size = (0.4, 0.4, 0.1)
    packed = pack(size, Powder.of_type(4), 0.5, 3)
    centres, radii = packed.centres_mm, packed.radii_mm
    pairs = cKDTree(centres).query_pairs(2 * radii.max(), output_type="ndarray")
    gap = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1) - radii[pairs].sum(
        axis=1
    )
    assert gap.min() > -1e-12
    assert (gap < 0.1 * radii.min()).any()
    assert (centres[:, :2] >= radii[:, None] - 1e-12).all()
    assert (centres + radii[:, None] <= np.asarray(size) + 1e-12).all()
    # One grain more or less, and what little separating them took from the radii (3 x 1e-3).
    assert (4 / 3 * np.pi * radii**3).sum() == pytest.approx(0.5 * np.prod(size), rel=0.01)


def test_same_fields_give_the_same_grains_and_another_seed_others() -> None:
    one, two = Grains(**BLOCK, seed=1), Grains(**BLOCK, seed=2)
    first = one.packing().centres_mm
    pack.cache_clear()
    np.testing.assert_array_equal(first, one.packing().centres_mm)
    assert (
        first.shape != two.packing().centres_mm.shape or (first != two.packing().centres_mm).any()
    )


def test_grains_rise_above_the_bed_and_no_higher_than_printed() -> None:
    mesh = Grains(**BLOCK, subdivisions=3).mesh()
    tops = mesh.vertices.reshape(
        -1, len(mesh.vertices) // len(Grains(**BLOCK).packing().radii_mm), 3
    )
    assert (tops[..., 2].max(axis=1) > 0.1 - 1e-4).all()
    # An icosphere of a sphere's volume reaches out of the sphere by up to 0.3 % of its radius at this subdivision.
    assert mesh.vertices[:, 2].max() < 0.12 + 0.003 * 0.02


def test_volume_is_that_of_flux_and_of_metal_above_it() -> None:
    """Compared with the meshes: the volume above the bed, by heights on a fine grid."""
    grains = Grains(**BLOCK, subdivisions=3)
    packing = grains.packing()
    step = 0.001
    x, y = np.meshgrid(
        np.arange(-0.25 + step / 2, 0.25, step), np.arange(-0.2 + step / 2, 0.2, step)
    )
    above = np.zeros_like(x)
    for (cx, cy, cz), r in zip(packing.centres_mm, packing.radii_mm, strict=True):
        half = np.sqrt(np.maximum(r**2 - (x - cx) ** 2 - (y - cy) ** 2, 0.0))
        # Length of the vertical chord above the bed; grains do not overlap, so lengths add.
        above += np.clip(cz + half - 0.1, 0, None) - np.clip(cz - half - 0.1, 0, None)
    expected = 0.5 * 0.4 * 0.1 + above.sum() * step**2
    # The grid's error is at most a cell's width along each rim: 2 % of the caps at 1 um cells on 20 um grains.
    assert grains.volume_mm3() == pytest.approx(expected, abs=0.02 * above.sum() * step**2)
    assert grains.volume_mm3() < 0.5 * 0.4 * 0.12
    ball = grains.mesh().split(only_watertight=True)[0]
    assert ball.volume == pytest.approx(4 / 3 * np.pi * ((ball.extents.max()) / 2) ** 3, rel=0.02)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"bed_mm": 0.2}, "bed_mm"),
        ({"size_mm": [0.05, 0.4]}, "too small"),
        ({"metal_fraction": 0.7}, "metal_fraction"),
        ({"powder": 8}, "powder"),
    ],
)
def test_impossible_grains_are_refused(wrong: dict, named: str) -> None:  # type: ignore[type-arg]
    overrides = {f"objects.2.shape.{key}": value for key, value in wrong.items()}
    with pytest.raises(SceneError, match=named):
        scenes.load("solder-grains", overrides)


def test_too_many_grains_are_refused_before_they_are_packed() -> None:
    scene = scenes.load("solder-grains", {"objects.2.shape.size_mm": [60.0, 60.0]})
    with pytest.raises(SceneError, match="more than the 200000 allowed"):
        scenes.meshes(scene)
