"""One deposit: volume, transfer, shape."""

from typing import Any

import numpy as np
import pytest
import shapely
import trimesh
from scipy import special

from scenes.board.pad_layout import area_ratio, disk
from scenes.board.paste import Form, Paste, _waves, deposit
from scenes.board.transfer import Transfer
from scenes.shapes.heightfield import Heightfield
from scenes.shapes.tessellation import tessellate
from scenes.support.errors import MeshError

PLAIN = Form(edge_mm=0.04, wall=0.3, scoop=0.0, dog_ear=0.0, roughness=0.0)
PAD = shapely.box(-0.3, -0.2, 0.3, 0.2)


def printed(
    form: Form = PLAIN, volume: float = 0.02, seed: int = 0, **paste: object
) -> Heightfield:
    settings = Paste.model_validate(paste)
    mesh = tessellate(PAD, settings.fine_step_mm)
    return deposit(mesh, volume, (1.0, 1.0), form, settings, np.random.default_rng(seed))


def test_area_ratio_is_ipc_7525s() -> None:
    length, width, thickness = 0.6, 0.4, 0.12
    expected = length * width / (2 * (length + width) * thickness)
    assert area_ratio(PAD, thickness) == pytest.approx(expected)
    # A round opening's is d / 4 t; a 64-corner polygon's perimeter is 4e-4 short of a circle's at most.
    assert area_ratio(disk(0.0, 0.0, 0.15), 0.12) == pytest.approx(0.3 / (4 * 0.12), rel=1e-3)


def test_transfer_efficiency_meets_the_published_points() -> None:
    transfer = Transfer()
    for ratio, published in ((0.30, 0.05), (0.50, 0.60), (0.66, 0.80)):
        assert transfer.efficiency(ratio) == pytest.approx(published, abs=0.01)
    assert transfer.efficiency(0.2) == 0.0
    rising = [transfer.efficiency(r) for r in np.linspace(0.3, 3.0, 50)]
    assert np.all(np.diff(rising) > 0)
    assert rising[-1] < 1.0


@pytest.mark.parametrize(
    ("form", "paste"),
    [
        (PLAIN, {}),
        (Form(0.04, 0.3, 0.4, 0.0, 0.0), {}),
        (Form(0.04, 0.3, 0.0, 0.5, 0.0, stroke=(0.6, 0.8)), {}),
        (Form(0.04, 0.3, 0.1, 0.2, 0.1), {}),
        (Form(0.04, 0.3, 0.0, 0.0, 0.0, peak_mm=0.15, peak_at=(0.2, -0.3)), {}),
        (Form(0.5, 0.1, 0.0, 0.0, 0.0), {}),
        (PLAIN, {"texture": "granular", "powder": 3}),
        (Form(0.04, 0.3, 0.1, 0.2, 0.1, lean_mm=0.02), {}),
        (Form(0.04, 0.3, 0.0, 0.0, 0.0, lean_mm=0.004), {}),
    ],
)
def test_volume_is_the_same_for_every_shape(form: Form, paste: dict[str, Any]) -> None:
    field = printed(form, 0.02, **paste)
    solid = trimesh.Trimesh(*field.solid(), process=False)
    assert solid.is_watertight
    assert solid.volume == pytest.approx(0.02, rel=1e-9)
    assert (field.height_mm > 0).all()


def near(field: Heightfield, x: float, y: float) -> float:
    return float(field.height_mm[np.argmin(np.hypot(*(field.xy_mm - (x, y)).T))])


def test_plateau_of_a_plain_deposit_is_flat() -> None:
    field = printed()
    inside = np.all(np.abs(field.xy_mm) < np.array([0.3, 0.2]) - 0.045, axis=1)
    assert np.ptp(field.height_mm[inside]) < 1e-12
    assert field.height_mm[field.rims[0]] == pytest.approx(0.3 * field.height_mm.max())


def test_scoop_dog_ears_and_peak_are_where_asked() -> None:
    scooped = printed(Form(0.04, 0.3, 0.4, 0.0, 0.0))
    assert near(scooped, 0.0, 0.0) < 0.75 * near(scooped, 0.25, 0.0)
    eared = printed(Form(0.04, 0.3, 0.0, 0.5, 0.0))
    assert near(eared, 0.0, 0.155) > 1.2 * near(eared, 0.0, 0.0)
    assert near(eared, 0.255, 0.0) == pytest.approx(near(eared, 0.0, 0.0), rel=1e-3)
    peaked = printed(Form(0.04, 0.3, 0.0, 0.0, 0.0, peak_mm=0.1, peak_at=(0.5, 0.0)))
    # The peak's top is within half a lattice diagonal of a vertex: exp(-0.5 (7.1 um / 42 um)^2) = 0.986.
    plateau = near(peaked, -0.15, 0.0)
    assert near(peaked, 0.15, 0.0) - plateau == pytest.approx(0.1, rel=0.02)


def test_peak_takes_at_most_half_of_a_deposit() -> None:
    field = printed(Form(0.04, 0.3, 0.0, 0.0, 0.0, peak_mm=2.0, peak_width_mm=0.3), volume=0.01)
    assert field.volume_mm3 == pytest.approx(0.01, rel=1e-9)
    assert near(field, -0.25, 0.15) > 0.0


