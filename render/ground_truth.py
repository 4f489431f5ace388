"""Truth: what every camera pixel should have measured, from rays through pixel centres to the meshes.

Mitsuba finds which triangle a ray meets, in float32; the point, its normal and its projector pixel are then computed
from that triangle in float64.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from render.fringe_phasor import white_weights
from render.light_noise import height_noise_mm
from render.pathtracer.one_pass import trace
from render.plugins.scene_translation import geometry
from render.plugins.shading_normals import vertex_normals
from render.plugins.shared_surfaces import Surfaces, shared
from render.plugins.variant import mi, use
from render.transport import Transport
from scenes.acquisition.patterns import PhaseShift
from scenes.files.truth_maps import Truth
from scenes.rig.projection import Projection
from scenes.rig.projectors import Screen
from scenes.scene import Scene
from scenes.scene_files import dumps
from scenes.scene_identity import PARTS, identity
from scenes.scene_meshes import Part
from scenes.shapes.materials import Diffuse
from scenes.support.errors import RenderError
from scenes.support.memory import room_for

Points = NDArray[np.float64]

# Pixels computed at once: their float64 numbers stay in the cache, which is twice as fast as a megapixel at once.
BLOCK = 1 << 15
# Light paths per pixel if the share of direct light has to be traced here.
SAMPLES = 16
# Distance from its surface at which a shadow ray starts, in scene radii: 50 times float32's rounding of a coordinate.
LIFT = 50 * 2.0**-24


def truth(
    scene: Scene, transport: Transport | None = None, surfaces: Surfaces | None = None
) -> Truth:
    """Ground truth at every pixel's centre: point, normal, label, and for each projector whether and where it lights it.

    Parameters
    ----------
    scene
        The scene as rendered.
    transport
        Traced light of this scene, for `direct_fraction`; None: a small transport (16 paths per pixel, white only) is
        traced here.
    surfaces
        Those of `render.surfaces`, to build the meshes only once.

    Returns
    -------
    Truth
        Maps (row, col) and, per projector, (projector, row, col): mm, projector pixels, labels.

    Raises
    ------
    RenderError
        For a transport of another camera, other projectors or other objects.
    TooLargeError
        For more pixels than memory holds.

    Notes
    -----
    A camera or projector with a lens is represented by the centre of its pupil. `lit` is true if a point is inside the
    projector's image, the side seen by the camera faces the projector, and no triangle is between; with a second camera, if that
    camera sees it as well. Normals are those of
    the triangles, also where shading is smooth; in a scene with a screen those of the shading, which mirror. There, `lit`
    and the projector's pixel are those that the camera's ray meets if the surface mirrors it, whatever the material.

    `direct_fraction` is a mean over the pixel's area, not its value at the centre, and is as noisy as the light it
    comes from. The transport of a projector with gamma or quantised values has no white channel; the nearest
    combination of its patterns is used instead.

    Examples
    --------
    >>> import scenes, render
    >>> truth = render.truth(scenes.load("step", {"camera.resolution": [64, 48]}))
    >>> truth.height_mm.shape
    (48, 64)
    """
    use()
    surfaces = shared(scene, surfaces)
    if transport is None:
        transport = trace(_white(scene), samples=SAMPLES, surfaces=surfaces)
    elif not _same_light(scene, transport):
        raise RenderError(
            "the transport was traced from another scene (its camera, projectors or objects differ): "
            "trace this scene, or give no transport"
        )
    surface = _Surface.of(scene, surfaces.parts)
    camera = scene.camera.projection()
    with room_for(
        (60 + 29 * len(scene.projectors)) * camera.width * camera.height,
        f"the truth of {camera.width} x {camera.height} pixels",
        "lower camera.resolution",
    ):
        return _truth(scene, surface, camera, transport)


def _truth(scene: Scene, surface: "_Surface", camera: Projection, transport: Transport) -> Truth:
    projectors = scene.projectors
    second = None if scene.second_camera is None else scene.second_camera.projection()
    pixels = camera.pixel_centres().reshape(-1, 2)
    count, shape = len(pixels), (camera.height, camera.width)

    xyz = np.full((count, 3), np.nan, np.float32)
    normal = np.full((count, 3), np.nan, np.float32)
    label = np.zeros(count, np.uint16)
    pad, material = np.zeros(count, np.uint32), np.zeros(count, np.uint16)
    lit = np.zeros((len(projectors), count), np.bool_)
    image = np.full((2, len(projectors), count), np.nan, np.float32)
    for start in range(0, count, BLOCK):
        origin, direction = camera.rays(pixels[start : start + BLOCK])
        triangle = surface.first_hit(origin, direction)
        hit = np.flatnonzero(triangle >= 0)
        triangle, at = triangle[hit], start + hit
        point, facing = surface.meet(triangle, origin[hit], direction[hit])
        plane = facing
        if scene.screens:
            facing = surface.shaded(triangle, point, facing)
        xyz[at], normal[at], label[at] = point, facing, surface.label[triangle]
        pad[at], material[at] = surface.pad[triangle], surface.material[triangle]
        for p, projector in enumerate(projectors):
            projection = projector.projection()
            if isinstance(projector, Screen):
                target = _mirrored(point, direction[hit], facing, projection)
                where = projection.project(target)[0]
                lit[p, at] = surface.reached(point, plane, target, where, projection)
                image[:, p, at] = where.T
                continue
            where, _ = projection.project(point)
            image[:, p, at] = where.T
            lit[p, at] = surface.lit(point, facing, where, projection)
        if second is not None:
            lit[:, at] &= surface.lit(point, facing, second.project(point)[0], second)
    label = label.reshape(shape)
    return Truth(
        xyz.reshape(*shape, 3),
        normal.reshape(*shape, 3),
        label,
        scene.labels,
        lit.reshape(-1, *shape),
        image[0].reshape(-1, *shape),
        image[1].reshape(-1, *shape),
        _direct_fraction(transport, label > 0),
        dumps(scene),
        pad.reshape(shape) if scene.board else None,
        material.reshape(shape),
        surface.materials,
        height_noise_mm(transport, xyz.reshape(*shape, 3), lit.reshape(-1, *shape)),
        identity(scene),
    )


def _mirrored(point: Points, direction: Points, normal: Points, screen: Projection) -> Points:
    """Where rays mirrored at points meet the screen's plane, world mm; NaN behind it, or if they leave it."""
    away = direction - 2.0 * (direction * normal).sum(axis=-1, keepdims=True) * normal
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((screen.origin_mm - point) @ screen.axis) / (away @ screen.axis)
        # From its front alone.
        seen = (distance > 0) & (away @ screen.axis < 0)
        return np.asarray(point + np.where(seen, distance, np.nan)[:, None] * away)


