"""What each pixel's centre sees, and whether a projector lights it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.plugins.lens import Optics
from render.plugins.projector_light import Light
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
    """Whether each light reaches what a pixel's centre sees, on the side that the camera sees, (light, row, col).

    By the triangles, as `render.truth` has it: shading that is smooth leaves some of them dark. A screen's light is mirrored,
    so it must reach the camera.
    """
    ray = _rays(camera, shape)
    si = mi_scene.ray_intersect(ray, mi.RayFlags.All, True)
    middle = mi.Point2f(MIDDLE)
    found = np.zeros((len(lights), *shape), np.bool_)
    for p, light in enumerate(lights):
        if isinstance(light, Light):
            source, _, _, reached = light.connect(si.p, middle)
            facing = dr.dot(si.n, source - si.p) * dr.dot(si.n, -ray.d) > 0
            reached &= si.is_valid() & facing
            lit = [reached & ~mi_scene.ray_test(si.spawn_ray_to(source), reached)]
        else:
            arrived = light.arrive(mi_scene, si, lambda _: middle, si.is_valid())
            lit = [radiance > 0 for radiance, _, _ in arrived]
        for one in lit:
            found[p] |= one.numpy().reshape(shape)
    return found


def _rays(camera: Optics, shape: tuple[int, int]) -> Any:
    index = dr.arange(mi.UInt32, shape[0] * shape[1])
    row = index // shape[1]
    centre = mi.Point2f(index - row * shape[1], row) + 0.5
    return mi.Ray3f(*camera.ray(centre, mi.Point2f(MIDDLE)))
