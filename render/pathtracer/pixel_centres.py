"""What each pixel's centre sees, and which projectors light it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.plugins.lens import Optics
from render.plugins.screen_light import Lights
from render.plugins.variant import dr, mi

# The middle of the square is the middle of the pupil: the chief ray.
MIDDLE = 0.5


def label_map(
    mi_scene: Any, camera: Optics, ids: Sequence[int], shape: tuple[int, int]
) -> NDArray[np.uint16]:
    """What each pixel's centre sees, (row, col): the id of the part, 0 for nothing."""
    ray = _rays(camera, shape)
    hit = mi_scene.ray_intersect_preliminary(ray, coherent=True)
    found = dr.zeros(mi.UInt32, shape[0] * shape[1])
    for surface in mi_scene.shapes():
        number = int(surface.id().removeprefix("part_"))
        found[hit.shape == mi.ShapePtr(surface)] = ids[number]
    label: NDArray[np.uint16] = found.numpy().reshape(shape).astype(np.uint16)
    return label


def lit(mi_scene: Any, camera: Optics, lights: Lights, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether a projector's light reaches the camera from each pixel's centre, (row, col)."""
    si = mi_scene.ray_intersect(_rays(camera, shape), mi.RayFlags.All, True)
    found = np.zeros(shape, np.bool_)
    for light in lights:
        for radiance, _, _ in light.arrive(
            mi_scene, si, lambda _: mi.Point2f(MIDDLE), si.is_valid()
        ):
            found |= (radiance > 0).numpy().reshape(shape)
    return found


def _rays(camera: Optics, shape: tuple[int, int]) -> Any:
    index = dr.arange(mi.UInt32, shape[0] * shape[1])
    row = index // shape[1]
    centre = mi.Point2f(index - row * shape[1], row) + 0.5
    return mi.Ray3f(*camera.ray(centre, mi.Point2f(MIDDLE)))