@dataclass(frozen=True)
class _Surface:
    """All objects as one mesh."""

    corners: Points
    """(triangle, 3, 3) world mm."""
    label: NDArray[np.uint16]
    """Label id of each triangle; `pad` and `material` likewise."""
    pad: NDArray[np.uint32]
    material: NDArray[np.uint16]
    materials: tuple[str, ...]
    normals: Points
    """(triangle, 3, 3) normals at the corners, with which Mitsuba shades."""
    centre: Points
    radius: float
    """Bounding-sphere radius, mm."""
    scene: Any
    """Mitsuba's scene of the same mesh, moved to the origin."""

    @classmethod
    def of(cls, scene: Scene, surfaces: Sequence[Part]) -> "_Surface":
        ids = [scene.labels.index(part.label) + 1 for part in surfaces]
        counts = [len(part.mesh.faces) for part in surfaces]
        pads = [
            np.zeros(n, np.uint32) if part.face_pad is None else part.face_pad.astype(np.uint32)
            for part, n in zip(surfaces, counts, strict=True)
        ]
        materials = tuple(dict.fromkeys(part.material_name for part in surfaces))
        made_of = [materials.index(part.material_name) + 1 for part in surfaces]
        # One shape, so that Mitsuba's triangle numbers are the mesh's; at the origin, where float32 is finest.
        vertices = np.concatenate([np.asarray(part.mesh.vertices) for part in surfaces])
        first = np.cumsum([0, *(len(part.mesh.vertices) for part in surfaces)])
        faces = np.concatenate(
            [part.mesh.faces + n for part, n in zip(surfaces, first, strict=False)]
        )
        corners = vertices[faces]
        normals = np.concatenate([_corner_normals(part) for part in surfaces])
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        centre = (low + high) / 2
        mesh = trimesh.Trimesh(vertices - centre, faces, process=False)
        whole = Part("", mesh, Diffuse(reflectance=0.5), smooth=False)
        return cls(
            corners,
            np.repeat(ids, counts).astype(np.uint16),
            np.concatenate(pads),
            np.repeat(made_of, counts).astype(np.uint16),
            materials,
            normals,
            centre,
            float(np.linalg.norm(high - low)) / 2,
            mi.load_dict(geometry([whole])),
        )

    def first_hit(self, origin: Points, direction: Points) -> NDArray[np.int64]:
        """Number of the triangle each ray meets first, -1 for none."""
        # Rays start close to the scene, because float32 is coarse at a distant camera.
        ahead = ((self.centre - origin) * direction).sum(axis=-1, keepdims=True)
        skip = np.maximum(ahead - 1.01 * self.radius, 0.0)
        ray = mi.Ray3f(self._local(origin + skip * direction), _vector(direction))
        hit = self.scene.ray_intersect_preliminary(ray, coherent=True)
        index: NDArray[np.int64] = np.where(
            hit.is_valid().numpy(), hit.prim_index.numpy().astype(np.int64), -1
        )
        return index

    def meet(
        self, triangle: NDArray[np.int64], origin: Points, direction: Points
    ) -> tuple[Points, Points]:
        """Points where rays meet their triangles' planes, and unit normals facing the rays' origins."""
        a, b, c = np.moveaxis(self.corners[triangle], 1, 0)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        slope = (normal * direction).sum(axis=-1, keepdims=True)
        distance = (normal * (a - origin)).sum(axis=-1, keepdims=True) / slope
        return origin + distance * direction, np.where(slope > 0, -normal, normal)

    def shaded(self, triangle: NDArray[np.int64], point: Points, facing: Points) -> Points:
        """Unit normals with which points of triangles are shaded, on the side of `facing`."""
        a, b, c = np.moveaxis(self.corners[triangle], 1, 0)
        area = np.cross(b - a, c - a)
        square = (area * area).sum(axis=-1)
        v = (np.cross(point - a, c - a) * area).sum(axis=-1) / square
        w = (np.cross(b - a, point - a) * area).sum(axis=-1) / square
        shares = np.stack([1.0 - v - w, v, w], axis=-1)
        normal = np.einsum("ni,nij->nj", shares, self.normals[triangle])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        towards: Points = np.where(
            (normal * facing).sum(axis=-1, keepdims=True) < 0, -normal, normal
        )
        return towards

    def lit(
        self, point: Points, normal: Points, pixel: Points, projector: Projection
    ) -> NDArray[np.bool_]:
        """Whether a projector's light reaches points on the side of their normals."""
        if projector.telecentric:
            depth = point @ projector.axis + projector.t[2]
            towards = -depth[:, None] * projector.axis
        else:
            depth = np.ones(len(point))
            towards = projector.origin_mm - point
        with np.errstate(invalid="ignore"):
            inside = ((pixel >= 0) & (pixel < (projector.width, projector.height))).all(axis=-1)
        return self._free(point, normal, towards, inside & (depth > 0))

    def reached(
        self, point: Points, normal: Points, target: Points, pixel: Points, screen: Projection
    ) -> NDArray[np.bool_]:
        """Whether mirrored rays that meet the screen's plane at `target` meet its pixels, and nothing before."""
        with np.errstate(invalid="ignore"):
            inside = np.asarray(((pixel >= 0) & (pixel < (screen.width, screen.height))).all(-1))
        return self._free(point, normal, target - point, inside)

    def _free(
        self, point: Points, normal: Points, towards: Points, wanted: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Which of the wanted points see along `towards`, up to its end, on the side of their normals."""
        with np.errstate(invalid="ignore"):
            reached: NDArray[np.bool_] = wanted & ((normal * towards).sum(axis=-1) > 0)
        if not reached.any():
            # Mitsuba aborts the process if it gets no rays at all.
            return reached
        distance = np.linalg.norm(towards[reached], axis=-1)
        # Nothing behind the projector casts a shadow, nor does anything outside the scene's bounding sphere.
        ray = mi.Ray3f(
            self._local(point[reached] + LIFT * self.radius * normal[reached]),
            _vector(towards[reached] / distance[:, None]),
            mi.Float(np.minimum(distance, 2.1 * self.radius).astype(np.float32)),
            0,
            [],
        )
        reached[reached] = ~self.scene.ray_test(ray).numpy()
        return reached

    def _local(self, point: Points) -> Any:
        return _vector(point - self.centre)


def _corner_normals(part: Part) -> Points:
    """(triangle, corner, 3): vertex normals of a smooth part, else the triangles' own."""
    vertices, faces = np.asarray(part.mesh.vertices), np.asarray(part.mesh.faces)
    if part.smooth:
        smooth: Points = vertex_normals(vertices, faces)[faces]
        return smooth
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.repeat(np.cross(b - a, c - a)[:, None], 3, axis=1)


def _vector(array: Points) -> Any:
    return mi.Vector3f(np.ascontiguousarray(array.T, dtype=np.float32))


def _direct_fraction(transport: Transport, hit: NDArray[np.bool_]) -> NDArray[np.float32]:
    """(projector, row, col) share of direct light under white."""
    shares = []
    for p, basis in enumerate(transport.bases):
        white, count = white_weights(basis), len(basis.channels)
        total = np.tensordot(white, transport.total[p, :count], axes=1)
        direct = np.tensordot(white, transport.direct[p, :count], axes=1)
        bright = hit & (total > 0)
        share = np.full(hit.shape, np.nan, np.float32)
        share[bright] = np.clip(direct[bright] / total[bright], 0.0, 1.0)
        shares.append(share)
    return np.stack(shares)


def _white(scene: Scene) -> Scene:
    """The scene with the fewest channels among which is white."""
    linear = [
        p.model_copy(update={"gamma": 1.0, "bits": 0, "pixels": False}) for p in scene.projectors
    ]
    wide = PhaseShift(steps=3, periods_px=(1e6,))
    return scene.model_copy(update={"projectors": tuple(linear), "patterns": wide})


def _same_light(scene: Scene, transport: Transport) -> bool:
    """Whether a transport is of this scene, whose mesh files may have changed since."""
    same = all(getattr(scene, part) == getattr(transport.scene, part) for part in PARTS)
    return same and (not transport.identity or transport.identity == identity(scene))
