"""The same seed gives the same bits, however many threads share the work."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import trimesh

import render
import scenes
from render.plugins.shading_normals import vertex_normals
from render.plugins.variant import dr, use


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    use()
    before = dr.thread_count()
    yield dr.set_thread_count
    dr.set_thread_count(before)


def test_light_on_smooth_surfaces_is_the_same_for_any_thread_count(
    threads: Callable[[int], None],
) -> None:
    # A quarter of a million triangles, shaded smoothly: Mitsuba's own normals, summed by several threads, would vary.
    scene = scenes.load("spi", {"camera.resolution": [96, 72], "sampling.samples": 1})
    taken = []
    for count in (1, 3):
        threads(count)
        transport = render.trace(scene, seed=5)
        truth = render.truth(scene, transport)
        taken.append((transport.total, truth.xyz_mm, truth.direct_fractions))
    for one, three in zip(*taken, strict=True):
        np.testing.assert_array_equal(one, three)


def test_vertex_normals_are_those_of_another_implementation() -> None:
    torus = trimesh.creation.torus(2.0, 0.7, major_sections=40, minor_sections=20)
    normals = vertex_normals(torus.vertices, torus.faces)
    # Both sum a handful of float64 terms of order 1.
    np.testing.assert_allclose(normals, torus.vertex_normals, atol=1e-13)


def test_vertex_without_a_triangle_has_a_unit_normal() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5.0], [2, 0, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 4]])  # the second is flat as a line
    normals = vertex_normals(vertices, faces)
    np.testing.assert_array_equal(normals[:4], np.tile([0.0, 0.0, 1.0], (4, 1)))
    np.testing.assert_array_equal(normals[4], [0.0, 0.0, 1.0])