def test_roughness_has_the_stated_amplitude() -> None:
    sds = []
    for seed in range(40):
        field = printed(Form(0.04, 0.3, 0.0, 0.0, 0.05), seed=seed)
        inside = np.all(np.abs(field.xy_mm) < np.array([0.3, 0.2]) - 0.045, axis=1)
        sds.append(np.mean((field.height_mm[inside] / field.height_mm[inside].mean() - 1.0) ** 2))
    # Over 0.5 x 0.3 mm each deposit shows some 7 independent lumps: 40 of them give the variance to sqrt(2 / 280),
    # of which five standard errors are allowed; the mean's removal takes up to 1/7 of it.
    assert 0.05**2 * (1 - 1 / 7 - 0.42) < np.mean(sds) < 0.05**2 * 1.42


def test_roughness_is_correlated_over_its_wavelength() -> None:
    # Plane waves of even direction are correlated as J0(2 pi r / wavelength) over a distance r; their lengths spread evenly.
    wavelength, apart, seeds = 0.2, 0.05, 300
    spread = np.linspace(0.4, 1.6, 200)
    wanted = special.j0(2.0 * np.pi * spread * apart / wavelength).mean()
    places = np.random.default_rng(0).uniform(0.0, 5.0, (100, 2))
    pairs = np.vstack([places, places + np.array([apart, 0.0])])
    found = np.array(
        [_waves(pairs, wavelength, np.random.default_rng(seed)) for seed in range(seeds)]
    )
    for product, mean in ((found[:, :100] * found[:, 100:], wanted), (found[:, :100] ** 2, 1.0)):
        each = product.mean(axis=1)
        # One correct run in 10^5 fails.
        assert abs(each.mean() - mean) < 4.4 * each.std() / np.sqrt(seeds)


def test_grain_relief_is_below_one_grain() -> None:
    field = printed(volume=0.6 * 0.4 * 0.12, texture="granular", powder=4)
    settings = Paste(texture="granular", powder=4)
    inside = np.all(np.abs(field.xy_mm) < np.array([0.3, 0.2]) - 0.06, axis=1)
    relief = np.ptp(field.height_mm[inside])
    assert 0.2 * settings.grain_mm < relief < settings.grain_mm
    # Neighbouring grains are a diameter apart: the surface's autocorrelation is gone within one.
    assert settings.fine_step_mm < settings.grain_mm / 5


def test_deposit_without_volume_is_refused() -> None:
    with pytest.raises(MeshError, match="missing"):
        printed(volume=0.0)


def test_walls_lean_as_far_as_the_feet_moved_out() -> None:
    lean, wall = 0.03, 0.6
    field = printed(Form(0.04, wall, 0.0, 0.0, 0.0, lean_mm=lean), step_mm=0.005)
    top = field.height_mm.max()
    # Along the middle of a long side, from the rim inwards: depth is the distance from y = -0.2.
    along = np.abs(field.xy_mm[:, 0]) < 0.1
    depth, height = field.xy_mm[along, 1] + 0.2, field.height_mm[along] / top
    sloped = (depth > 0.004) & (depth < lean)
    assert height[sloped] == pytest.approx(wall * depth[sloped] / lean)
    # Then the shoulder: a quarter of an ellipse that ends level.
    q = np.clip((depth - lean) / 0.04, 0.0, 1.0)
    inner = (depth >= lean) & (depth < 0.2)
    assert height[inner] == pytest.approx(wall + (1 - wall) * np.sqrt(q * (2 - q))[inner])
    # A lean narrower than a triangle lowers the rim by the part of the wall that is missing.
    narrow = printed(Form(0.04, wall, 0.0, 0.0, 0.0, lean_mm=0.0025), step_mm=0.01)
    rim = narrow.height_mm[narrow.rims[0]]
    assert rim == pytest.approx(0.75 * wall * narrow.height_mm.max())


@pytest.mark.parametrize(
    ("pixel_um", "powder", "granular"),
    [
        (15.6, 4, False),
        (12.5, 4, False),
        (11.5, 4, True),
        (14.0, 3, True),
        (15.5, 3, False),
        (9.5, 5, False),
        (3.0, 6, True),
    ],
)
def test_auto_shows_grains_where_a_pixel_is_below_half_a_grain(
    pixel_um: float, powder: int, granular: bool
) -> None:
    # Median diameters by number: 29.6, 24.0, 17.5 and 6.3 um for types 3 to 6, by Hatch and Choate from the mass's log-normal.
    paste = Paste.model_validate({"powder": powder}).seen_by(pixel_um * 1e-3)
    assert paste.texture == ("granular" if granular else "smooth")
    for texture in ("smooth", "granular"):
        assert (
            Paste.model_validate({"texture": texture}).seen_by(pixel_um * 1e-3).texture == texture
        )
    # Paint has no grains.
    assert Paste(material="grey-paint").seen_by(pixel_um * 1e-3).texture == "smooth"
