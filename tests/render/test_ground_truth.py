"""Truth compared with geometry known in closed form, and with an independent ray caster (trimesh with Embree)."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy import ndimage
from trimesh.ray.ray_pyembree import RayMeshIntersector

import render
import scenes
from scenes.rig.devices import Telecentric
from scenes.shapes.solids import Cap
from scenes.support.errors import RenderError
from tests.render.oracle import require_same


def small(name: str, **overrides: Any) -> scenes.Scene:
    """A shipped scene at 1/4 of its resolution, the same field of view."""
    width, height = scenes.load(name).camera.resolution
    return scenes.load(name, {"camera.resolution": [width // 4, height // 4], **overrides})


def interior(image: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels whose eight neighbours all have the same value: no edge of `image` within a pixel."""
    same = ndimage.minimum_filter(image, 3) == ndimage.maximum_filter(image, 3)
    return np.asarray(same)


class Embree:
    """The scene's parts as one mesh, asked through trimesh."""

    def __init__(self, scene: scenes.Scene) -> None:
        parts = [trimesh.Trimesh(p.mesh.vertices, p.mesh.faces) for p in scenes.parts(scene)]
        self.mesh = trimesh.util.concatenate(parts)
        ids = [scene.labels.index(p.label) + 1 for p in scenes.parts(scene)]
        self.label = np.repeat(ids, [len(p.faces) for p in parts])
        self.caster = RayMeshIntersector(self.mesh)
        self.scene = scene

    def first(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Per pixel the hit point (NaN for none) and the triangle (-1 for none)."""
        camera = self.scene.camera.projection()
        origin, direction = (x.reshape(-1, 3) for x in camera.rays(camera.pixel_centres()))
        # Start close, as its float32 errors grow with the distance.
        near = origin + (np.linalg.norm(origin, axis=-1, keepdims=True) - 60.0) * direction
        points, rays, triangles = self.caster.intersects_location(
            near, direction, multiple_hits=False
        )
        found = np.full((camera.height * camera.width, 3), np.nan)
        index = np.full(len(found), -1)
        found[rays], index[rays] = points, triangles
        return (
            found.reshape(camera.height, camera.width, 3),
            index.reshape(camera.height, camera.width),
        )

    def lit(
        self, points: NDArray[np.float64], triangles: NDArray[np.int64], device: Any
    ) -> NDArray[np.bool_]:
        """Per pixel whether a projector's light reaches the point, from the side that the camera sees."""
        camera, light = self.scene.camera.projection(), device.projection()
        towards = -light.axis if light.telecentric else light.origin_mm - points
        towards = np.broadcast_to(towards, points.shape)
        towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
        back = -camera.axis if camera.telecentric else camera.origin_mm - points
        normal = self.mesh.face_normals[triangles]
        shows = np.ones(points.shape[:2], np.bool_)
        if isinstance(device, scenes.Screen):
            along = camera.rays(camera.pixel_centres())[1]
            towards = along - 2 * (along * normal).sum(-1, keepdims=True) * normal
            rotation, translation = device.pose.matrix()
            start, way = points @ rotation.T + translation, towards @ rotation.T
            place = start - start[..., 2:] / way[..., 2:] * way
            half = np.array(device.size_mm) / 2
            shows = (
                (np.abs(place[..., :2]) < half).all(-1) & (start[..., 2] > 0) & (way[..., 2] < 0)
            )
        seen, lit = ((normal * direction).sum(-1) for direction in (back, towards))
        start = points + 1e-3 * np.sign(seen)[..., None] * normal
        blocked = self.caster.intersects_any(start.reshape(-1, 3), towards.reshape(-1, 3))
        free = ~blocked.reshape(seen.shape) & shows & np.isfinite(points[..., 0])
        return np.asarray((seen * lit > 0) & free, np.bool_)


@pytest.mark.parametrize("name", scenes.shipped())
def test_truth_equals_an_independent_ray_caster(name: str, tmp_path: Path) -> None:
    scene = small(name)
    truth = render.truth(scene, flat_light(scene))
    embree = Embree(scene)
    points, triangles = embree.first()
    size = float(np.linalg.norm(embree.mesh.extents))
    label = np.where(triangles < 0, 0, embree.label[triangles])

    # Ties on an edge may go either way: only pixels whose neighbours are alike are compared.
    away = interior(label) & interior(truth.label)
    assert away.mean() > 0.6
    require_same(truth.label, label, away, tmp_path)
    off = np.linalg.norm(truth.xyz_mm - points, axis=-1)[away & (label > 0)]
    # Float32 coordinates round by 6e-8 of the size; across a crease a neighbouring triangle may be hit instead.
    assert np.median(off) < 6e-8 * size
    assert off.max() < 1e-6 * size

    second = scene.second_camera
    for p, projector in enumerate(scene.projectors):
        lit = embree.lit(points, triangles, projector)
        if second is not None:
            at = second.projection().project(points)[0]
            inside = ((at >= 0) & (at < second.resolution)).all(axis=-1)
            lit &= inside & embree.lit(points, triangles, second)
        sure = interior(lit) & interior(truth.lit_by[p]) & away
        assert sure.mean() > 0.6
        require_same(truth.lit_by[p], lit, sure, tmp_path)


def flat_light(scene: scenes.Scene) -> render.Transport:
    """A transport in which all light is direct, for tests that do not look at light."""
    bases = tuple(scenes.basis(scene.patterns, p, p.resolution) for p in scene.projectors)
    width, height = scene.camera.resolution
    total = np.ones((len(bases), max(len(b.channels) for b in bases), height, width), np.float32)
    none = np.zeros((height, width), np.float32)
    label = none.astype(np.uint16)
    return render.Transport(total, total, none, label, scene.labels, bases, scene, 0, 1, 1)


def test_heights_and_normals_are_those_of_the_chapters_solids() -> None:
    scene = small("chapter")
    truth = render.truth(scene, flat_light(scene))
    assert isinstance(scene.camera, Telecentric)
    pixel = scene.camera.pixel_mm
    row, col = np.indices(truth.label.shape)
    np.testing.assert_allclose(truth.xyz_mm[..., 0], (col + 0.5) * pixel - 20, atol=2e-6)
    np.testing.assert_allclose(truth.xyz_mm[..., 1], 15 - (row + 0.5) * pixel, atol=2e-6)

    for label, height in (("base", 0.0), ("step", 3.0)):
        flat = truth.region(label)
        assert np.array_equal(truth.height_mm[flat], np.full(flat.sum(), height, np.float32))
        np.testing.assert_allclose(truth.normal[flat], np.tile([0, 0, 1.0], (flat.sum(), 1)))

    solid = next(item for item in scene.objects if item.label == "cap")
    assert isinstance(solid.shape, Cap)
    radius, height = solid.shape.radius_mm, solid.shape.height_mm
    cap = truth.region("cap")
    x, y, z = np.moveaxis(truth.xyz_mm[cap].astype(float), -1, 0)
    x, y = x - solid.position_mm[0], y - solid.position_mm[1]
    ideal = height * (1 - (x**2 + y**2) / radius**2)
    # Chords are inside a parabola by at most h (d / 2R)^2 along the rings and by the sagitta of a segment around.
    rings, segments = solid.shape.rings, solid.shape.segments
    sagitta = 1 - np.cos(np.pi / segments)
    rounding = 2.0**-23 * 20
    assert (ideal - z > -rounding).all()
    assert (ideal - z).max() < height * (0.25 / rings**2 + 2 * sagitta) + rounding
    slope = 2 * height / radius**2
    normal = np.stack([slope * x, slope * y, np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    # A triangle has the normal of some point of it: up to a ring and a segment away.
    tilt = np.arccos(np.clip((normal * truth.normal[cap]).sum(-1), -1, 1))
    assert tilt.max() < slope * radius / rings + 2 * np.pi / segments


def test_projector_columns_follow_the_ideal_model() -> None:
    # The chapter: u = x + c h, c = 4 px/mm, x in camera pixels, lit or not.
    scene = scenes.load("chapter", {"camera.resolution": [200, 150]})
    truth = render.truth(scene, flat_light(scene))
    col = np.indices(truth.label.shape)[1]
    offset = truth.columns_px[0] - 2 * (col + 0.5) - 4.0 * truth.height_mm
    # Float32 columns of up to 480 px.
    assert np.ptp(offset) < 2 * 480 * 2.0**-24 * 2
    assert offset.mean() == pytest.approx(240 - 200, abs=1e-4)
    row = np.indices(truth.label.shape)[0]
    assert np.ptp(truth.rows_px[0] * (44.566881162492446 / 480) - (row + 0.5) * 0.2) < 1e-4


def test_shadow_of_the_step_has_the_length_its_height_gives() -> None:
    scene = scenes.load("chapter")
    truth = render.truth(scene, flat_light(scene))
    row = truth.label.shape[0] // 2
    x = truth.xyz_mm[row, :, 0]
    dark = x[~truth.lit_by[0, row]]
    # Light slopes by 0.4: behind the edge at x = 17, 3 mm high, 1.2 mm of shadow; ends to half a pixel.
    assert dark.min() == pytest.approx(17.05, abs=1e-4)
    assert dark.max() == pytest.approx(18.15, abs=1e-4)
    assert len(dark) == 12


def test_pixels_that_see_nothing_are_nan() -> None:
    scene = small("step", **{"objects.0.shape.size_mm": [10.0, 10.0]})
    truth = render.truth(scene)
    nothing = truth.label == 0
    assert nothing.any()
    assert not nothing.all()
    for image in (truth.xyz_mm, truth.normal):
        assert np.isnan(image[nothing]).all()
        assert np.isfinite(image[~nothing]).all()
    for image in (truth.columns_px, truth.rows_px, truth.direct_fractions):
        assert np.isnan(image[:, nothing]).all()
    assert np.isfinite(truth.columns_px[:, ~nothing]).all()
    assert not truth.lit_by[:, nothing].any()


def test_points_outside_the_projectors_image_are_unlit_and_keep_their_column() -> None:
    scene = small("chapter", **{"projectors.0.resolution": [240, 90]})
    truth = render.truth(scene, flat_light(scene))
    inside = (
        (truth.columns_px[0] >= 0)
        & (truth.columns_px[0] < 240)
        & (truth.rows_px[0] >= 0)
        & (truth.rows_px[0] < 90)
    )
    assert not truth.lit_by[0][~inside].any()
    assert (~inside).mean() > 0.1
    assert np.isfinite(truth.columns_px).all()
    plain = inside & truth.region("base") & (truth.xyz_mm[..., 0] < -14)
    assert plain.any()
    assert truth.lit_by[0][plain].all()


def test_projector_behind_the_surface_lights_nothing() -> None:
    scene = small("step", **{"projectors.0.pose.origin_mm": [-150.0, 0.0, -260.0]})
    # Lift the plate's edge out of it: only the side that faces the camera counts.
    truth = render.truth(scene, flat_light(scene))
    assert not truth.lit.any()
    assert np.isfinite(truth.columns_px).all()


def test_every_projector_has_its_own_maps() -> None:
    one = small("step")
    other = one.projectors[0].model_copy(
        update={
            "pose": one.projectors[0].pose.model_copy(update={"origin_mm": (150.0, 0.0, 260.0)})
        }
    )
    scene = one.model_copy(update={"projectors": (one.projectors[0], other)})
    truth = render.truth(scene, flat_light(scene))
    assert truth.lit_by.shape[0] == 2
    # Shadows fall to opposite sides of the block.
    x = truth.xyz_mm[..., 0]
    assert x[~truth.lit_by[0]].min() > 3.9
    assert x[~truth.lit_by[1]].max() < -3.9


def test_labels_are_those_of_the_transport() -> None:
    scene = small("bench")
    transport = render.trace(scene, samples=1, depth=1)
    truth = render.truth(scene, transport)
    sure = interior(truth.label)
    assert np.array_equal(truth.label[sure], transport.label[sure])
    lit = truth.lit_by[0] & sure & interior(truth.lit_by[0])
    # Direct light only: all of it where lit, and none to divide by in the shadow.
    assert (truth.direct_fractions[0][lit] == 1).all()
    dark = ~truth.lit_by[0] & sure & interior(truth.lit_by[0])
    assert np.isnan(truth.direct_fractions[0][dark]).all()


def test_direct_fraction_is_one_on_a_free_plane_and_less_near_a_wall() -> None:
    scene = small(
        "step", **{"objects.0.shape.size_mm": [20.0, 20.0], "objects.1.material": "white-paint"}
    )
    own = render.truth(scene)
    given = render.truth(scene, render.trace(scene, seed=5, samples=64))
    x, y, z = np.moveaxis(own.xyz_mm, -1, 0)
    top = (np.abs(x) < 3.5) & (np.abs(y) < 3.5) & (z == 1.5)
    # From a block's top nothing but sky is seen.
    for truth in (own, given):
        assert (truth.direct_fractions[0][top] == 1).all()
    # The wall at x = -4 faces the projector and lights the plate before it.
    before = (x > -4.6) & (x < -4.1) & (np.abs(y) < 3) & own.lit_by[0]
    fraction = own.direct_fractions[0][before], given.direct_fractions[0][before]
    assert all(f.mean() < 0.97 for f in fraction)
    spread = np.sqrt(sum(f.var() / f.size for f in fraction))
    assert abs(fraction[0].mean() - fraction[1].mean()) < 5 * spread


def test_direct_fraction_is_the_same_for_a_projector_with_gamma() -> None:
    scene = small("step", **{"projectors.0.gamma": 2.2})
    bent = render.truth(scene, render.trace(scene, samples=16)).direct_fraction
    plain = render.truth(scene).direct_fraction
    lit = np.isfinite(bent) & np.isfinite(plain)
    assert lit.mean() > 0.9
    noise = np.sqrt((bent[lit].var() + plain[lit].var()) / lit.sum())
    assert abs(bent[lit].mean() - plain[lit].mean()) < 5 * noise


def test_transport_of_another_scene_is_refused() -> None:
    scene = small("step")
    with pytest.raises(RenderError, match="traced from another scene"):
        render.truth(scene, flat_light(small("cap")))
    with pytest.raises(RenderError, match="traced from another scene"):
        render.truth(scene, flat_light(scenes.load("step", {"camera.resolution": [8, 6]})))


def test_scene_can_be_loaded_again_from_its_truth() -> None:
    scene = small("step")
    assert scenes.parse(render.truth(scene, flat_light(scene)).scene) == scene
