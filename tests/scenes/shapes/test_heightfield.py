"""Tessellated polygons: closed, filling the outline, with integrals that are exact."""

import numpy as np
import pytest
import shapely
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scenes.shapes.heightfield import Heightfield
from scenes.shapes.solids import Tiles
from scenes.shapes.tessellation import tessellate
from scenes.support.errors import MeshError

OUTLINES = {
    "rectangle": shapely.box(-0.45, -0.6, 0.45, 0.6),
    "thinner than a step": shapely.box(0.0, 0.0, 1.0, 0.004),
    "smaller than a step": shapely.box(0.0, 0.0, 0.006, 0.006),
    "disk": shapely.Point(0.0, 0.0).buffer(0.15, quad_segs=16),
    "L": shapely.Polygon([(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]),
    "acute": shapely.Polygon([(0, 0), (1, 0.05), (1, -0.05)]),
    "ring": shapely.Point(0, 0).buffer(0.4).difference(shapely.Point(0, 0).buffer(0.2)),
    "turned": shapely.Polygon([(0, 0), (0.7, 0.4), (0.5, 0.75), (-0.2, 0.35)]),
    "neck": shapely.union_all(
        [
            shapely.box(0, 0, 0.2, 0.2),
            shapely.box(0.2, 0.09, 0.3, 0.1),
            shapely.box(0.3, 0, 0.5, 0.2),
        ]
    ),
}


def rough(outline: shapely.Polygon, step_mm: float = 0.02) -> Heightfield:
    mesh = tessellate(outline, step_mm)
    height = 0.05 + np.random.default_rng(0).uniform(0.0, 0.1, len(mesh.xy_mm))
    return Heightfield(mesh.xy_mm, mesh.faces, mesh.rims, height)


@pytest.mark.parametrize("name", OUTLINES)
def test_solid_is_closed_and_keeps_its_volume(name: str) -> None:
    field = rough(OUTLINES[name])
    solid = trimesh.Trimesh(*field.solid(0.3), process=False)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    # Sums of some 1e4 float64 terms.
    assert solid.volume == pytest.approx(field.volume_mm3, rel=1e-10)
    np.testing.assert_allclose(solid.center_mass[:2], field.centroid_mm, atol=1e-9)
    assert field.area_mm2 == pytest.approx(OUTLINES[name].area, rel=1e-9)


@pytest.mark.parametrize("name", OUTLINES)
def test_triangles_are_inside_and_face_up(name: str) -> None:
    field = rough(OUTLINES[name])
    assert (field.face_areas_mm2 > 0).all()
    centres = field.xy_mm[field.faces].mean(axis=1)
    assert shapely.contains_xy(OUTLINES[name], centres).all()


@given(st.floats(0.0, 0.2))
@settings(max_examples=30, deadline=None)
def test_volume_above_a_threshold_is_that_of_sliced_triangles(threshold_mm: float) -> None:
    field = rough(shapely.box(0.0, 0.0, 0.3, 0.2), 0.05)
    area, volume = field.above(threshold_mm)
    # An independent answer: cut every triangle with the plane as a polygon.
    expected_area = expected_volume = 0.0
    for face in field.faces:
        corners = np.column_stack([field.xy_mm[face], field.height_mm[face]])
        kept = _clip_above(corners, threshold_mm)
        for a, b, c in [(kept[0], kept[i], kept[i + 1]) for i in range(1, len(kept) - 1)]:
            piece = 0.5 * ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
            expected_area += piece
            expected_volume += piece * (a[2] + b[2] + c[2]) / 3
    assert area == pytest.approx(expected_area, abs=1e-12)
    assert volume == pytest.approx(expected_volume, abs=1e-13)


def _clip_above(corners: np.ndarray, z: float) -> list[np.ndarray]:
    kept: list[np.ndarray] = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if start[2] >= z:
            kept.append(start)
        if (start[2] >= z) != (end[2] >= z):
            kept.append(start + (z - start[2]) / (end[2] - start[2]) * (end - start))
    return kept


def test_volumes_of_parts_add_up_to_the_whole() -> None:
    field = rough(OUTLINES["disk"])
    cuts = [shapely.box(-1, -1, 0.037, 1), shapely.box(0.037, -1, 1, 1)]
    assert sum(field.part_volume_mm3(cut) for cut in cuts) == pytest.approx(
        field.volume_mm3, rel=1e-10
    )


def test_rendered_shell_is_open_at_its_foot_alone() -> None:
    field = rough(OUTLINES["ring"])
    shell = trimesh.Trimesh(*field.shell(0.04, 0.0, 0.002), process=False)
    edges = np.sort(shell.edges, axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert set(counts) == {1, 2}
    free = np.unique(edges, axis=0)[counts == 1]
    assert np.all(shell.vertices[free.ravel(), 2] == 0.0)
    # No triangle faces down: nothing coincides with the pad's own surface.
    assert shell.face_normals[:, 2].min() > -0.1


def test_foot_of_a_shell_is_inside_the_outline_by_the_undercut() -> None:
    field = rough(OUTLINES["ring"])
    vertices, _ = field.shell(0.04, 0.0, 0.002)
    foot = shapely.points(vertices[len(field.xy_mm) :, :2])
    assert shapely.contains(OUTLINES["ring"], foot).all()
    # At a corner of a 64-gon, where sides turn by 5.6 degrees, the cosine of half of that less: 0.12 %.
    away = shapely.distance(foot, OUTLINES["ring"].boundary)
    np.testing.assert_allclose(away, 0.002, rtol=1.3e-3)


def test_crossed_outline_is_refused() -> None:
    with pytest.raises(MeshError, match="crosses itself"):
        tessellate(shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)]), 0.1)


def test_chart_without_its_mark_is_refused() -> None:
    keys = {"chart": ("xo", "ox"), "cell_mm": 2.0}
    assert Tiles(mark="x", **keys).mesh().area == pytest.approx(2 * 2.0**2)
    with pytest.raises(ValueError, match="no cell has the mark 'y'"):
        Tiles(mark="y", **keys)
