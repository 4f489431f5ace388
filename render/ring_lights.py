"""The colour picture of a 2-D camera under rings of red, green and blue light, as board inspection machines take it."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.plugins.camera_sensor import camera_plugin
from render.plugins.scene_translation import NO_ROULETTE, geometry
from render.plugins.shared_surfaces import Surfaces, shared
from render.plugins.variant import mi, use
from scenes.scene import Scene
from scenes.shapes.materials import RGB_NM, in_colour

# Light paths per pixel and ring.
SAMPLES = 16
# Rows of the map of a ring's light, over 180 degrees: its edges are a quarter of a degree wide.
ROWS = 720


@dataclass(frozen=True)
class Ring:
    """A ring of light, seen from the board as a band of even radiance all around."""

    colour: str
    wavelength_nm: float
    low_deg: float
    """Elevation of its lower edge above the board."""
    high_deg: float
    """Of its upper edge."""

    @property
    def radiance(self) -> float:
        """That gives a white Lambertian surface radiance 1: its irradiance is pi (sin² high - sin² low) times this."""
        low, high = np.sin(np.radians([self.low_deg, self.high_deg])) ** 2
        return float(1.0 / (high - low))


# Red from above, green from the middle, blue from low down: a mirror tilted by t appears in the colour of elevation
# 90° - 2t. The order is that of the trade's machines; the angles are this project's choice.
RINGS = (
    Ring("red", RGB_NM[0], 65.0, 85.0),
    Ring("green", RGB_NM[1], 40.0, 60.0),
    Ring("blue", RGB_NM[2], 15.0, 35.0),
)


def ring_light_picture(
    scene: Scene, seed: int = 0, surfaces: Surfaces | None = None
) -> NDArray[np.float32]:
    """The scene's camera under ring lights, which replace projectors and ambient light.

    Parameters
    ----------
    scene
        The scene; materials with `rgb` have a colour, all others are neutral.
    seed
        Seed of the light paths, 0 or more.
    surfaces
        Those of `render.surfaces`, to build the meshes only once.

    Returns
    -------
    ndarray
        (row, col, channel), linear, channels red, green, blue; 1 is a level white Lambertian surface, metal may be brighter.

    Notes
    -----
    Each ring is infinitely far away (`render.ring_lights.RINGS` has elevations and wavelengths), and each channel sees one ring only. 16 light
    paths per pixel and ring, to the scene's depth; no noise, blur or defects of a sensor.

    Examples
    --------
    >>> import scenes, render
    >>> render.ring_light_picture(scenes.load("step", {"camera.resolution": [32, 24]})).shape
    (24, 32, 3)
    """
    use()
    parts = shared(scene, surfaces).parts
    channels = []
    for number, ring in enumerate(RINGS):
        coloured = [replace(p, material=in_colour(p.material, number)) for p in parts]
        entries = geometry(coloured) | {
            "ring": _far_away(ring),
            "sensor": camera_plugin(scene.camera, SAMPLES),
            "integrator": {
                "type": "path",
                "max_depth": scene.sampling.depth + 1,
                "rr_depth": NO_ROULETTE,
            },
        }
        image = mi.render(mi.load_dict(entries), spp=SAMPLES, seed=(seed + number) % 2**32)
        channels.append(np.asarray(image, np.float32)[..., 0])
    return np.stack(channels, axis=-1)


def _far_away(ring: Ring) -> dict[str, Any]:
    """Mitsuba's environment map of a ring; the map's rows go from the zenith, which is its Y axis, to the nadir."""
    elevation = 90.0 - (np.arange(ROWS) + 0.5) * 180.0 / ROWS
    inside = (elevation > ring.low_deg) & (elevation < ring.high_deg)
    radiance = np.where(inside, ring.radiance, 0.0).astype(np.float32)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.repeat(radiance[:, None, None], 8, axis=1)),
        "to_world": mi.ScalarTransform4f().rotate([1.0, 0.0, 0.0], 90.0),
    }
