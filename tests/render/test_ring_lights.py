"""The colour picture: brightness of matt surfaces, the colour of a tilted mirror, and the colours of metals."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

import render
from render.ring_lights import RINGS
from scenes.shapes.materials import LIBRARY, Conductor
from tests.render import rigs

SIZE = (24, 18)


def _mean(material: str, tilt_deg: float = 0.0) -> NDArray[np.float64]:
    """Mean picture of one plate, larger than the field."""
    plate = rigs.plane(material)[0] | {"rotation_deg": (0.0, tilt_deg, 0.0)}
    scene = rigs.scene(rigs.telecentric(SIZE), rigs.pinhole_projector(), objects=[plate], depth=1)
    picture = render.ring_light_picture(scene)
    return np.asarray(picture.reshape(-1, 3).mean(axis=0, dtype=np.float64))


def test_level_matt_surface_has_its_reflectance_in_each_colour() -> None:
    # Even radiance over elevations a to b gives a Lambertian surface pi (sin² b - sin² a) times it, which the rings are scaled
    # by. 432 pixels x 16 paths; a path's irradiance varies by the cosine over one ring, at most 0.3 of the mean; the map's
    # edges are a bin of 0.25 degrees wide. 5 sd = 0.018.
    np.testing.assert_allclose(_mean("white-paint"), 0.8, rtol=0.02)
    laminate = LIBRARY["laminate"]
    np.testing.assert_allclose(_mean("laminate"), laminate.rgb, rtol=0.02)  # type: ignore[arg-type,union-attr]


def test_rings_are_red_above_green_above_blue() -> None:
    # Bands of LEDs' dominant wavelengths, nm.
    bands = {"red": (610, 645), "green": (510, 540), "blue": (450, 480)}
    assert [ring.colour for ring in RINGS] == list(bands)
    assert all(bands[ring.colour][0] < ring.wavelength_nm < bands[ring.colour][1] for ring in RINGS)
    assert all(above.low_deg > below.high_deg for above, below in pairwise(RINGS))


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_tilted_mirror_shows_the_ring_that_it_reflects(channel: int) -> None:
    ring, tin = RINGS[channel], LIBRARY["mirror"]
    assert isinstance(tin, Conductor)
    elevation_deg = (ring.low_deg + ring.high_deg) / 2.0
    tilt_deg = (90.0 - elevation_deg) / 2.0
    # Fresnel at the tilt, which is the angle of incidence; unpolarised.
    cos, index = np.cos(np.radians(tilt_deg)), complex(tin.eta, tin.k)
    inside = np.sqrt(1.0 - (1.0 - cos**2) / index**2)
    s = (cos - index * inside) / (cos + index * inside)
    p = (index * cos - inside) / (index * cos + inside)
    seen = _mean("mirror", tilt_deg)
    low, high = np.radians([ring.low_deg, ring.high_deg])
    radiance = 1.0 / (np.sin(high) ** 2 - np.sin(low) ** 2)
    # float32, no noise: every path of a mirror ends at the same radiance.
    assert seen[channel] == pytest.approx((abs(s) ** 2 + abs(p) ** 2) / 2.0 * radiance, rel=1e-4)
    np.testing.assert_array_equal(np.delete(seen, channel), 0.0)


def test_copper_and_gold_are_reddish_and_tin_is_neutral() -> None:
    # Red over blue reflectance at normal incidence.
    def reflectance(eta: float, k: float) -> float:
        return ((eta - 1.0) ** 2 + k**2) / ((eta + 1.0) ** 2 + k**2)

    ratio = {}
    for name in ("copper", "gold", "tin"):
        metal = LIBRARY[name]
        assert isinstance(metal, Conductor)
        red, _, blue = metal.rgb or ((metal.eta, metal.k),) * 3
        ratio[name] = reflectance(*red) / reflectance(*blue)
    # Johnson and Christy at 630 and 465 nm: copper 0.94 / 0.55, gold 0.95 / 0.40.
    assert ratio == pytest.approx({"copper": 1.7, "gold": 2.4, "tin": 1.0}, rel=0.05)
    seen = {name: _mean(name) for name in ("gold", "tin")}
    assert seen["gold"][0] > seen["gold"][2]
