"""The colour picture: brightness of matt surfaces, the colour of a tilted mirror, and the colours of metals."""

import json
import subprocess
import sys
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


# At the wavelengths of the three rings and of sodium: reflectance of Mitsuba's own metals at normal incidence.
MITSUBA = """
import json, mitsuba as mi, numpy as np
mi.set_variant("scalar_spectral")
def reflectance(metal):
    p = mi.traverse(mi.load_dict({"type": "conductor", "material": metal}))
    n, k = (np.interp((630, 520, 465, 589.3), p[x + ".wavelengths"], p[x + ".values"]) for x in ("eta", "k"))
    return list(((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2))
print(json.dumps({"copper": reflectance("Cu"), "gold": reflectance("Au")}))
"""


def test_copper_and_gold_have_the_reflectances_of_mitsubas_metals() -> None:
    run = subprocess.run(
        [sys.executable, "-c", MITSUBA], capture_output=True, check=True, text=True
    )
    for name, wanted in json.loads(run.stdout).items():
        metal = LIBRARY[name]
        assert isinstance(metal, Conductor)
        assert metal.rgb is not None
        indices = np.array([*metal.rgb, (metal.eta, metal.k)])
        n, k = indices.T
        found = ((n - 1.0) ** 2 + k**2) / ((n + 1.0) ** 2 + k**2)
        # Films of different makers: published reflectances of one metal differ by some hundredths.
        np.testing.assert_allclose(found, wanted, atol=0.04)


def test_gold_is_reddish_in_the_picture() -> None:
    seen = {name: _mean(name) for name in ("gold", "tin")}
    assert seen["gold"][0] > seen["gold"][2]
